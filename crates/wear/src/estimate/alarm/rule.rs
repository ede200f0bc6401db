//! When an alarm is raised and cleared.

use serde::{Deserialize, Serialize};

use super::{AlarmError, AlarmQuantity};

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
    /// A reading below this warns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning_below: Option<f64>,
    /// A reading below this is dangerous.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub danger_below: Option<f64>,
    /// How far on the good side of its level a reading has to lie to clear it.
    #[serde(default)]
    pub hysteresis: f64,
    /// Of a rate, and only of it: over how many seconds the change is measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub over_s: Option<f64>,
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
    /// ... of the last so many readings beyond a level raise it.
    pub raise_of: u32,
    /// So many ...
    pub clear: u32,
    /// ... of the last so many readings on the good side of its clear level clear it.
    pub clear_of: u32,
}

impl Default for AlarmSettings {
    fn default() -> Self {
        Self { raise: 3, raise_of: 5, clear: 5, clear_of: 5 }
    }
}

/// The most readings that a rule may look back on.
const MAX_READINGS: u32 = 100;

/// No level is further from zero than this: with it and any hysteresis a reading can be compared.
const MAX_LEVEL: f64 = 1e30;

/// A change is measured over a second to a hundred years.
const OVER_S: [f64; 2] = [1.0, 3.2e9];

impl AlarmRule {
    /// One for a quantity with no level yet.
    pub fn of(quantity: AlarmQuantity) -> Self {
        Self {
            quantity,
            warning: None,
            danger: None,
            warning_below: None,
            danger_below: None,
            hysteresis: 0.0,
            over_s: None,
            settings: AlarmSettings::default(),
        }
    }

    /// Whether every number can be used.
    ///
    /// # Errors
    /// The first one that cannot, with what was expected.
    pub fn validate(&self) -> Result<(), AlarmError> {
        let refuse = |field, value, expected| Err(AlarmError::Field { field, value, expected });
        let levels = [
            ("warning", self.warning),
            ("danger", self.danger),
            ("warning_below", self.warning_below),
            ("danger_below", self.danger_below),
        ];
        for (field, level) in levels {
            let Some(value) = level else { continue };
            // NaN lies within no bound.
            if !(-MAX_LEVEL..=MAX_LEVEL).contains(&value) {
                return refuse(field, value, "a number from -1e30 to 1e30");
            }
            match self.quantity {
                AlarmQuantity::SensorFault | AlarmQuantity::StaleS if field.ends_with("_below") => {
                    return refuse(
                        field,
                        value,
                        "only levels above which it is raised, with sensor_fault and stale_s",
                    );
                }
                AlarmQuantity::SensorFault if !(value > 0.0 && value < 1.0) => {
                    return refuse(field, value, "a level between 0 and 1, since a reading is 0 or 1");
                }
                AlarmQuantity::StaleS if value <= 0.0 => {
                    return refuse(field, value, "a number of seconds above 0");
                }
                _ => {}
            }
        }
        if !(0.0..=MAX_LEVEL).contains(&self.hysteresis) {
            return refuse("hysteresis", self.hysteresis, "a number from 0 to 1e30");
        }
        self.check_order()?;
        match (&self.quantity, self.over_s) {
            (AlarmQuantity::RatePerDay(_), None) => return Err(AlarmError::NoRateWindow),
            (AlarmQuantity::RatePerDay(_), Some(value)) if !(OVER_S[0]..=OVER_S[1]).contains(&value) => {
                return refuse("over_s", value, "a number of seconds from 1 to 3.2e9");
            }
            (AlarmQuantity::RatePerDay(_), Some(_)) | (_, None) => {}
            (_, Some(value)) => {
                return refuse("over_s", value, "nothing beside a quantity that is no rate_per_day");
            }
        }
        let AlarmSettings { raise, raise_of, clear, clear_of } = self.settings;
        for (field, some, of) in [("raise", raise, raise_of), ("clear", clear, clear_of)] {
            if some == 0 || some > of || of > MAX_READINGS {
                return refuse(
                    field,
                    f64::from(some),
                    "a number from 1 to that of the readings looked back on, at most 100",
                );
            }
        }
        Ok(())
    }

    /// Whether there is a level, and danger lies beyond warning on both sides, with room between the sides.
    fn check_order(&self) -> Result<(), AlarmError> {
        let refuse = |field, value, expected| Err(AlarmError::Field { field, value, expected });
        match (self.warning, self.danger) {
            (Some(warning), Some(danger)) if danger <= warning => {
                return refuse("danger", danger, "a level above the warning's");
            }
            _ => {}
        }
        match (self.warning_below, self.danger_below) {
            (Some(warning), Some(danger)) if danger >= warning => {
                return refuse("danger_below", danger, "a level below that of warning_below");
            }
            _ => {}
        }
        let highest_below = [("warning_below", self.warning_below), ("danger_below", self.danger_below)]
            .into_iter()
            .find_map(|(field, level)| Some((field, level?)));
        match (highest_below, self.warning.or(self.danger)) {
            (None, None) => Err(AlarmError::NoLevel),
            (Some((field, below)), Some(above)) if below + 2.0 * self.hysteresis >= above => refuse(
                field,
                below,
                "a level below those of warning and danger by more than twice the hysteresis",
            ),
            _ => Ok(()),
        }
    }

    /// The level of a severity above which it is raised, where it has one.
    pub(super) fn above(&self, severity: Severity) -> Option<f64> {
        match severity {
            Severity::Warning => self.warning,
            Severity::Danger => self.danger,
        }
    }

    /// The level of a severity below which it is raised, where it has one.
    pub(super) fn below(&self, severity: Severity) -> Option<f64> {
        match severity {
            Severity::Warning => self.warning_below,
            Severity::Danger => self.danger_below,
        }
    }

    /// The severity that so many seconds without a record call for, of a rule of such.
    pub fn severity_of_silence(&self, silent_s: f64) -> Option<Severity> {
        let is_beyond = |severity: &Severity| self.above(*severity).is_some_and(|level| silent_s > level);
        [Severity::Danger, Severity::Warning].into_iter().find(is_beyond)
    }
}
