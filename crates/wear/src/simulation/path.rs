//! A random transmission path from the bearings to the sensor.

use rand::{Rng, RngExt};

/// Number of resonances of a path.
const RESONANCES: usize = 8;

/// Lowest resonance in hertz, and the highest as a part of the sampling rate.
const LOWEST_HZ: f64 = 200.0;
const MAX_PART: f64 = 0.45;

/// Seconds after which the path's slowest resonance has decayed (ζ = 1 % at 200 Hz: e^{-2π·2·0.5} = 0.2 %).
pub(super) const SETTLING_S: f64 = 0.5;

/// A linear path like that of a housing: a direct part and resonances of random frequency, damping and sign.
#[derive(Debug, Clone)]
pub struct TransmissionPath {
    direct: f64,
    resonances: Vec<Resonance>,
}

/// One band-pass section of second order, gain at resonance `gain`.
#[derive(Debug, Clone)]
struct Resonance {
    gain: f64,
    b0: f64,
    a1: f64,
    a2: f64,
}

impl TransmissionPath {
    /// Creates a random path for a sampling rate in hertz; damping ratios of 1 to 5 %, gains of 0.3 to 3 of
    /// either sign.
    pub fn random(rng: &mut impl Rng, sample_rate_hz: f64) -> Self {
        let resonances = (0..RESONANCES)
            .map(|_| {
                let highest_hz = MAX_PART * sample_rate_hz;
                let frequency_hz = LOWEST_HZ * (highest_hz / LOWEST_HZ).powf(rng.random::<f64>());
                let damping_ratio = rng.random_range(0.01..0.05);
                let gain =
                    0.3 * 10f64.powf(rng.random::<f64>()) * if rng.random::<bool>() { 1.0 } else { -1.0 };
                Resonance::new(frequency_hz / sample_rate_hz, damping_ratio, gain)
            })
            .collect();
        Self { direct: 0.5, resonances }
    }

    /// Applies the path to a vibration, starting from rest.
    pub fn apply(&self, samples: &[f64]) -> Vec<f64> {
        // All sections are computed side by side, as their recursions are independent.
        let mut state = vec![[0.0; 2]; self.resonances.len()];
        let (mut x1, mut x2) = (0.0, 0.0);
        samples
            .iter()
            .map(|&x| {
                let rise = x - x2;
                (x2, x1) = (x1, x);
                let parts = self.resonances.iter().zip(&mut state).map(|(section, [y1, y2])| {
                    let y = section.b0 * rise - section.a1 * *y1 - section.a2 * *y2;
                    (*y2, *y1) = (*y1, y);
                    section.gain * y
                });
                self.direct * x + parts.sum::<f64>()
            })
            .collect()
    }
}

impl Resonance {
    /// Bilinear transform of s·ω/Q / (s² + s·ω/Q + ω²) with Q = 1/(2ζ); `frequency` in parts of the sampling
    /// rate.
    fn new(frequency: f64, damping_ratio: f64, gain: f64) -> Self {
        let (sin, cos) = (std::f64::consts::TAU * frequency).sin_cos();
        let alpha = sin * damping_ratio;
        let a0 = 1.0 + alpha;
        Self { gain, b0: alpha / a0, a1: -2.0 * cos / a0, a2: (1.0 - alpha) / a0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resonance_has_its_gain_at_its_frequency_and_none_at_rest() {
        let path = TransmissionPath { direct: 0.0, resonances: vec![Resonance::new(0.05, 0.02, 3.0)] };
        let samples: Vec<f64> = (0..4000).map(|n| (std::f64::consts::TAU * 0.05 * n as f64).sin()).collect();
        let seen = path.apply(&samples);
        let peak = seen[3000..].iter().fold(0.0f64, |a, x| a.max(x.abs()));
        // The band-pass prototype has gain 1 at resonance by construction; the sample grid hits the sine's
        // crest.
        assert!((peak - 3.0).abs() < 1e-3, "{peak}");
        let constant = path.apply(&vec![1.0; 4000]);
        assert!(constant[3999].abs() < 1e-6);
    }
}
