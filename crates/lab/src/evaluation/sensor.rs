//! The sensor: from a bank's vibration to the record behind a transmission path.

use std::f64::consts::{PI, TAU};

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::bank::Vibration;
use super::fault::{Fault, distort, excite};
use flankwatch_wear::simulation::TransmissionPath;

/// Samples on each side that the interpolation uses, and tabulated positions between two samples.
const REACH: usize = 8;
const PLACES: usize = 256;

/// Seconds in which the path settles.
pub(super) const SETTLING_S: f64 = 0.3;

/// Seconds that a vibration needs beyond record and settling, for random start and varying speed.
pub(super) const MARGIN_S: f64 = 0.1;

/// A sensor on one machine.
pub(super) struct Sensor {
    pub(super) path: TransmissionPath,
    pub(super) noise_deviation: f64,
    /// Root mean square of the healthy vibration before the path.
    pub(super) healthy_rms: f64,
    /// Peak of the last record without a fault.
    pub(super) peak: f64,
    /// Greatest relative variation of the speed within a record.
    pub(super) wander: f64,
    pub(super) sample_rate_hz: f64,
    pub(super) kernel: Kernel,
}

impl Sensor {
    /// Returns a record of `seconds` from a vibration: from a random start, with a speed that varies as a
    /// slow sine, through the path, with new noise.
    ///
    /// The vibration is stretched in time, so the natural frequencies of structures vary with the speed by up
    /// to half a per cent.
    pub(super) fn record(
        &self,
        vibration: &Vibration,
        seconds: f64,
        fault: Option<Fault>,
        rng: &mut impl RngExt,
    ) -> Vec<f32> {
        let rate_hz = self.sample_rate_hz;
        let wanted = (seconds * rate_hz).round() as usize;
        let length = wanted + (SETTLING_S * rate_hz) as usize;
        let spare = vibration.samples.len() as f64 - length as f64 - 2.0 * REACH as f64;
        // A swing of w at rate f displaces time by up to w/(2πf).
        let swing_hz = rng.random_range(0.3..1.5);
        let displaced = self.wander / (TAU * swing_hz) * rate_hz;
        let start = REACH as f64 + displaced + rng.random::<f64>() * (spare - 2.0 * displaced).max(0.0);
        let phase = rng.random::<f64>();
        let mut vibration_at_mount: Vec<f64> = (0..length)
            .map(|n| {
                let swing = displaced * (TAU * (swing_hz * n as f64 / rate_hz + phase)).cos();
                self.kernel.interpolate(&vibration.samples, start + n as f64 + swing)
            })
            .collect();
        if let Some(fault) = fault {
            excite(fault, &mut vibration_at_mount, rate_hz, vibration.shaft_speed_hz, self.healthy_rms, rng);
        }
        let mut seen = self.path.apply(&vibration_at_mount);
        for x in &mut seen {
            let noise: f64 = StandardNormal.sample(rng);
            *x += self.noise_deviation * noise;
        }
        if let Some(fault) = fault {
            distort(fault, &mut seen, rate_hz, self.peak);
        }
        seen[length - wanted..].iter().map(|&x| x as f32).collect()
    }
}

/// Windowed-sinc interpolation between samples.
#[derive(Clone)]
pub(super) struct Kernel(Vec<[f32; 2 * REACH]>);

impl Kernel {
    pub(super) fn new() -> Self {
        let at = |place: usize| -> [f32; 2 * REACH] {
            let fraction = place as f64 / PLACES as f64;
            let raw: [f64; 2 * REACH] = std::array::from_fn(|k| {
                let x = k as f64 + 1.0 - REACH as f64 - fraction;
                let window = (0.5 * PI * x / REACH as f64).cos().powi(2);
                if x.abs() < 1e-9 { 1.0 } else { window * (PI * x).sin() / (PI * x) }
            });
            let sum: f64 = raw.iter().sum();
            raw.map(|w| (w / sum) as f32)
        };
        Self((0..=PLACES).map(at).collect())
    }

    fn interpolate(&self, samples: &[f32], position: f64) -> f64 {
        let centre = (position as usize).clamp(REACH, samples.len() - REACH - 1);
        let place = ((position - centre as f64) * PLACES as f64).round().clamp(0.0, PLACES as f64) as usize;
        let around = &samples[centre + 1 - REACH..=centre + REACH];
        f64::from(around.iter().zip(&self.0[place]).map(|(x, w)| x * w).sum::<f32>())
    }
}
