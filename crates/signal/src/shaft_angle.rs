//! The angle of a shaft over the time of a record: from tachometer pulses, from the phase of a mesh line, or
//! at a constant speed.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::pchip::{Pchip, PchipError};
use super::tachometer_marks::mark_offsets;
use super::transform::Transforms;

/// Largest ratio of successive pulse intervals: above it a pulse is missing, below its reciprocal there is an
/// extra one.
const MAX_INTERVAL_RATIO: f64 = 1.6;

/// Source and accuracy of a shaft angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case", tag = "source")]
pub enum AngleSource {
    /// The pulses of a tachometer.
    Tachometer {
        /// Number of pulses.
        pulses: usize,
        /// Standard deviation of the shaft angle in degrees due to the scatter of the pulses, from their
        /// third differences; none below 5 pulses.
        angle_error_deg: Option<f64>,
    },
    /// The phase of a mesh harmonic, demodulated.
    MeshPhase {
        /// The harmonic.
        harmonic: u32,
        /// Amplitude of the tracked line over the root-mean-square amplitude of the rest that passes the last
        /// filter: noise, sidebands and other lines.
        line_to_background: f64,
        /// Standard deviation of the shaft angle in degrees that results from this ratio.
        angle_error_deg: f64,
    },
    /// The record's shaft speed, assumed constant, as no line could be tracked.
    ConstantSpeed,
}

impl AngleSource {
    /// Refers the source to a shaft that makes `turns` per turn of this one.
    fn geared(self, turns: f64) -> Self {
        match self {
            Self::Tachometer { pulses, angle_error_deg } => {
                Self::Tachometer { pulses, angle_error_deg: angle_error_deg.map(|error| error * turns) }
            }
            Self::MeshPhase { harmonic, line_to_background, angle_error_deg } => {
                Self::MeshPhase { harmonic, line_to_background, angle_error_deg: angle_error_deg * turns }
            }
            Self::ConstantSpeed => Self::ConstantSpeed,
        }
    }
}

/// Why pulses give no shaft angle.
#[derive(Debug, Clone, Copy, Error, PartialEq)]
pub enum PulseError {
    /// Zero pulses per revolution.
    #[error("pulses_per_revolution is 0, expected at least 1")]
    PulsesPerRevolution,
    /// Fewer than two pulses.
    #[error("{0} pulses, expected at least 2")]
    TooFew(usize),
    /// A pulse time that is not finite, or not after the previous one.
    #[error("the time of pulse {0} is not after the previous one, expected finite ascending times")]
    NotRising(usize),
    /// A pulse is missing, or there is an extra one.
    #[error(
        "pulse {index} is {interval_s} s after the previous one, and that one {before_s} s after its predecessor: a pulse is missing or extra"
    )]
    Uneven {
        /// Index of the pulse.
        index: usize,
        /// Time since the previous pulse in seconds.
        interval_s: f64,
        /// The previous interval in seconds.
        before_s: f64,
    },
}

/// Time as an increasing function of a shaft's angle in revolutions, over the known part of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct ShaftAngle {
    time_s: Pchip,
    source: AngleSource,
}

