//! Values that a recording may lack.

use std::collections::BTreeMap;

use flankwatch_signal::OperatingPoint;
use jiff::Timestamp;

use super::RecordingError;

/// Millivolts in a volt.
const MV_PER_V: f64 = 1e3;

/// What a time of day without a date means for the start of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TimeOfDay {
    /// Nothing: the start time of the defaults counts.
    #[default]
    Ignored,
    /// The recording starts at the first such time from the start time of the defaults on.
    FromStart,
    /// The recording starts at the last such time up to the start time of the defaults.
    UpToStart,
}

/// Values of a record that the recording itself does not state.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RecordDefaults {
    /// Channel name.
    pub channel: Option<String>,
    /// Names of the channels in order, which replace those in the recording; empty, or one per channel.
    pub channel_names: Vec<String>,
    /// Time of the first sample of the recording.
    pub start_time: Timestamp,
    /// What a time of day in the recording, such as that of a CSV file, means for its start.
    pub time_of_day: TimeOfDay,
    /// Sampling rate in hertz of a recording that may lack it, such as CSV; of a file, instead of a header's.
    pub sample_rate_hz: Option<f64>,
    /// Factor for each value of a WAV, FLAC, CSV, MATLAB or NumPy recording. A full-scale integer of a WAV is
    /// 1 before it is applied.
    pub scale: Option<f64>,
    /// Sensitivity of the sensor in mV/g: converts values that are in volts after `scale`, or in millivolts
    /// if the recording states so, to g.
    pub sensitivity_mv_per_g: Option<f64>,
    /// Unit of the samples.
    pub unit: Option<String>,
    /// Units of single channels by name; they take precedence over `unit`.
    pub channel_units: BTreeMap<String, String>,
    /// Whether every series is a channel in the default unit: also times, counters and logical arrays, and
    /// whatever unit is stated.
    pub every_series: bool,
    /// Operating point. Each field replaces a missing one of the recording.
    pub operating_point: OperatingPoint,
}

impl RecordDefaults {
    /// Returns the names for the channels of a recording without names: the given ones if their number
    /// matches, else `"1"`, `"2"`, ….
    #[must_use]
    pub fn names_of(&self, channels: usize) -> Vec<String> {
        match &self.channel {
            _ if self.channel_names.len() == channels => self.channel_names.clone(),
            Some(name) if channels == 1 => vec![name.clone()],
            _ => (1..=channels).map(|k| k.to_string()).collect(),
        }
    }

    /// Returns the names for the channels of a recording with names: the given ones if their number matches,
    /// else the recording's.
    #[must_use]
    pub(crate) fn names_or(&self, own: Vec<String>) -> Vec<String> {
        if self.channel_names.len() == own.len() || own.len() == 1 && self.channel.is_some() {
            return self.names_of(own.len());
        }
        own
    }

    /// Returns the unit of a channel, and the factor for its values. `stated` is the unit that the recording
    /// states.
    ///
    /// # Errors
    /// A sensitivity is given, and the stated unit is neither V nor mV.
    pub(crate) fn unit_and_scale(
        &self,
        channel: &str,
        stated: Option<&str>,
    ) -> Result<(String, Option<f64>), RecordingError> {
        let Some(sensitivity) = self.sensitivity_mv_per_g else {
            return Ok((stated.unwrap_or_else(|| self.unit_of(channel)).to_owned(), self.scale));
        };
        let millivolts = match stated {
            None | Some("V" | "1") => MV_PER_V,
            Some("mV") => 1.0,
            Some(unit) => {
                let (channel, unit) = (channel.to_owned(), unit.to_owned());
                return Err(RecordingError::NotVolts { channel, unit });
            }
        };
        Ok(("g".to_owned(), Some(self.scale.unwrap_or(1.0) * millivolts / sensitivity)))
    }

    /// Returns the unit of a channel if the recording has none: `"1"` if unknown.
    pub(crate) fn unit_of(&self, channel: &str) -> &str {
        self.channel_units.get(channel).or(self.unit.as_ref()).map_or("1", String::as_str)
    }
}
