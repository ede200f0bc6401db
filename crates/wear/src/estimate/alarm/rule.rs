//! Alarm rules: when an alarm is raised and cleared.

use serde::{Deserialize, Serialize};

use super::{AlarmError, AlarmQuantity, Severity};

/// A rule that raises and clears an alarm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct AlarmRule {
    /// The quantity that is watched.
    pub quantity: AlarmQuantity,
    /// A reading above this level is a warning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<f64>,
    /// A reading above this level is a danger.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub danger: Option<f64>,
    /// A reading below this level is a warning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning_below: Option<f64>,
    /// A reading below this level is a danger.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub danger_below: Option<f64>,
    /// Distance from the level, on its good side, at which a reading counts towards clearing.
    #[serde(default)]
    pub hysteresis: f64,
    /// Time in seconds over which the change is measured; required for a rate, invalid otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub over_s: Option<f64>,
    /// Numbers of readings that raise and clear the alarm.
    #[serde(default)]
    pub settings: AlarmSettings,
}

/// N of M readings, for raising and for clearing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct AlarmSettings {
    /// Readings beyond a level that raise the alarm ...
    pub raise: u32,
    /// ... out of the last this many.
    pub raise_of: u32,
    /// Readings on the good side of the clear level that clear the alarm ...
    pub clear: u32,
    /// ... out of the last this many.
    pub clear_of: u32,
}

impl Default for AlarmSettings {
    fn default() -> Self {
        Self { raise: 3, raise_of: 5, clear: 5, clear_of: 5 }
    }
}

/// Largest number of readings that a rule may look back on.
const MAX_READINGS: u32 = 100;

/// Largest magnitude of a level, small enough that sums with the hysteresis stay finite.
const MAX_LEVEL: f64 = 1e30;

/// Range in seconds of the time over which a change is measured: one second to a hundred years.
const OVER_S: [f64; 2] = [1.0, 3.2e9];

impl AlarmRule {
    /// Creates a rule for a quantity, without levels.
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

    /// Checks the rule.
    ///
    /// # Errors
    /// The first number that is invalid, with the expected value.
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
            // NaN is in no range.
            if !(-MAX_LEVEL..=MAX_LEVEL).contains(&value) {
                return refuse(field, value, "a number from -1e30 to 1e30");
            }
            match self.quantity {
                AlarmQuantity::SensorFault | AlarmQuantity::StaleS if field.ends_with("_below") => {
                    return refuse(field, value, "no lower level for sensor_fault and stale_s");
                }
                AlarmQuantity::SensorFault if !(value > 0.0 && value < 1.0) => {
                    return refuse(field, value, "a level between 0 and 1, as a reading is 0 or 1");
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
                return refuse("over_s", value, "no over_s with a quantity other than rate_per_day");
            }
        }
        let AlarmSettings { raise, raise_of, clear, clear_of } = self.settings;
        for (field, of) in [("raise_of", raise_of), ("clear_of", clear_of)] {
            if !(1..=MAX_READINGS).contains(&of) {
                return refuse(field, f64::from(of), "a number of readings from 1 to 100");
            }
        }
        for (field, some, of, expected) in [
            ("raise", raise, raise_of, "at least 1 and at most raise_of"),
            ("clear", clear, clear_of, "at least 1 and at most clear_of"),
        ] {
            if !(1..=of).contains(&some) {
                return refuse(field, f64::from(some), expected);
            }
        }
        Ok(())
    }

    /// Checks that there is a level, that danger lies beyond warning on both sides, and that the sides are
    /// further apart than twice the hysteresis.
    fn check_order(&self) -> Result<(), AlarmError> {
        let refuse = |field, value, expected| Err(AlarmError::Field { field, value, expected });
        match (self.warning, self.danger) {
            (Some(warning), Some(danger)) if danger <= warning => {
                return refuse("danger", danger, "a level above warning");
            }
            _ => {}
        }
        match (self.warning_below, self.danger_below) {
            (Some(warning), Some(danger)) if danger >= warning => {
                return refuse("danger_below", danger, "a level below warning_below");
            }
            _ => {}
        }
        let highest_below = [("warning_below", self.warning_below), ("danger_below", self.danger_below)]
            .into_iter()
            .find_map(|(field, level)| Some((field, level?)));
        match (highest_below, self.warning.or(self.danger)) {
            (None, None) => Err(AlarmError::NoLevel),
            (Some((field, below)), Some(above)) if below + 2.0 * self.hysteresis >= above => {
                refuse(field, below, "a level more than twice the hysteresis below warning and danger")
            }
            _ => Ok(()),
        }
    }

    /// Returns the level above which a severity is raised, where there is one.
    pub(super) fn above(&self, severity: Severity) -> Option<f64> {
        match severity {
            Severity::Warning => self.warning,
            Severity::Danger => self.danger,
        }
    }

    /// Returns the level below which a severity is raised, where there is one.
    pub(super) fn below(&self, severity: Severity) -> Option<f64> {
        match severity {
            Severity::Warning => self.warning_below,
            Severity::Danger => self.danger_below,
        }
    }

    /// Returns the severity that this time in seconds without a record calls for, by a rule on `stale_s`.
    pub fn severity_of_silence(&self, silent_s: f64) -> Option<Severity> {
        let is_beyond = |severity: &Severity| self.above(*severity).is_some_and(|level| silent_s > level);
        [Severity::Danger, Severity::Warning].into_iter().find(is_beyond)
    }
}