impl ShaftAngle {
    /// Determines the angle of a shaft that makes `turns` per turn of the one with the tachometer, zero at
    /// the first pulse. `pulse_times_s` are seconds after the record's first sample, ascending; some may lie
    /// before it or after its end. Several pulses a turn count where their marks are found to lie on the
    /// shaft. Between pulses, time is a monotone cubic of the angle.
    pub(super) fn from_pulses(
        pulse_times_s: &[f64],
        pulses_per_revolution: u32,
        turns: f64,
    ) -> Result<Self, PulseError> {
        if pulses_per_revolution == 0 {
            return Err(PulseError::PulsesPerRevolution);
        }
        if pulse_times_s.len() < 2 {
            return Err(PulseError::TooFew(pulse_times_s.len()));
        }
        if let Some(index) = pulse_times_s.iter().position(|time| !time.is_finite()) {
            return Err(PulseError::NotRising(index));
        }
        if let Some(index) = pulse_times_s.windows(2).position(|w| w[1] <= w[0]) {
            return Err(PulseError::NotRising(index + 1));
        }
        for (index, w) in pulse_times_s.windows(3).enumerate() {
            let (before_s, interval_s) = (w[1] - w[0], w[2] - w[1]);
            let ratio = interval_s / before_s;
            // The marks of one turn may be spaced unevenly, but by less than half an interval.
            if !(ratio < MAX_INTERVAL_RATIO && ratio > 1.0 / MAX_INTERVAL_RATIO) {
                return Err(PulseError::Uneven { index: index + 2, interval_s, before_s });
            }
        }
        let marks = pulses_per_revolution as usize;
        let per_revolution = f64::from(pulses_per_revolution) / turns;
        let offsets = mark_offsets(pulse_times_s, marks);
        let offset = |pulse: usize| offsets.as_ref().map_or(0.0, |offsets| offsets[pulse % marks]);
        let revolutions: Vec<f64> =
            (0..pulse_times_s.len()).map(|pulse| (pulse as f64 + offset(pulse)) / per_revolution).collect();
        let scatter_s = match &offsets {
            None => pulse_scatter_s(pulse_times_s),
            Some(_) => {
                let even = |pulse: usize| {
                    let turn = pulse.min(pulse_times_s.len() - 1 - marks);
                    let interval_s = (pulse_times_s[turn + marks] - pulse_times_s[turn]) / marks as f64;
                    pulse_times_s[pulse] - offset(pulse) * interval_s
                };
                pulse_scatter_s(&(0..pulse_times_s.len()).map(even).collect::<Vec<_>>())
            }
        };
        let source = AngleSource::Tachometer {
            pulses: pulse_times_s.len(),
            angle_error_deg: scatter_s.map(|scatter_s| {
                let turns = revolutions[revolutions.len() - 1];
                360.0 * scatter_s * turns / (pulse_times_s[pulse_times_s.len() - 1] - pulse_times_s[0])
            }),
        };
        Self::through(revolutions, pulse_times_s.to_vec(), Vec::new(), source).map_err(|error| match error {
            PchipError::TooFew(pulses) => PulseError::TooFew(pulses),
            PchipError::NotRising(pulse) => PulseError::NotRising(pulse),
        })
    }

    /// Returns the angle at a constant speed, zero at the first sample; `None` unless speed and duration are
    /// positive.
    pub(super) fn constant(shaft_speed_hz: f64, duration_s: f64) -> Option<Self> {
        let turns = shaft_speed_hz * duration_s;
        if !(turns > 0.0 && duration_s > 0.0) {
            return None;
        }
        Self::through(vec![0.0, turns], vec![0.0, duration_s], Vec::new(), AngleSource::ConstantSpeed).ok()
    }

    /// Interpolates the angle through these points, in the memory of `buffer`.
    pub(super) fn through(
        revolutions: Vec<f64>,
        times_s: Vec<f64>,
        buffer: Vec<f64>,
        source: AngleSource,
    ) -> Result<Self, PchipError> {
        let time_s = Pchip::new(revolutions, times_s, buffer)?;
        Ok(Self { time_s, source })
    }

    /// Returns the buffers for reuse.
    pub(super) fn recycle(self, transforms: &mut Transforms) {
        self.time_s.into_buffers().into_iter().for_each(|buffer| transforms.recycle(buffer));
    }

    /// Refers the angle to a shaft that makes `turns` per turn of this one; `None` unless `turns` is
    /// positive.
    pub(super) fn geared(&self, turns: f64) -> Option<Self> {
        let revolutions = self.time_s.nodes().iter().map(|revolution| revolution * turns).collect();
        Self::through(revolutions, self.time_s.values().to_vec(), Vec::new(), self.source.geared(turns)).ok()
    }

    /// Returns the source and accuracy of the angle.
    pub fn source(&self) -> AngleSource {
        self.source
    }

    /// Returns the first and the last known revolution.
    pub(super) fn revolutions(&self) -> [f64; 2] {
        self.time_s.range()
    }

    /// Returns the mean shaft speed between the first and the last known point, in hertz.
    pub(super) fn mean_speed_hz(&self) -> f64 {
        let [first, last] = self.time_s.range();
        (last - first) / (self.time_s.at(last, &mut 0) - self.time_s.at(first, &mut 0))
    }

    /// Returns the lowest shaft speed between two known points, in hertz.
    pub(super) fn lowest_speed_hz(&self) -> f64 {
        self.time_s.max_slope().recip()
    }

