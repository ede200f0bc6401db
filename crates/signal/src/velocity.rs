//! The root mean square of the vibration velocity as in ISO 20816.

use super::band::{BandQuantity, rms_between};
use super::not_computed::NotComputed;
use super::spectrum::position_of;

/// Name of the indicator.
pub const VELOCITY_RMS: &str = "velocity_rms";

/// The band of ISO 20816-1 and -3 for shafts above 600 rpm.
const BAND_HZ: [f64; 2] = [10.0, 1000.0];

/// Fewest bins from zero to the band's lower end: integration amplifies leakage from below it, and a line at
/// that end loses the part of its main lobe outside the band.
const MIN_BINS: f64 = 5.0;

/// Returns the root mean square of velocity from 10 to 1000 Hz in mm/s, from the Hann amplitude spectrum of
/// `samples` samples.
pub(super) fn velocity_rms(
    amplitude: &[f64],
    samples: usize,
    sample_rate_hz: f64,
    unit: &str,
) -> Result<f64, NotComputed> {
    let value = rms_between(BAND_HZ, BandQuantity::Velocity, amplitude, samples, sample_rate_hz, unit)?;
    if position_of(BAND_HZ[0], samples, sample_rate_hz) < MIN_BINS {
        Err(NotComputed::TooShort)
    } else {
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use jiff::Timestamp;
    use serde::Deserialize;

    use super::super::{AnalysisSettings, Analyzer, MeshContext, Record};
    use super::*;

    #[derive(Deserialize)]
    struct Case {
        unit: String,
        sample_rate_hz: f64,
        samples: Vec<f32>,
        velocity_rms_mm_per_s: f64,
    }

    fn value(unit: &str, sample_rate_hz: f64, samples: Vec<f32>) -> Result<f64, NotComputed> {
        let record = Record::new("1", Timestamp::UNIX_EPOCH, sample_rate_hz, unit, samples).unwrap();
        let indicators =
            Analyzer::new(AnalysisSettings::default()).analyze(&record, &MeshContext::unknown()).indicators;
        indicators.get(VELOCITY_RMS).ok_or_else(|| indicators.absent[VELOCITY_RMS])
    }

    /// `make_velocity_reference.py` next to the vectors documents the SciPy computation.
    #[test]
    fn equals_scipy() {
        let text = include_str!("../../../fixtures/reference/signal/velocity_vectors.json");
        let cases: Vec<Case> = serde_json::from_str(text).unwrap();
        assert!(cases.len() >= 6);
        for Case { unit, sample_rate_hz, samples, velocity_rms_mm_per_s: want } in cases {
            let got = value(&unit, sample_rate_hz, samples).unwrap();
            assert!((got / want - 1.0).abs() < 1e-6, "{unit}: {got}, SciPy has {want}");
        }
    }

    /// Closed form: an acceleration of amplitude 2πf mm/s² is a velocity of amplitude 1 mm/s.
    #[test]
    fn a_tone_at_the_lower_limit_keeps_most_of_its_rms() {
        for samples in [2000, 2400, 4000, 20_000] {
            let of_time = |t: f64| (TAU * 10.0 * (TAU * 10.0 * t).cos()) as f32;
            let tone = (0..samples).map(|i| of_time(f64::from(i) / 4000.0)).collect();
            let part = value("mm/s2", 4000.0, tone).unwrap() / 0.5_f64.sqrt();
            assert!((0.85..1.0).contains(&part), "{samples}: {part}");
        }
    }

    #[test]
    fn unusable_records_report_the_reason() {
        let noise = |count: usize| (0..count).map(|k| (1.7 * k as f32).sin() * (0.3 * k as f32).cos());
        let of = |unit: &str, rate_hz: f64, count: usize| value(unit, rate_hz, noise(count).collect());
        assert!(of("m/s2", 4000.0, 2000).is_ok());
        assert_eq!(of("V", 4000.0, 4000), Err(NotComputed::NotAcceleration));
        assert_eq!(of("g", 1900.0, 4000), Err(NotComputed::AboveNyquist));
        // The band ends at half the sampling rate, whatever the rounding of the bin spacing.
        assert!(of("g", 2000.0, 7800).is_ok());
        assert_eq!(of("g", 4000.0, 1996), Err(NotComputed::TooShort));
        assert_eq!(value("g", 4000.0, vec![1.0; 4000]), Err(NotComputed::Constant));
    }
}
