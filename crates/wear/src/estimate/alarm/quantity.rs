//! The quantities that alarms watch.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::estimate::{MaintenanceKind, WearEstimate, WearStatus};
use flankwatch_signal::Indicators;

/// A quantity that a rule watches.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum AlarmQuantity {
    /// The median wear depth in µm.
    WearUm,
    /// The probability that wear has passed the asset's limit, 0 to 1.
    WearAboveLimit,
    /// The novelty score: −log₁₀ of the p-value.
    Novelty,
    /// The novelty score of all channels of the asset together, reported by the caller.
    JointNovelty,
    /// Whether the sensor has a fault: 1 or 0.
    SensorFault,
    /// Seconds without a record, by the caller's clock. A record ends it.
    StaleS,
    /// A condition indicator by name, in its own unit.
    Indicator(String),
    /// Rate of change of a quantity, in its unit per day.
    RatePerDay(RatedQuantity),
}

/// A quantity whose rate of change can be watched.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum RatedQuantity {
    /// The median wear depth in µm.
    WearUm,
    /// The novelty score.
    Novelty,
    /// A condition indicator by name, in its own unit.
    Indicator(String),
}

impl AlarmQuantity {
    /// Returns the quantity's value in a record's results (for a rate, the value that changes), or `None`
    /// where there is none. `indicators` are those of the record and those of the run up to it.
    pub fn value(&self, wear: &WearEstimate, indicators: [&Indicators; 2]) -> Option<f64> {
        let indicator = |name: &str| indicators.iter().find_map(|indicators| indicators.get(name));
        let novelty = || wear.novelty.as_ref().map(|novelty| novelty.score);
        match self {
            Self::WearUm | Self::RatePerDay(RatedQuantity::WearUm) => wear.determined_depth_um(),
            Self::WearAboveLimit => wear.above_limit.filter(|_| wear.status != WearStatus::Provisional),
            Self::Novelty | Self::RatePerDay(RatedQuantity::Novelty) => novelty(),
            Self::JointNovelty => None,
            Self::SensorFault => sensor_fault(wear),
            Self::StaleS => Some(0.0),
            Self::Indicator(name) | Self::RatePerDay(RatedQuantity::Indicator(name)) => indicator(name),
        }
    }

    /// Returns the name of the indicator that is watched, directly or by its rate.
    pub fn indicator(&self) -> Option<&str> {
        match self {
            Self::Indicator(name) | Self::RatePerDay(RatedQuantity::Indicator(name)) => Some(name),
            _ => None,
        }
    }

    /// Whether the quantity measures wear, which belongs to a gear and not to its sensor.
    pub fn is_wear(&self) -> bool {
        matches!(self, Self::WearUm | Self::WearAboveLimit | Self::RatePerDay(RatedQuantity::WearUm))
    }

    /// Whether an event makes earlier readings irrelevant.
    pub(super) fn is_reset_by(&self, event: MaintenanceKind) -> bool {
        match event {
            // Maintenance does not end the silence of a channel.
            _ if *self == Self::StaleS => false,
            MaintenanceKind::GearReplaced | MaintenanceKind::BaselineChosen => true,
            MaintenanceKind::Inspected => false,
            MaintenanceKind::SensorReplaced | MaintenanceKind::RegimeChanged => !self.is_wear(),
        }
    }
}

/// Returns `None` where the record was not judged, for example while the baseline is collected.
fn sensor_fault(wear: &WearEstimate) -> Option<f64> {
    let is_fault = wear.status == WearStatus::SensorFault || wear.novelty.as_ref()?.sensor_fault.is_some();
    Some(f64::from(u8::from(is_fault)))
}

impl fmt::Display for AlarmQuantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WearUm => f.write_str("wear_um"),
            Self::WearAboveLimit => f.write_str("wear_above_limit"),
            Self::Novelty => f.write_str("novelty"),
            Self::JointNovelty => f.write_str("joint_novelty"),
            Self::SensorFault => f.write_str("sensor_fault"),
            Self::StaleS => f.write_str("stale_s"),
            Self::Indicator(name) => write!(f, "indicator:{name}"),
            Self::RatePerDay(RatedQuantity::WearUm) => f.write_str("rate_per_day:wear_um"),
            Self::RatePerDay(RatedQuantity::Novelty) => f.write_str("rate_per_day:novelty"),
            Self::RatePerDay(RatedQuantity::Indicator(name)) => write!(f, "rate_per_day:indicator:{name}"),
        }
    }
}
