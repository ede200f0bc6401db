//! A record over the angle of a shaft instead of time.

use std::f64::consts::PI;

use super::indicators::Absence;
use super::record::Record;
use super::shaft_angle::{AngleSource, ShaftAngle};
use super::spectrum::hann_amplitude;
use super::transform::Transforms;

/// Samples to each side of a point that it is interpolated from.
const REACH: usize = 16;

/// The fewest whole turns that are averaged.
pub(super) const LEAST_TURNS: usize = 4;

/// A record whose speed varies so much that it would grow by more than this when resampled is refused.
const MOST_GROWTH: f64 = 4.0;

/// Whole turns of a shaft, the samples evenly spaced in its angle.
#[derive(Debug, Clone, PartialEq)]
pub struct AngleRecord {
    /// Unit of the samples.
    pub unit: String,
    /// Samples in one turn; even, with no prime factor above 7.
    pub samples_per_turn: usize,
    /// Whole turns.
    pub turns: usize,
    /// Their samples, one turn after the other, the record's mean removed.
    pub samples: Vec<f64>,
    /// Where the angle came from, and how sure it is.
    pub angle: AngleSource,
}

/// A one-sided Hann amplitude (peak) spectrum over orders of a shaft.
#[derive(Debug, Clone, PartialEq)]
pub struct OrderSpectrum {
    /// Unit of the amplitudes.
    pub unit: String,
    /// Distance of the bins in orders: one over the number of turns.
    pub resolution_orders: f64,
    /// Equivalent noise bandwidth in orders: 1.5 bins.
    pub bandwidth_orders: f64,
    /// Amplitude of bin k, at k × `resolution_orders`.
    pub amplitude: Vec<f64>,
    /// Where the angle came from, and how sure it is.
    pub angle: AngleSource,
}

impl AngleRecord {
    /// Resamples the whole turns of a record whose `angle` is known and that have 16 samples before and after them.
    ///
    /// As many samples a turn are taken as the record has in its slowest turn or more, so that nothing folds back. A sample between the
    /// record's own is Σ xᵢ·sinc(t − i)·w(t − i) / Σ sinc·w over the 32 samples around it, w the Blackman window: flat within 10⁻⁴ to
    /// 0.4 of the sampling rate. `orders` is the highest order that must be kept.
    ///
    /// # Errors
    /// [`Absence::TooFewTurns`] below 4, [`Absence::AboveNyquist`] where `orders` lies above half the sampling rate at the slowest speed,
    /// [`Absence::SpeedVaries`] where the speed varies so much that the record would grow fourfold.
    pub(super) fn resample(record: &Record, angle: &ShaftAngle, orders: f64) -> Result<Self, Absence> {
        let samples = record.samples();
        let rate_hz = record.sample_rate_hz();
        if samples.len() <= 2 * REACH {
            return Err(Absence::TooShort);
        }
        let least = rate_hz / angle.lowest_speed_hz();
        let holds_orders = least > 2.0 * orders;
        if !holds_orders {
            return Err(Absence::AboveNyquist);
        }
        let known = angle.revolutions();
        let most = MOST_GROWTH * samples.len() as f64;
        if least >= samples.len() as f64 {
            return Err(Absence::TooFewTurns);
        }
        let samples_per_turn = smooth_at_least(least.ceil() as usize);
        // Pulses may have come for long before and after the record: its ends say which turns it holds.
        let position = |revolution: f64| angle.time_s(revolution, &mut 0) * rate_hz;
        let (begin, end) = (REACH as f64, (samples.len() - 1 - REACH) as f64);
        let (low, high) = (known[0].ceil(), known[1].floor());
        let first = first_such(low, high, |revolution| position(revolution) >= begin);
        let past = first_such(first, high + 1.0, |revolution| revolution > high || position(revolution) > end);
        let turns = past - 1.0 - first;
        let enough = turns >= LEAST_TURNS as f64 && position(first) >= begin;
        if !enough {
            return Err(Absence::TooFewTurns);
        }
        if turns * samples_per_turn as f64 > most {
            return Err(Absence::SpeedVaries);
        }
        let turns = turns as usize;
        let mean = samples.iter().map(|&x| f64::from(x)).sum::<f64>() / samples.len() as f64;
        let (kernel, mut interval) = (Kernel::new(), 0);
        let resampled = (0..turns * samples_per_turn).map(|j| {
            let position = angle.time_s(first + j as f64 / samples_per_turn as f64, &mut interval) * rate_hz;
            kernel.interpolate(samples, position) - mean
        });
        Ok(Self {
            unit: record.unit().to_owned(),
            samples_per_turn,
            turns,
            samples: resampled.collect(),
            angle: angle.source(),
        })
    }

