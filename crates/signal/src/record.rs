//! One validated stretch of vibration from one measuring channel.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::shaft_angle::{PulseError, ShaftAngle};

/// The longest record taken: 2²⁴ samples, 14 minutes at 20 kHz and 64 MiB of `f32`.
pub const MAX_RECORD_SAMPLES: usize = 1 << 24;

/// The highest sampling rate taken, in hertz.
const MAX_SAMPLE_RATE_HZ: f64 = 10e6;

/// Least sampling rate in hertz: a record has a length in seconds.
const MIN_SAMPLE_RATE_HZ: f64 = 1e-6;

/// Fastest shaft in hertz, and the greatest torque in N·m and temperature in °C: products of them stay
/// finite.
const MAX_SHAFT_SPEED_HZ: f64 = 1e6;
const MAX_OPERATING_VALUE: f64 = 1e12;

/// What the machine was doing while the record was taken, as far as it is known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct OperatingPoint {
    /// Rotational frequency of the driving (pinion) shaft in hertz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in newton metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_nm: Option<f64>,
    /// Oil or housing temperature in degrees Celsius; kept beside the record, nothing is computed with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
}

/// What the acquisition says of a record's samples.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Quality {
    /// At least one sample stood at the converter's limit.
    pub clipped: bool,
    /// Samples are missing between this record and the one before. The record itself is whole.
    pub gap: bool,
}

/// The pulses of a tachometer while a record was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Tachometer {
    /// Seconds after the record's first sample; those before it are negative.
    pub pulse_times_s: Vec<f64>,
    /// Pulses in one revolution of the driving shaft.
    pub pulses_per_revolution: u32,
}

/// A validated vibration record: at least one sample, all finite, at a plausible rate.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    channel: String,
    start_time: Timestamp,
    sample_rate_hz: f64,
    unit: String,
    samples: Vec<f32>,
    operating_point: OperatingPoint,
    quality: Quality,
    tachometer: Option<Tachometer>,
    /// Turns of the shaft that the record is looked at over while the one with the tachometer makes one.
    shaft_turns: f64,
}

