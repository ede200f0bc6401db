//! Maintenance events that the estimate takes into account.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::library::FlankPlace;

/// The kind of a maintenance event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum MaintenanceKind {
    /// The gear pair was replaced: wear restarts at zero, and a new baseline is learnt.
    GearReplaced,
    /// The sensor was replaced, moved or remounted: a new baseline is learnt, and wear continues from its
    /// present depth.
    SensorReplaced,
    /// The machine runs at another speed or load from now on; handled like a replaced sensor.
    RegimeChanged,
    /// The teeth were inspected and their wear measured: the estimate continues from the depth in
    /// [`MaintenanceEvent::inspection`]. Without effect while the baseline of new gears or a chosen one is
    /// collected.
    Inspected,
    /// The records from here to [`MaintenanceEvent::until`] are the healthy baseline: the earlier state is
    /// discarded, and wear counts from zero there.
    BaselineChosen,
}

/// A wear depth that was measured on the teeth, by replica, microscope or span measurement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Inspection {
    /// Depth in µm.
    pub depth_um: f64,
    /// Standard deviation of its error in µm; 5 by default.
    #[serde(default = "default_error_um")]
    pub error_um: f64,
    /// The gear: 1 is driving, 2 is driven; by default the more deeply worn one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gear: Option<u8>,
    /// Place on the flank.
    #[serde(default)]
    pub place: FlankPlace,
}

fn default_error_um() -> f64 {
    5.0
}

impl Inspection {
    /// Returns the index of the gear, 0 for the driving one; `None` for the more deeply worn one.
    pub(super) fn gear_index(&self) -> Option<usize> {
        self.gear.map(|gear| usize::from(gear.saturating_sub(1)))
    }

    /// Returns the first number that is out of range: field, value, and what was expected.
    pub fn fault(&self) -> Option<(&'static str, String, &'static str)> {
        if !(0.0..=1e5).contains(&self.depth_um) {
            return Some(("inspection.depth_um", self.depth_um.to_string(), "a depth from 0 to 100000 µm"));
        }
        if !(self.error_um > 0.0 && self.error_um <= 1e4) {
            return Some((
                "inspection.error_um",
                self.error_um.to_string(),
                "a standard deviation above 0 and up to 10000 µm",
            ));
        }
        match self.gear {
            None | Some(1 | 2) => None,
            Some(gear) => {
                Some(("inspection.gear", gear.to_string(), "1 for the driving gear or 2 for the driven one"))
            }
        }
    }
}

/// Maintenance of a machine. Events and records are processed together in time order; an event comes before a
/// record of the same time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MaintenanceEvent {
    /// When it was done.
    pub time: Timestamp,
    /// What was done.
    pub kind: MaintenanceKind,
    /// Who did it.
    #[serde(default)]
    pub by: String,
    /// Comment of whoever did it.
    #[serde(default)]
    pub comment: String,
    /// The measurement, where the kind is `inspected`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inspection: Option<Inspection>,
    /// End of the baseline (exclusive), where the kind is `baseline_chosen`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Timestamp>,
}
