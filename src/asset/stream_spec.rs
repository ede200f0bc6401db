//! The rules by which records are cut out of live streams.

use serde::{Deserialize, Serialize};

use super::error::{AssetError, field};

/// The name of a stream that is not given one.
pub const DEFAULT_STREAM: &str = "main";

/// Minimum and maximum length of a record in seconds.
const RECORD_S: std::ops::RangeInclusive<f64> = 0.1..=600.0;

/// Maximum interval in seconds: a day.
const MAX_INTERVAL_S: f64 = 86_400.0;

/// Range of the permitted relative change of speed or torque of a steady machine.
const FRACTION: std::ops::RangeInclusive<f64> = 0.0..=0.5;

/// Maximum time in seconds for which a machine has to be steady.
const MAX_STEADY_S: f64 = 3600.0;

/// How records are cut out of the asset's live streams.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StreamSpec {
    /// Length of a record in seconds, 0.1 to 600.
    #[serde(default = "default_record_s")]
    pub record_s: f64,
    /// Seconds from the start of one record to the start of the next. If equal to `record_s`, all samples
    /// become records; if 0, records are cut only on demand.
    #[serde(default = "default_interval_s")]
    pub interval_s: f64,
    /// If given, records are cut while the machine is steady, instead of by `interval_s`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steady: Option<SteadySpec>,
    /// If given, additional records are cut when an alarm of the asset is raised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on_alarm: Option<OnAlarmSpec>,
}

/// When a machine counts as steady, judged by the speed and torque given by the sender.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SteadySpec {
    /// Permitted relative change of the speed, 0 to 0.5: 0.02 is ± 2 %.
    #[serde(default = "default_speed_fraction")]
    pub speed_fraction: f64,
    /// Permitted relative change of the torque, 0 to 0.5.
    #[serde(default = "default_torque_fraction")]
    pub torque_fraction: f64,
    /// Seconds for which the machine has to be steady, at most 3600; at least the length of a record in any
    /// case.
    #[serde(default = "default_for_s")]
    pub for_s: f64,
    /// Minimum seconds from the start of one record to the start of the next in the same operating bin, at
    /// most a day.
    #[serde(default = "default_at_most_every_s")]
    pub at_most_every_s: f64,
}

/// The range of samples around an alarm that become records.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OnAlarmSpec {
    /// Seconds before the alarm, 0 to 60.
    #[serde(default = "default_around_s")]
    pub before_s: f64,
    /// Seconds after the alarm, 0 to 600.
    #[serde(default = "default_around_s")]
    pub after_s: f64,
}

fn default_record_s() -> f64 {
    10.0
}

fn default_interval_s() -> f64 {
    60.0
}

fn default_speed_fraction() -> f64 {
    0.02
}

fn default_torque_fraction() -> f64 {
    0.05
}

fn default_for_s() -> f64 {
    10.0
}

fn default_at_most_every_s() -> f64 {
    3600.0
}

fn default_around_s() -> f64 {
    30.0
}

impl Default for StreamSpec {
    fn default() -> Self {
        Self { record_s: default_record_s(), interval_s: default_interval_s(), steady: None, on_alarm: None }
    }
}

impl StreamSpec {
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn validate(&self) -> Result<(), AssetError> {
        if !RECORD_S.contains(&self.record_s) {
            return Err(field("stream.record_s", self.record_s, "a length from 0.1 to 600"));
        }
        if self.interval_s != 0.0 && !(self.record_s..=MAX_INTERVAL_S).contains(&self.interval_s) {
            return Err(field(
                "stream.interval_s",
                self.interval_s,
                "0, or at least stream.record_s and at most 86400",
            ));
        }
        self.steady.map_or(Ok(()), |steady| steady.validate(self.record_s))?;
        self.on_alarm.map_or(Ok(()), |around| around.validate())
    }
}

impl SteadySpec {
    fn validate(&self, record_s: f64) -> Result<(), AssetError> {
        let fractions = [
            ("stream.steady.speed_fraction", self.speed_fraction),
            ("stream.steady.torque_fraction", self.torque_fraction),
        ];
        if let Some((name, value)) = fractions.into_iter().find(|(_, value)| !FRACTION.contains(value)) {
            return Err(field(name, value, "a fraction from 0 to 0.5"));
        }
        if !(0.0..=MAX_STEADY_S).contains(&self.for_s) {
            return Err(field("stream.steady.for_s", self.for_s, "a time from 0 to 3600"));
        }
        if !(record_s..=MAX_INTERVAL_S).contains(&self.at_most_every_s) {
            return Err(field(
                "stream.steady.at_most_every_s",
                self.at_most_every_s,
                "at least stream.record_s and at most 86400",
            ));
        }
        Ok(())
    }
}

impl OnAlarmSpec {
    fn validate(&self) -> Result<(), AssetError> {
        if !(0.0..=60.0).contains(&self.before_s) {
            return Err(field("stream.on_alarm.before_s", self.before_s, "a time from 0 to 60"));
        }
        if !(0.0..=600.0).contains(&self.after_s) {
            return Err(field("stream.on_alarm.after_s", self.after_s, "a time from 0 to 600"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> StreamSpec {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn missing_fields_have_defaults_and_invalid_ones_are_named() {
        let steady = read("steady = { for_s = 5 }").steady.unwrap();
        assert_eq!((steady.speed_fraction, steady.at_most_every_s), (0.02, 3600.0));
        assert_eq!(read("on_alarm = {}").on_alarm, Some(OnAlarmSpec { before_s: 30.0, after_s: 30.0 }));
        assert!(read("steady = {}\non_alarm = {}").validate().is_ok());
        for (text, name) in [
            ("steady = { speed_fraction = 0.6 }", "stream.steady.speed_fraction"),
            ("steady = { torque_fraction = -0.1 }", "stream.steady.torque_fraction"),
            ("steady = { for_s = nan }", "stream.steady.for_s"),
            ("steady = { at_most_every_s = 9 }", "stream.steady.at_most_every_s"),
            ("on_alarm = { before_s = 61 }", "stream.on_alarm.before_s"),
            ("on_alarm = { after_s = 601 }", "stream.on_alarm.after_s"),
        ] {
            match read(text).validate() {
                Err(AssetError::Field { field, .. }) => assert_eq!(field, name),
                other => panic!("{text}: {other:?}"),
            }
        }
    }
}