/// Why a stretch of samples is not a record.
#[derive(Debug, Error, PartialEq)]
pub enum RecordError {
    /// No sample at all.
    #[error("channel {channel:?} has no samples, expected at least one")]
    Empty {
        /// The channel's name.
        channel: String,
    },
    /// More samples than one record may have.
    #[error(
        "channel {channel:?} has {samples} samples, expected at most {MAX_RECORD_SAMPLES}: cut the recording into shorter records"
    )]
    TooLong {
        /// The channel's name.
        channel: String,
        /// How many samples it has.
        samples: usize,
    },
    /// A sample that is NaN or infinite.
    #[error(
        "channel {channel:?} has {value} at sample {index}, expected finite samples ({count} of {samples} are not)"
    )]
    NotFinite {
        /// The channel's name.
        channel: String,
        /// Index of the first such sample.
        index: usize,
        /// Its value.
        value: f32,
        /// How many such samples there are.
        count: usize,
        /// How many samples there are in all.
        samples: usize,
    },
    /// A unit that cannot be brought to another one.
    #[error(
        "unit of channel {channel:?} is {found:?}, expected {expected:?} as of its other records, or a unit that can be brought to that (m/s2, mm/s2, g, mg)"
    )]
    Unit {
        /// The channel's name.
        channel: String,
        /// The unit of the record.
        found: String,
        /// The unit that is wanted.
        expected: String,
    },
    /// A sampling rate that is not a positive number of a plausible size.
    #[error("sample_rate_hz is {0}, expected a number from {MIN_SAMPLE_RATE_HZ} to {MAX_SAMPLE_RATE_HZ}")]
    SampleRate(f64),
    /// A shaft speed or torque that is not a usable number.
    #[error("{field} is {value}, expected {expected}")]
    OperatingPoint {
        /// Which field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would have been right.
        expected: &'static str,
    },
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
    /// Checks the parts and makes a record of them.
    ///
    /// `start_time` is that of the first sample; `sample_rate_hz` is the measured rate; `unit` is the
    /// samples' unit as the source gave it (`"m/s2"`, `"g"`, `"1"` where unknown).
    pub fn new(
        channel: impl Into<String>,
        start_time: Timestamp,
        sample_rate_hz: f64,
        unit: impl Into<String>,
        samples: Vec<f32>,
    ) -> Result<Self, RecordError> {
        let channel = channel.into();
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
            unit: unit.into(),
            samples,
            operating_point: OperatingPoint::default(),
            quality: Quality::default(),
            tachometer: None,
            shaft_turns: 1.0,
        })
    }

    /// The same record with its operating point.
    pub fn with_operating_point(mut self, operating_point: OperatingPoint) -> Result<Self, RecordError> {
        if let Some(value) = operating_point.shaft_speed_hz
            && !(value > 0.0 && value <= MAX_SHAFT_SPEED_HZ)
        {
            return Err(RecordError::OperatingPoint {
                field: "shaft_speed_hz",
                value,
                expected: "a number above 0 and at most 1e6",
            });
        }
        for (field, value) in
            [("torque_nm", operating_point.torque_nm), ("temperature_c", operating_point.temperature_c)]
        {
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
        self.operating_point = operating_point;
        Ok(self)
    }

    /// The same record with every sample multiplied, in the unit that this makes.
    pub(crate) fn scaled(mut self, factor: f64, unit: &str) -> Result<Self, RecordError> {
        for sample in &mut self.samples {
            *sample = (f64::from(*sample) * factor) as f32;
        }
        check_finite(&self.channel, &self.samples)?;
        unit.clone_into(&mut self.unit);
        Ok(self)
    }

    /// The same record under another channel's name.
    pub fn with_channel(mut self, channel: impl Into<String>) -> Self {
        self.channel = channel.into();
        self
    }

    /// The same record with what its acquisition says of the samples.
    pub fn with_quality(mut self, quality: Quality) -> Self {
        self.quality = quality;
        self
    }

    /// The same record with the pulses of its tachometer. Pulses that give no angle are no error here: the
    /// analysis says why it did not use them.
    pub fn with_tachometer(mut self, tachometer: Option<Tachometer>) -> Self {
        self.tachometer = tachometer;
        self
    }

    /// The same record as seen from another shaft, which makes this many `turns` (above 0) while the one that
    /// speed, torque and tachometer are of makes one: the speed is multiplied by it, the torque divided
    /// (teeth lose little of it), and pulses are counted in its turns.
    pub fn seen_from_shaft(mut self, turns: f64) -> Self {
        let point = &mut self.operating_point;
        point.shaft_speed_hz = point.shaft_speed_hz.map(|speed| speed * turns);
        point.torque_nm = point.torque_nm.map(|torque| torque / turns);
        self.shaft_turns *= turns;
        self
    }

    /// The measuring channel, for example `"gearbox/x"` or `"1"`.
    pub fn channel(&self) -> &str {
        &self.channel
    }

    /// The time of the first sample.
    pub fn start_time(&self) -> Timestamp {
        self.start_time
    }

    /// The sampling rate in hertz.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// The samples' unit.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// The samples, in [`unit`](Self::unit).
    pub fn samples(&self) -> &[f32] {
        &self.samples
    }

    /// What the machine was doing, as far as it is known.
    pub fn operating_point(&self) -> OperatingPoint {
        self.operating_point
    }

    /// What the acquisition says of the samples.
    pub fn quality(&self) -> Quality {
        self.quality
    }

    /// The pulses of a tachometer meanwhile, where there was one.
    pub fn tachometer(&self) -> Option<&Tachometer> {
        self.tachometer.as_ref()
    }

    /// The angle of the shaft that the record is looked at over by the tachometer's pulses, or why they give
    /// none; none without a tachometer.
    pub(super) fn tachometer_angle(&self) -> Option<Result<ShaftAngle, PulseError>> {
        let Tachometer { pulse_times_s, pulses_per_revolution } = self.tachometer.as_ref()?;
        Some(ShaftAngle::from_geared_pulses(pulse_times_s, *pulses_per_revolution, self.shaft_turns))
    }

    /// The record's length in seconds.
    pub fn duration_s(&self) -> f64 {
        self.samples.len() as f64 / self.sample_rate_hz
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
        let geared = record.with_tachometer(Some(tachometer)).seen_from_shaft(24.0 / 36.0);
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
    fn empty_and_bad_rates_are_refused() {
        assert!(matches!(record(vec![]), Err(RecordError::Empty { .. })));
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
            assert!(matches!(
                Record::new("1", Timestamp::UNIX_EPOCH, rate, "g", vec![0.0]),
                Err(RecordError::SampleRate(_))
            ));
        }
    }
}
