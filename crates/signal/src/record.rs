//! A validated vibration record of one channel.

use std::borrow::Cow;

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::shaft_angle::{PulseError, ShaftAngle};

/// Longest record accepted: 2²⁴ samples, 14 minutes at 20 kHz and 64 MiB of `f32`.
pub const MAX_RECORD_SAMPLES: usize = 1 << 24;

/// Highest sampling rate in hertz.
const MAX_SAMPLE_RATE_HZ: f64 = 10e6;

/// Lowest sampling rate in hertz, so that every record has a finite duration.
const MIN_SAMPLE_RATE_HZ: f64 = 1e-6;

/// Highest shaft speed in hertz, and largest torque in N·m and temperature in °C: products of them remain
/// finite.
const MAX_SHAFT_SPEED_HZ: f64 = 1e6;
const MAX_OPERATING_VALUE: f64 = 1e12;

/// The operating point of the machine during a record, as far as known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct OperatingPoint {
    /// Rotational frequency of the driving (pinion) shaft in hertz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in newton metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_nm: Option<f64>,
    /// Oil or housing temperature in degrees Celsius; stored, but not used in computations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
}

impl OperatingPoint {
    /// Checks the operating point of a record, during which the shaft turns.
    ///
    /// # Errors
    /// [`RecordError::OperatingPoint`] with the value that is out of range.
    pub fn check(&self) -> Result<(), RecordError> {
        if let Some(value) = self.shaft_speed_hz
            && !(value > 0.0 && value <= MAX_SHAFT_SPEED_HZ)
        {
            return Err(RecordError::OperatingPoint {
                field: "shaft_speed_hz",
                value,
                expected: "a number above 0 and at most 1e6",
            });
        }
        for (field, value) in [("torque_nm", self.torque_nm), ("temperature_c", self.temperature_c)] {
            if let Some(value) = value
                && !(-MAX_OPERATING_VALUE..=MAX_OPERATING_VALUE).contains(&value)
            {
                return Err(RecordError::OperatingPoint {
                    field,
                    value,
                    expected: "a number from -1e12 to 1e12",
                });
            }
        }
        Ok(())
    }
}

/// Quality flags of a record's samples, set by the acquisition.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Quality {
    /// At least one sample was at the converter's limit.
    pub clipped: bool,
    /// Samples are missing between this record and the previous one. The record itself is complete.
    pub gap: bool,
}

/// The pulses of a tachometer during a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Tachometer {
    /// Pulse times in seconds after the record's first sample; negative before it.
    pub pulse_times_s: Vec<f64>,
    /// Pulses per revolution of the driving shaft.
    pub pulses_per_revolution: u32,
}

/// A record that owns its samples.
pub type Record = RecordOf<'static>;

/// A validated vibration record of samples that it owns or borrows: at least one sample, all finite, at a
/// plausible rate.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordOf<'a> {
    channel: String,
    start_time: Timestamp,
    sample_rate_hz: f64,
    unit: String,
    source_scale: Option<f64>,
    samples: Cow<'a, [f32]>,
    operating_point: OperatingPoint,
    quality: Quality,
    tachometer: Option<Tachometer>,
    /// Turns of the analysed shaft per turn of the shaft with the tachometer.
    shaft_turns: f64,
}

/// Why samples do not form a valid record.
#[derive(Debug, Error, PartialEq)]
pub enum RecordError {
    /// There are no samples.
    #[error("channel {channel:?} has no samples, expected at least one")]
    Empty {
        /// Name of the channel.
        channel: String,
    },
    /// More samples than one record may have.
    #[error(
        "channel {channel:?} has {samples} samples, expected at most {MAX_RECORD_SAMPLES}: cut the recording into shorter records"
    )]
    TooLong {
        /// Name of the channel.
        channel: String,
        /// Number of samples.
        samples: usize,
    },
    /// A sample that is NaN or infinite.
    #[error(
        "channel {channel:?} has {value} at sample {index}, expected finite samples ({count} of {samples} are not)"
    )]
    NotFinite {
        /// Name of the channel.
        channel: String,
        /// Index of the first such sample.
        index: usize,
        /// The value.
        value: f32,
        /// Number of such samples.
        count: usize,
        /// Total number of samples.
        samples: usize,
    },
    /// A unit that cannot be converted to the expected one.
    #[error(
        "unit of channel {channel:?} is {found:?}, expected {expected:?} as described or as in its other records{others}",
        others = if *is_acceleration { ", or a unit that converts to it (m/s2, mm/s2, g, mg)" } else { "" }
    )]
    Unit {
        /// Name of the channel.
        channel: String,
        /// Unit of the record.
        found: String,
        /// Expected unit.
        expected: String,
        /// Whether it is a unit of acceleration, to which others convert.
        is_acceleration: bool,
    },
    /// A sampling rate outside the accepted range.
    #[error("sample_rate_hz is {0}, expected a number from {MIN_SAMPLE_RATE_HZ} to {MAX_SAMPLE_RATE_HZ}")]
    SampleRate(f64),
    /// A shaft speed, torque or temperature outside the accepted range.
    #[error("{field} is {value}, expected {expected}")]
    OperatingPoint {
        /// Name of the field.
        field: &'static str,
        /// The value.
        value: f64,
        /// The accepted range.
        expected: &'static str,
    },
}

