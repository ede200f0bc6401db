//! What an alarm watches, and when it is raised and cleared.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::AlarmError;
use crate::estimate::{MaintenanceKind, WearEstimate};
use flankwatch_signal::Indicators;

/// What a rule watches.
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
    /// A condition indicator by name, in its own unit.
    Indicator(String),
}

impl AlarmQuantity {
    /// The value in a record's results; none where there is none. `indicators` gives those of the record and of the run up to it.
    pub fn value(&self, wear: &WearEstimate, indicators: [&Indicators; 2]) -> Option<f64> {
        match self {
            Self::WearUm => wear.median_um,
            Self::WearAboveLimit => wear.above_limit,
            Self::Novelty => wear.novelty.as_ref().map(|novelty| novelty.score),
            Self::Indicator(name) => indicators.iter().find_map(|indicators| indicators.get(name)),
        }
    }

    /// Whether it judges wear: what was read of a gear says nothing of the one that replaces it.
    fn is_wear(&self) -> bool {
        matches!(self, Self::WearUm | Self::WearAboveLimit)
    }

    /// Whether readings before an event say nothing of those after it.
    pub(super) fn begins_again(&self, event: MaintenanceKind) -> bool {
        match event {
            MaintenanceKind::GearReplaced | MaintenanceKind::BaselineChosen => true,
            MaintenanceKind::Inspected => false,
            MaintenanceKind::SensorReplaced | MaintenanceKind::RegimeChanged => !self.is_wear(),
        }
    }
}

impl fmt::Display for AlarmQuantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WearUm => f.write_str("wear_um"),
            Self::WearAboveLimit => f.write_str("wear_above_limit"),
            Self::Novelty => f.write_str("novelty"),
            Self::Indicator(name) => write!(f, "indicator:{name}"),
        }
    }
}

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Look at it.
    Warning,
    /// Act now.
    Danger,
}

impl Severity {
    /// Its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Warning => "warning",
            Self::Danger => "danger",
        }
    }

    /// The one of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Warning, Self::Danger].into_iter().find(|severity| severity.name() == name)
    }
}

/// When an alarm is raised and cleared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct AlarmRule {
    /// What is watched.
    pub quantity: AlarmQuantity,
    /// A reading above this warns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<f64>,
    /// A reading above this is dangerous.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub danger: Option<f64>,
    /// How far below its level a reading has to lie to clear it.
    #[serde(default)]
    pub hysteresis: f64,
    /// How many of the last readings decide.
    #[serde(default)]
    pub settings: AlarmSettings,
}

/// N of M, for raising and for clearing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct AlarmSettings {
    /// So many ...
    pub raise: u32,
    /// ... of the last so many readings above a level raise it.
    pub raise_of: u32,
    /// So many ...
    pub clear: u32,
    /// ... of the last so many readings below its clear level clear it.
    pub clear_of: u32,
}

impl Default for AlarmSettings {
    fn default() -> Self {
        Self {
            raise: 3,
            raise_of: 5,
            clear: 5,
            clear_of: 5,
        }
    }
}

/// The most readings that a rule may look back on.
const MOST_READINGS: u32 = 100;

impl AlarmRule {
    /// Whether every number can be used.
    ///
    /// # Errors
    /// The first one that cannot, with what was expected.
    pub fn validate(&self) -> Result<(), AlarmError> {
        let refuse = |field, value, expected| Err(AlarmError::Field { field, value, expected });
        for (field, level) in [("warning", self.warning), ("danger", self.danger)] {
            if let Some(value) = level.filter(|value| !value.is_finite()) {
                return refuse(field, value, "a finite number");
            }
        }
        match (self.warning, self.danger) {
            (None, None) => return Err(AlarmError::NoLevel),
            (Some(warning), Some(danger)) if danger <= warning => return refuse("danger", danger, "a level above the warning's"),
            _ => {}
        }
        if !(self.hysteresis >= 0.0 && self.hysteresis.is_finite()) {
            return refuse("hysteresis", self.hysteresis, "a finite number of at least 0");
        }
        let AlarmSettings {
            raise,
            raise_of,
            clear,
            clear_of,
        } = self.settings;
        for (field, some, of) in [("raise", raise, raise_of), ("clear", clear, clear_of)] {
            if some == 0 || some > of || of > MOST_READINGS {
                return refuse(
                    field,
                    f64::from(some),
                    "a number from 1 to that of the readings looked back on, at most 100",
                );
            }
        }
        Ok(())
    }

    /// The level of a severity, where it has one.
    pub(super) fn level(&self, severity: Severity) -> Option<f64> {
        match severity {
            Severity::Warning => self.warning,
            Severity::Danger => self.danger,
        }
    }
}
