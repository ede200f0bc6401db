//! What people did to a machine that the estimate has to know.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::library::FlankPlace;

/// The kind of a maintenance event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum MaintenanceKind {
    /// The gear pair was replaced: wear begins at zero again, and a new baseline is learnt.
    GearReplaced,
    /// The sensor was replaced, moved or fastened again: a new baseline is learnt, and wear goes on from
    /// where it was.
    SensorReplaced,
    /// The machine runs at another speed or load from now on: as for a replaced sensor.
    RegimeChanged,
    /// The teeth were looked at, and their wear was measured: the estimate goes on from the depth of
    /// [`MaintenanceEvent::inspection`].
    Inspected,
    /// The records from here to [`MaintenanceEvent::until`] are the healthy baseline: what was learnt before
    /// is forgotten, and wear counts from zero there.
    BaselineChosen,
}

/// A wear depth that was measured on the teeth, by replica, microscope or span measurement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Inspection {
    /// Depth in µm.
    pub depth_um: f64,
    /// Standard deviation of its error in µm; 5 where not given.
    #[serde(default = "usual_error_um")]
    pub error_um: f64,
    /// Which gear: 1 drives, 2 is driven; the deeper one where not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gear: Option<u8>,
    /// Where on the flank.
    #[serde(default)]
    pub place: FlankPlace,
}

fn usual_error_um() -> f64 {
    5.0
}

impl Inspection {
    /// What is wrong with its numbers: field, value, and what was expected.
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

/// Something that was done to a machine. Events and records are folded together in the order of their times;
/// an event comes before a record of the same time.
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
    /// In the words of whoever did it.
    #[serde(default)]
    pub comment: String,
    /// What was measured, where the kind is `inspected`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inspection: Option<Inspection>,
    /// The end of the baseline, the first time that is no part of it, where the kind is `baseline_chosen`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Timestamp>,
}