impl RecordError {
    /// Returns the field with an invalid value, the value, and what was expected, where the error is about
    /// one.
    pub fn invalid_field(&self) -> Option<(&'static str, String, String)> {
        match self {
            Self::OperatingPoint { field, value, expected } => {
                Some((field, value.to_string(), (*expected).to_owned()))
            }
            Self::SampleRate(rate) => {
                let expected = format!("a number from {MIN_SAMPLE_RATE_HZ} to {MAX_SAMPLE_RATE_HZ}");
                Some(("sample_rate_hz", rate.to_string(), expected))
            }
            Self::Unit { found, expected, .. } => Some(("unit", found.clone(), expected.clone())),
            _ => None,
        }
    }
}

fn check_finite(channel: &str, samples: &[f32]) -> Result<(), RecordError> {
    let Some(index) = samples.iter().position(|x| !x.is_finite()) else {
        return Ok(());
    };
    Err(RecordError::NotFinite {
        channel: channel.to_owned(),
        index,
        value: samples[index],
        count: samples.iter().filter(|x| !x.is_finite()).count(),
        samples: samples.len(),
    })
}

impl Record {
    /// Checks the parts and creates a record.
    ///
    /// `start_time` is that of the first sample, `sample_rate_hz` the measured rate, `unit` the samples' unit
    /// as the source states it (`"m/s2"`, `"g"`, `"1"` if unknown).
    pub fn new(
        channel: impl Into<String>,
        start_time: Timestamp,
        sample_rate_hz: f64,
        unit: impl Into<String>,
        samples: Vec<f32>,
    ) -> Result<Self, RecordError> {
        Self::checked(channel.into(), start_time, sample_rate_hz, unit.into(), Cow::Owned(samples))
    }
}

impl<'a> RecordOf<'a> {
    /// Checks the parts and creates a record that borrows its samples; otherwise like [`Record::new`].
    pub fn borrowing(
        channel: impl Into<String>,
        start_time: Timestamp,
        sample_rate_hz: f64,
        unit: impl Into<String>,
        samples: &'a [f32],
    ) -> Result<Self, RecordError> {
        Self::checked(channel.into(), start_time, sample_rate_hz, unit.into(), Cow::Borrowed(samples))
    }

    fn checked(
        channel: String,
        start_time: Timestamp,
        sample_rate_hz: f64,
        unit: String,
        samples: Cow<'a, [f32]>,
    ) -> Result<Self, RecordError> {
        if !(MIN_SAMPLE_RATE_HZ..=MAX_SAMPLE_RATE_HZ).contains(&sample_rate_hz) {
            return Err(RecordError::SampleRate(sample_rate_hz));
        }
        if samples.is_empty() {
            return Err(RecordError::Empty { channel });
        }
        if samples.len() > MAX_RECORD_SAMPLES {
            return Err(RecordError::TooLong { channel, samples: samples.len() });
        }
        check_finite(&channel, &samples)?;
        Ok(Self {
            channel,
            start_time,
            sample_rate_hz,
            unit,
            source_scale: None,
            samples,
            operating_point: OperatingPoint::default(),
            quality: Quality::default(),
            tachometer: None,
            shaft_turns: 1.0,
        })
    }

    /// Sets the operating point.
    pub fn with_operating_point(mut self, operating_point: OperatingPoint) -> Result<Self, RecordError> {
        operating_point.check()?;
        self.operating_point = operating_point;
        Ok(self)
    }

    /// Multiplies every sample by `factor` and sets the resulting unit.
    pub(crate) fn scaled(mut self, factor: f64, unit: &str) -> Result<Self, RecordError> {
        for sample in self.samples.to_mut() {
            *sample = (f64::from(*sample) * factor) as f32;
        }
        check_finite(&self.channel, &self.samples)?;
        unit.clone_into(&mut self.unit);
        self.source_scale = self.source_scale.map(|scale| scale * factor);
        Ok(self)
    }

    /// Sets the channel name.
    pub fn with_channel(mut self, channel: impl Into<String>) -> Self {
        self.channel = channel.into();
        self
    }

    /// Sets the factor by which the values of the source were multiplied to get the samples: finite and not
    /// 0. It is metadata; the samples stay as they are.
    pub fn with_source_scale(mut self, source_scale: Option<f64>) -> Self {
        self.source_scale = source_scale;
        self
    }

