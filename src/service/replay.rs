//! A replay: its request, and its state.

use std::str::FromStr;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::error::ServiceError;
use crate::asset::AssetId;
use crate::recording::{RecordDefaults, TimeOfDay};

/// The pace of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Pace {
    /// As fast as it can be processed.
    Max,
    /// This factor times the speed of the recording.
    Times(f64),
}

impl FromStr for Pace {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "max" => Ok(Self::Max),
            "realtime" => Ok(Self::Times(1.0)),
            _ => match text.strip_suffix('x').map(str::parse::<f64>) {
                Some(Ok(times)) if times > 0.0 && times <= 1e6 => Ok(Self::Times(times)),
                _ => Err(format!(
                    "pace is {text:?}, expected \"max\", \"realtime\" or a number above 0 and at most 1000000 with an x, such as \"10x\""
                )),
            },
        }
    }
}

impl TryFrom<String> for Pace {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Pace> for String {
    fn from(pace: Pace) -> Self {
        match pace {
            Pace::Max => "max".into(),
            Pace::Times(1.0) => "realtime".into(),
            Pace::Times(times) => format!("{times}x"),
        }
    }
}

/// The request of a replay.
#[derive(Debug, Clone, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReplayRequest {
    /// The asset that receives the records.
    pub asset: AssetId,
    /// The recording, relative to the replay folder.
    #[schema(example = "run.mcap")]
    pub file: String,
    /// The pace: `max`, `realtime` or a factor such as `10x`.
    #[serde(default = "Pace::max")]
    #[schema(value_type = String, example = "max", pattern = r"^(max|realtime|[0-9.]+x)$")]
    pub pace: Pace,
    /// What the recording does not contain.
    #[serde(default)]
    pub recording: ReplayValues,
}

/// Values that a replayed recording may lack.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ReplayValues {
    /// Time of the first sample; a time of day in the recording counts from there on. By default the time of
    /// the request, and a time of day counts up to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_time: Option<Timestamp>,
    /// Sampling rate in hertz.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = 12800.0)]
    pub sample_rate_hz: Option<f64>,
    /// Unit of the samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "m/s2")]
    pub unit: Option<String>,
    /// Factor for each value; full-scale integers of WAV and FLAC are 1 before it is applied.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Length in seconds of the records that a long recording is cut into.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub record_seconds: Option<f64>,
}

impl ReplayValues {
    /// Checks the values.
    ///
    /// # Errors
    /// [`ServiceError::Field`].
    pub(crate) fn check(&self) -> Result<(), ServiceError> {
        let wrong = |field, value: f64, expected: &'static str| {
            Err(ServiceError::Field { field, value: value.to_string(), expected: expected.into() })
        };
        let is_positive = |value: &f64| *value > 0.0 && value.is_finite();
        match *self {
            Self { sample_rate_hz: Some(rate), .. } if !is_positive(&rate) => {
                wrong("recording.sample_rate_hz", rate, "a rate above 0")
            }
            Self { record_seconds: Some(seconds), .. } if !is_positive(&seconds) => {
                wrong("recording.record_seconds", seconds, "a length above 0")
            }
            Self { scale: Some(scale), .. } if scale == 0.0 || !scale.is_finite() => {
                wrong("recording.scale", scale, "a finite number other than 0")
            }
            _ => Ok(()),
        }
    }

    /// Completes the default values for an asset's records.
    pub(crate) fn complete(&self, defaults: &mut RecordDefaults) {
        if let Some(start_time) = self.start_time {
            defaults.start_time = start_time;
        }
        defaults.time_of_day = match self.start_time {
            Some(_) => TimeOfDay::FromStart,
            None => TimeOfDay::UpToStart,
        };
        defaults.sample_rate_hz = self.sample_rate_hz;
        defaults.scale = self.scale;
        if self.unit.is_some() {
            defaults.unit.clone_from(&self.unit);
            defaults.channel_units.clear();
        }
    }
}

impl Pace {
    fn max() -> Self {
        Self::Max
    }
}

/// The state of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReplayState {
    /// It is running.
    Running,
    /// It reached the end of the recording.
    Finished,
    /// It was stopped.
    Stopped,
    /// It failed.
    Failed,
}

/// A replay and its progress.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Replay {
    /// Identifier.
    pub id: String,
    /// The asset that receives the records.
    pub asset: AssetId,
    /// The recording, relative to the replay folder.
    pub file: String,
    /// The pace: `max`, `realtime` or a factor such as `10x`.
    #[schema(value_type = String, example = "max")]
    pub pace: Pace,
    /// What the recording does not contain.
    #[serde(default)]
    pub recording: ReplayValues,
    /// The state.
    pub state: ReplayState,
    /// Why it failed, or why the first refused record was refused.
    pub error: Option<String>,
    /// Records in the recording; known at its end.
    pub records_total: Option<u64>,
    /// Records processed, including refused ones.
    pub records_done: u64,
    /// Records stored.
    pub stored: u64,
    /// Records that were stored before.
    pub repeated: u64,
    /// Records refused.
    pub refused: u64,
    /// The time of the start.
    pub started_at: Timestamp,
    /// The time of the end.
    pub finished_at: Option<Timestamp>,
    /// Start of the earliest processed record.
    pub first_start_time: Option<Timestamp>,
    /// Start of the latest processed record.
    pub last_start_time: Option<Timestamp>,
    /// Total length of the processed records in seconds.
    pub record_seconds_done: f64,
    /// Total length of the processed records divided by the time it took.
    pub times_real_time: Option<f64>,
}

impl Replay {
    /// Creates a replay that starts; its identifier is assigned later.
    pub(crate) fn begin(request: ReplayRequest, started_at: Timestamp) -> Self {
        Self {
            id: String::new(),
            asset: request.asset,
            file: request.file,
            pace: request.pace,
            recording: request.recording,
            state: ReplayState::Running,
            error: None,
            records_total: None,
            records_done: 0,
            stored: 0,
            repeated: 0,
            refused: 0,
            started_at,
            finished_at: None,
            first_start_time: None,
            last_start_time: None,
            record_seconds_done: 0.0,
            times_real_time: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paces_round_trip() {
        for (text, pace) in [
            ("max", Pace::Max),
            ("realtime", Pace::Times(1.0)),
            ("10x", Pace::Times(10.0)),
            ("0.5x", Pace::Times(0.5)),
        ] {
            assert_eq!(text.parse(), Ok(pace));
            assert_eq!(String::from(pace), text);
        }
        for text in ["", "x", "10", "-1x", "0x", "NaNx", "infx", "fast"] {
            assert!(text.parse::<Pace>().is_err(), "{text}");
        }
    }
}
