//! A decoded block, and its validation.

use jiff::Timestamp;

use super::RecordingError;
use super::error::shortened;
use super::pulses::Pulses;
use super::record_defaults::RecordDefaults;
use flankwatch_signal::{OperatingPoint, Quality, Record};

/// Longest unit in bytes.
const MAX_UNIT_BYTES: usize = 64;

/// Longest channel name in bytes.
pub(crate) const MAX_CHANNEL_BYTES: usize = 256;

/// A decoded block whose fields are not validated yet.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DecodedBlock {
    pub(crate) start_time: Option<Timestamp>,
    pub(crate) sample_rate_hz: f64,
    pub(crate) first_sample_index: u64,
    pub(crate) unit: String,
    pub(crate) channel: String,
    pub(crate) samples: Vec<f32>,
    pub(crate) operating_point: OperatingPoint,
    pub(crate) quality: Quality,
    pub(crate) pulses: Option<Pulses>,
    pub(crate) source_scale: Option<f64>,
}

impl DecodedBlock {
    /// Validates all fields; `channel` overrides the block's own.
    pub(crate) fn into_record(
        self,
        channel: Option<&str>,
        defaults: &RecordDefaults,
    ) -> Result<Record, RecordingError> {
        let given = channel.or(defaults.channel_names.first().map(String::as_str));
        let channel = match (given, self.channel.as_str()) {
            (Some(given), _) => given,
            (None, "") => defaults.channel.as_deref().unwrap_or("1"),
            (None, own) => own,
        };
        if channel.len() > MAX_CHANNEL_BYTES || channel.chars().any(char::is_control) {
            return Err(RecordingError::field(
                "channel",
                format!("{:?}", shortened(channel)),
                "at most 256 bytes without control characters",
            ));
        }
        let unit = if self.unit.is_empty() { defaults.unit_of(channel) } else { &self.unit };
        if unit.len() > MAX_UNIT_BYTES || unit.chars().any(char::is_control) {
            return Err(RecordingError::field(
                "unit",
                format!("{:?}", shortened(unit)),
                "at most 64 bytes without control characters",
            ));
        }
        if let Some(scale) = self.source_scale.filter(|scale| *scale == 0.0 || !scale.is_finite()) {
            return Err(RecordingError::field("source_scale", scale, "a finite number other than 0"));
        }
        let start_time = self.start_time.unwrap_or(defaults.start_time);
        let operating_point = completed_by(self.operating_point, defaults.operating_point);
        let record = Record::new(channel, start_time, self.sample_rate_hz, unit, self.samples)?
            .with_operating_point(operating_point)?;
        let tachometer = self.pulses.and_then(|pulses| pulses.of(start_time));
        let record = record.with_quality(self.quality).with_tachometer(tachometer);
        Ok(record.with_source_scale(self.source_scale))
    }
}

/// Returns the first operating point, with missing fields taken from the second.
pub(crate) fn completed_by(own: OperatingPoint, other: OperatingPoint) -> OperatingPoint {
    OperatingPoint {
        shaft_speed_hz: own.shaft_speed_hz.or(other.shaft_speed_hz),
        torque_nm: own.torque_nm.or(other.torque_nm),
        temperature_c: own.temperature_c.or(other.temperature_c),
    }
}
