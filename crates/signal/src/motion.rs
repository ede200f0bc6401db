//! Vibration as acceleration, velocity or displacement.

use std::f64::consts::TAU;

use flankwatch_fourier::{Complex, Planned};
use serde::{Deserialize, Serialize};

use super::RecordOf;
use super::acceleration::in_m_s2;

/// A quantity of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// In m/s².
    Acceleration,
    /// In mm/s.
    Velocity,
    /// In µm.
    Displacement,
}

impl Motion {
    /// Returns the quantity of a unit and the unit in SI, or `None` if it is not a unit of motion.
    pub fn of_unit(unit: &str) -> Option<(Self, f64)> {
        match unit {
            "m/s" => Some((Self::Velocity, 1.0)),
            "mm/s" => Some((Self::Velocity, 1e-3)),
            "in/s" => Some((Self::Velocity, 0.0254)),
            "m" => Some((Self::Displacement, 1.0)),
            "mm" => Some((Self::Displacement, 1e-3)),
            "um" | "µm" => Some((Self::Displacement, 1e-6)),
            acceleration => Some((Self::Acceleration, in_m_s2(acceleration)?)),
        }
    }

    /// Returns its unit: m/s2, mm/s or um.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Acceleration => "m/s2",
            Self::Velocity => "mm/s",
            Self::Displacement => "um",
        }
    }

    /// Returns its unit in SI units.
    fn si(self) -> f64 {
        match self {
            Self::Acceleration => 1.0,
            Self::Velocity => 1e-3,
            Self::Displacement => 1e-6,
        }
    }

    /// Returns how often displacement is differentiated to get this quantity.
    fn derivatives(self) -> i32 {
        match self {
            Self::Acceleration => 2,
            Self::Velocity => 1,
            Self::Displacement => 0,
        }
    }

    /// Converts a record's samples to this quantity, in its unit; `None` if the record's unit is not one of
    /// motion.
    ///
    /// The whole record is transformed, and each bin multiplied by the power of 2πif that converts the
    /// quantities. Integration removes the bins below `cut_hz`, which would otherwise amplify low-frequency
    /// noise above everything else. The record is treated as periodic, so the first and the last period of
    /// the cut-off frequency are less accurate.
    pub fn of_record(self, record: &RecordOf<'_>, cut_hz: f64) -> Option<Vec<f32>> {
        let (own, own_si) = Self::of_unit(record.unit())?;
        let factor = own_si / self.si();
        let power = self.derivatives() - own.derivatives();
        if power == 0 {
            return Some(record.samples().iter().map(|x| (f64::from(*x) * factor) as f32).collect());
        }
        let length = record.samples().len();
        let mut samples: Vec<f64> = record.samples().iter().map(|x| f64::from(*x)).collect();
        let forward = f64::forward_plan(length);
        let mut lines = forward.make_output_vec();
        // The lengths match, as both buffers were made for this plan.
        forward.process(&mut samples, &mut lines).ok()?;
        let last = lines.len() - 1;
        for (index, line) in lines.iter_mut().enumerate() {
            let hz = index as f64 * record.sample_rate_hz() / length as f64;
            let is_removed = index == 0 || (power < 0 && hz < cut_hz);
            *line *= match is_removed {
                true => Complex::new(0.0, 0.0),
                false => Complex::new(0.0, TAU * hz).powi(power) * factor / length as f64,
            };
            // The bin at half the sampling rate has no phase.
            if index == last && length.is_multiple_of(2) {
                line.im = 0.0;
            }
        }
        let inverse = f64::inverse_plan(length);
        inverse.process(&mut lines, &mut samples).ok()?;
        Some(samples.into_iter().map(|x| x as f32).collect())
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;
    use crate::Record;

    const RATE_HZ: f64 = 2000.0;

    fn record(unit: &str, value: impl Fn(f64) -> f64) -> Record {
        let samples = (0..2000).map(|n| value(TAU * f64::from(n) / RATE_HZ) as f32).collect();
        Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, unit, samples).unwrap()
    }

    #[test]
    fn a_tone_is_integrated_and_differentiated() {
        // 3 µm at 40 Hz and a slow drift of 2 Hz that is below the cut-off.
        let omega = TAU * 40.0;
        let acceleration =
            record("g", |t| (-3e-6 * omega * omega * (40.0 * t).cos() + 0.5 * (2.0 * t).sin()) / 9.806_65);
        let velocity = Motion::Velocity.of_record(&acceleration, 10.0).unwrap();
        let displacement = Motion::Displacement.of_record(&acceleration, 10.0).unwrap();
        for n in 0..2000 {
            let t = TAU * n as f64 / RATE_HZ;
            let expected = -3e-3 * omega * (40.0 * t).sin();
            assert!((f64::from(velocity[n]) - expected).abs() < 1e-4, "{n}: {} {expected}", velocity[n]);
            let expected = 3.0 * (40.0 * t).cos();
            assert!((f64::from(displacement[n]) - expected).abs() < 1e-3, "{n}: {}", displacement[n]);
        }
        let back = record("um", |t| 3.0 * (40.0 * t).cos());
        let differentiated = Motion::Acceleration.of_record(&back, 10.0).unwrap();
        assert!((f64::from(differentiated[0]) + 3e-6 * omega * omega).abs() < 1e-4, "{}", differentiated[0]);
    }

    #[test]
    fn units_other_than_motion_are_rejected() {
        assert_eq!(Motion::Velocity.of_record(&record("V", |t| t.sin()), 10.0), None);
        let same = Motion::Velocity.of_record(&record("m/s", |_| 0.5), 10.0).unwrap();
        assert_eq!(same[7], 500.0);
    }
}