    /// Returns the revolution at a time: linear between known points, extrapolated beyond them at the speed
    /// of the outermost two.
    pub(super) fn revolution(&self, time_s: f64) -> f64 {
        let (times, revolutions) = (self.time_s.values(), self.time_s.nodes());
        let i = times.partition_point(|t| *t <= time_s).clamp(1, times.len() - 1);
        let speed = (revolutions[i] - revolutions[i - 1]) / (times[i] - times[i - 1]);
        revolutions[i - 1] + speed * (time_s - times[i - 1])
    }

    /// Writes the times of the ascending revolutions `from + steps[j]`, in samples at this rate; advances
    /// `interval`.
    #[inline(always)]
    pub(super) fn sample_positions(
        &self,
        from: f64,
        steps: &[f64],
        rate_hz: f64,
        interval: &mut usize,
        samples: &mut [f64],
    ) {
        self.time_s.sample_into(from, steps, rate_hz, interval, samples);
    }

    /// Returns the time of a revolution; calls with ascending revolutions advance `interval`.
    pub(super) fn time_s(&self, revolution: f64, interval: &mut usize) -> f64 {
        self.time_s.at(revolution, interval)
    }
}

/// Standard deviation in seconds of single pulses of even marks about a smooth motion: the root mean square
/// of their third differences over √20, which equals the standard deviation for independent errors. A linear
/// change of the interval has no third difference.
fn pulse_scatter_s(pulse_times_s: &[f64]) -> Option<f64> {
    const MIN_PULSES: usize = 5;
    if pulse_times_s.len() < MIN_PULSES {
        return None;
    }
    let squares: f64 = pulse_times_s.windows(4).map(|w| (w[3] - w[0] - 3.0 * (w[2] - w[1])).powi(2)).sum();
    Some((squares / (pulse_times_s.len() - 3) as f64 / 20.0).sqrt())
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Closed form: t = θ/10 at 10 turns a second.
    #[test]
    fn even_pulses_are_a_constant_speed() {
        let pulses: Vec<f64> = (0..41).map(|pulse| 0.3 + f64::from(pulse) / 40.0).collect();
        let angle = ShaftAngle::from_pulses(&pulses, 4, 1.0).unwrap();
        assert_eq!(angle.revolutions(), [0.0, 10.0]);
        assert!((angle.time_s(2.6, &mut 0) - 0.56).abs() < 1e-12);
        assert!((angle.lowest_speed_hz() - 10.0).abs() < 1e-9);
        let AngleSource::Tachometer { pulses: 41, angle_error_deg: Some(error_deg) } = angle.source() else {
            panic!("{:?}", angle.source());
        };
        assert!(error_deg < 1e-9, "{error_deg}");
    }

    /// Independent errors of 20 µs in the pulses of a shaft at 10 turns a second that speeds up:
    /// 360°·10·20·10⁻⁶ = 0.072°.
    #[test]
    fn pulse_scatter_gives_the_angle_error() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let pulses: Vec<f64> = (0..400)
            .map(|pulse| {
                let time = f64::from(pulse) / 10.0;
                let error: f64 = StandardNormal.sample(&mut random);
                time - 1e-4 * time * time + 20e-6 * error
            })
            .collect();
        let AngleSource::Tachometer { angle_error_deg: Some(error_deg), .. } =
            ShaftAngle::from_pulses(&pulses, 1, 1.0).unwrap().source()
        else {
            panic!("no error");
        };
        assert!((error_deg / 0.072 - 1.0).abs() < 0.1, "{error_deg}");
    }

    #[test]
    fn invalid_pulses_report_the_reason() {
        let error =
            |times: &[f64], per_revolution| ShaftAngle::from_pulses(times, per_revolution, 1.0).unwrap_err();
        assert_eq!(error(&[0.0, 1.0], 0), PulseError::PulsesPerRevolution);
        assert_eq!(error(&[0.0], 1), PulseError::TooFew(1));
        assert_eq!(error(&[0.0, 1.0, 1.0], 1), PulseError::NotRising(2));
        assert_eq!(error(&[f64::NAN, 1.0], 1), PulseError::NotRising(0));
        assert!(matches!(error(&[0.0, 1.0, 2.0, 4.0], 1), PulseError::Uneven { index: 3, .. }));
        assert!(matches!(error(&[0.0, 1.0, 1.5, 2.0], 1), PulseError::Uneven { index: 2, .. }));
        assert_eq!(ShaftAngle::constant(f64::NAN, 1.0), None);
        assert_eq!(ShaftAngle::constant(10.0, 0.0), None);
    }
}