    /// Sets the quality flags.
    pub fn with_quality(mut self, quality: Quality) -> Self {
        self.quality = quality;
        self
    }

    /// Sets the tachometer pulses. Unusable pulses are not an error here: the analysis reports why it did not
    /// use them.
    pub fn with_tachometer(mut self, tachometer: Option<Tachometer>) -> Self {
        self.tachometer = tachometer;
        self
    }

    /// Refers the record to another shaft, which makes `turns` (above 0) per turn of the shaft that speed,
    /// torque and tachometer belong to. The speed is multiplied by `turns`, the torque divided (mesh losses
    /// are small), and pulses are counted in its turns.
    pub fn referred_to_shaft(mut self, turns: f64) -> Self {
        let point = &mut self.operating_point;
        point.shaft_speed_hz = point.shaft_speed_hz.map(|speed| speed * turns);
        point.torque_nm = point.torque_nm.map(|torque| torque / turns);
        self.shaft_turns *= turns;
        self
    }

    /// Returns the measuring channel, for example `"gearbox/x"` or `"1"`.
    pub fn channel(&self) -> &str {
        &self.channel
    }

    /// Returns the time of the first sample.
    pub fn start_time(&self) -> Timestamp {
        self.start_time
    }

    /// Returns the sampling rate in hertz.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Returns the samples' unit.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// Returns the factor by which the values of the source were multiplied, if they were.
    pub fn source_scale(&self) -> Option<f64> {
        self.source_scale
    }

    /// Returns the samples, in [`unit`](Self::unit).
    pub fn samples(&self) -> &[f32] {
        &self.samples
    }

    /// Returns the operating point, as far as known.
    pub fn operating_point(&self) -> OperatingPoint {
        self.operating_point
    }

    /// Returns the quality flags.
    pub fn quality(&self) -> Quality {
        self.quality
    }

    /// Returns the tachometer pulses, if any.
    pub fn tachometer(&self) -> Option<&Tachometer> {
        self.tachometer.as_ref()
    }

    /// Returns the angle of the analysed shaft from the tachometer pulses, or why they give none; `None`
    /// without a tachometer.
    pub(super) fn tachometer_angle(&self) -> Option<Result<ShaftAngle, PulseError>> {
        let Tachometer { pulse_times_s, pulses_per_revolution } = self.tachometer.as_ref()?;
        Some(ShaftAngle::from_pulses(pulse_times_s, *pulses_per_revolution, self.shaft_turns))
    }

    /// Returns the record's duration in seconds.
    pub fn duration_s(&self) -> f64 {
        self.samples.len() as f64 / self.sample_rate_hz
    }

    /// Returns the time at which the record ends, at most the last one that can be represented.
    pub fn end_time(&self) -> Timestamp {
        let length = SignedDuration::try_from_secs_f64(self.duration_s()).unwrap_or(SignedDuration::MAX);
        self.start_time.saturating_add(length).unwrap_or(Timestamp::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(samples: Vec<f32>) -> Result<Record, RecordError> {
        Record::new("1", Timestamp::UNIX_EPOCH, 20_000.0, "m/s2", samples)
    }

    #[test]
    fn one_sample_is_a_record() {
        assert_eq!(record(vec![1.0]).unwrap().duration_s(), 5e-5);
    }

    #[test]
    fn a_geared_shaft_turns_at_its_own_speed() {
        let point = OperatingPoint {
            shaft_speed_hz: Some(30.0),
            torque_nm: Some(100.0),
            ..OperatingPoint::default()
        };
        let tachometer = Tachometer {
            pulse_times_s: (0..40).map(|pulse| f64::from(pulse) / 60.0).collect(),
            pulses_per_revolution: 2,
        };
        let record = record(vec![1.0]).unwrap().with_operating_point(point).unwrap();
        let geared = record.with_tachometer(Some(tachometer)).referred_to_shaft(24.0 / 36.0);
        let OperatingPoint { shaft_speed_hz, torque_nm, .. } = geared.operating_point();
        assert!((shaft_speed_hz.unwrap() - 20.0).abs() < 1e-12 && (torque_nm.unwrap() - 150.0).abs() < 1e-12);
        let angle = geared.tachometer_angle().unwrap().unwrap();
        assert!((angle.mean_speed_hz() - 20.0).abs() < 1e-9);
    }

    #[test]
    fn an_error_names_the_first_bad_sample() {
        let error = record(vec![0.0, f32::INFINITY, f32::NAN]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "channel \"1\" has inf at sample 1, expected finite samples (2 of 3 are not)"
        );
    }

    #[test]
    fn empty_records_and_invalid_rates_are_rejected() {
        assert!(matches!(record(vec![]), Err(RecordError::Empty { .. })));
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
            assert!(matches!(
                Record::new("1", Timestamp::UNIX_EPOCH, rate, "g", vec![0.0]),
                Err(RecordError::SampleRate(_))
            ));
        }
    }
}