    /// The mean over all turns at each angle.
    pub fn synchronous_average(&self) -> Vec<f64> {
        let mut average = vec![0.0; self.samples_per_turn];
        for turn in self.samples.chunks_exact(self.samples_per_turn) {
            average.iter_mut().zip(turn).for_each(|(sum, sample)| *sum += sample);
        }
        average.iter_mut().for_each(|sum| *sum /= self.turns as f64);
        average
    }

    /// The Hann amplitude spectrum over orders.
    pub(super) fn order_spectrum(&self, transforms: &mut Transforms) -> OrderSpectrum {
        let (mut samples, mut bins, mut amplitude) = (self.samples.clone(), Vec::new(), Vec::new());
        let mean = samples.iter().sum::<f64>() / samples.len() as f64;
        samples.iter_mut().for_each(|sample| *sample -= mean);
        transforms.forward(&mut samples, &mut bins);
        hann_amplitude(&bins, samples.len(), &mut amplitude);
        let resolution_orders = 1.0 / self.turns as f64;
        OrderSpectrum {
            unit: self.unit.clone(),
            resolution_orders,
            bandwidth_orders: 1.5 * resolution_orders,
            amplitude,
            angle: self.angle,
        }
    }
}

/// The first whole number from `low` to `high` from which on `holds` (which stays true once it is); `high` where it never does.
fn first_such(low: f64, high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (low, high.max(low));
    while low < high {
        let middle = (0.5 * (low + high)).floor();
        if holds(middle) {
            high = middle;
        } else {
            low = middle + 1.0;
        }
    }
    low
}

/// The smallest even number from `least` on without a prime factor above 7.
fn smooth_at_least(least: usize) -> usize {
    let mut number = least.next_multiple_of(2);
    loop {
        let mut rest = number;
        for prime in [2, 3, 5, 7] {
            while rest.is_multiple_of(prime) {
                rest /= prime;
            }
        }
        if rest == 1 {
            return number;
        }
        number += 2;
    }
}

/// Cosine and sine of π·k/16 at the samples around a point: the window between them follows by the addition theorem.
struct Kernel {
    window: [(f64, f64); 2 * REACH],
}

impl Kernel {
    fn new() -> Self {
        let angle = |k: usize| PI * (k as f64 + 1.0 - REACH as f64) / REACH as f64;
        Self {
            window: std::array::from_fn(|k| (angle(k).cos(), angle(k).sin())),
        }
    }

    /// The signal at `position`, at least 16 samples from either end.
    fn interpolate(&self, samples: &[f32], position: f64) -> f64 {
        let before = position.floor();
        let fraction = position - before;
        let centre = before as usize;
        if fraction < 1e-12 {
            return f64::from(samples[centre]);
        }
        let (sine, cosine) = (PI * fraction / REACH as f64).sin_cos();
        let around = &samples[centre + 1 - REACH..=centre + REACH];
        let (mut sum, mut weights, mut sign) = (0.0, 0.0, 1.0);
        for (k, (&sample, &(cos, sin))) in around.iter().zip(&self.window).enumerate() {
            // cos(π(k − 15 − fraction)/16); sin π(…) has the same size at all samples and turns its sign.
            let c = cos * cosine + sin * sine;
            let blackman = 0.42 + 0.5 * c + 0.08 * (2.0 * c * c - 1.0);
            let weight = sign * blackman / (k as f64 + 1.0 - REACH as f64 - fraction);
            sum += weight * f64::from(sample);
            weights += weight;
            sign = -sign;
        }
        sum / weights
    }
}
