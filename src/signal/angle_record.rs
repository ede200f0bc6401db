//! A record over the angle of a shaft instead of time.

use std::f64::consts::TAU;

use pulp::{Arch, Simd, WithSimd};
use realfft::num_complex::Complex;

use super::indicators::Absence;
use super::interpolation::{Kernel, REACH};
use super::line::{LineReading, fits, read_line, read_line_in, search_reach};
use super::record::Record;
use super::shaft_angle::{AngleSource, ShaftAngle};
use super::spectrum::hann_amplitude;
use super::transform::Transforms;

/// Bins to each side of a line up to which it costs less to sum these bins than to transform everything.
const MOST_SUMMED_REACH: usize = 8;

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
    pub(super) fn resample(record: &Record, angle: &ShaftAngle, orders: f64, kernel: &Kernel) -> Result<Self, Absence> {
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
        let centred: Vec<f64> = samples.iter().map(|&x| f64::from(x) - mean).collect();
        let mut interval = 0;
        let step = 1.0 / samples_per_turn as f64;
        let mut resampled = vec![0.0; turns * samples_per_turn];
        let mut positions = vec![0.0; samples_per_turn];
        for (turn, resampled) in resampled.chunks_exact_mut(samples_per_turn).enumerate() {
            for (j, position) in positions.iter_mut().enumerate() {
                let revolution = first + (turn as f64 + j as f64 * step);
                *position = angle.time_s(revolution, &mut interval) * rate_hz;
            }
            kernel.interpolate(&centred, &positions, resampled);
        }
        Ok(Self {
            unit: record.unit().to_owned(),
            samples_per_turn,
            turns,
            samples: resampled,
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

    /// The line at order `teeth` of the Hann amplitude spectrum over orders, as [`read_line`] finds it there; its position in bins.
    ///
    /// Only the bins around it are summed up: the number of samples, another one in each record, may have factors that make its whole
    /// transform slow, and the plan for it would serve this record alone.
    pub(super) fn mesh_line(&self, teeth: u32, transforms: &mut Transforms) -> Option<LineReading> {
        let position = teeth as usize * self.turns;
        let half = self.samples.len() / 2;
        if !fits(position as f64, half + 1) {
            return None;
        }
        // The line's neighbours, and those that the window adds to them.
        let reach = search_reach(position as f64).ceil() as usize + 2;
        if reach > MOST_SUMMED_REACH || position <= reach || position + reach >= half {
            return read_line(&self.order_spectrum(transforms).amplitude, position as f64);
        }
        let first = position - reach;
        let bins: Vec<Complex<f64>> = self.bins(first, 2 * reach + 1);
        let one_sided = 4.0 / self.samples.len() as f64;
        let amplitude: Vec<f64> = bins
            .windows(3)
            .map(|w| one_sided * (w[1] * 0.5 - (w[0] + w[2]) * 0.25).norm())
            .collect();
        Some(read_line_in(&amplitude, first + 1, position as f64))
    }

    /// `count` bins of the unwindowed transform from `first` on, summed term by term: exp(−2πikn/N) at sample j of turn t is
    /// exp(−2πikt/turns)·exp(−2πikj/N).
    fn bins(&self, first: usize, count: usize) -> Vec<Complex<f64>> {
        let arch = Arch::new();
        let total = self.samples.len() as f64;
        let per_turn = self.samples_per_turn;
        let angle = |k: usize, j: usize, period: usize| -TAU * ((k * j) % period) as f64 / period as f64;
        let step: Vec<Complex<f64>> = (0..per_turn).map(|j| Complex::from_polar(1.0, -TAU * j as f64 / total)).collect();
        let mut waves: Vec<Complex<f64>> = (0..per_turn)
            .map(|j| Complex::from_polar(1.0, angle(first, j, self.samples.len())))
            .collect();
        let (mut real, mut imaginary) = (vec![0.0; per_turn], vec![0.0; per_turn]);
        (first..first + count)
            .map(|k| {
                for (wave, (re, im)) in waves.iter().zip(real.iter_mut().zip(&mut imaginary)) {
                    (*re, *im) = (wave.re, wave.im);
                }
                waves.iter_mut().zip(&step).for_each(|(wave, step)| *wave *= step);
                let turns = self.samples.chunks_exact(per_turn).enumerate();
                let (cos, sin) = (&real[..], &imaginary[..]);
                turns
                    .map(|(t, turn)| arch.dispatch(TurnBin { turn, cos, sin }) * Complex::from_polar(1.0, angle(k, t, self.turns)))
                    .sum()
            })
            .collect()
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

/// Σ x·(cos + i·sin) over one turn, in the processor's widest registers.
pub(super) struct TurnBin<'a> {
    pub(super) turn: &'a [f64],
    pub(super) cos: &'a [f64],
    pub(super) sin: &'a [f64],
}

impl WithSimd for TurnBin<'_> {
    type Output = Complex<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Complex<f64> {
        let (turn, turn_rest) = S::as_simd_f64s(self.turn);
        let (cos, cos_rest) = S::as_simd_f64s(self.cos);
        let (sin, sin_rest) = S::as_simd_f64s(self.sin);
        let (mut re, mut im) = (simd.splat_f64s(0.0), simd.splat_f64s(0.0));
        for ((&x, &cos), &sin) in turn.iter().zip(cos).zip(sin) {
            re = simd.mul_add_e_f64s(x, cos, re);
            im = simd.mul_add_e_f64s(x, sin, im);
        }
        let mut sum = Complex::new(simd.reduce_sum_f64s(re), simd.reduce_sum_f64s(im));
        for ((&x, &cos), &sin) in turn_rest.iter().zip(cos_rest).zip(sin_rest) {
            sum += Complex::new(x * cos, x * sin);
        }
        sum
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The line read from a few bins is the one in the whole spectrum.
    #[test]
    fn a_line_summed_up_is_that_of_the_transform() {
        for (turns, samples_per_turn, teeth) in [(4, 120, 20), (37, 210, 24), (163, 96, 17)] {
            let samples = (0..turns * samples_per_turn).map(|n| {
                let turn = TAU * n as f64 / samples_per_turn as f64;
                0.7 + (f64::from(teeth) * 1.0007 * turn).sin() + 0.4 * (3.3 * turn).cos() + 0.1 * ((n * n % 17) as f64)
            });
            let turned = AngleRecord {
                unit: "g".to_owned(),
                samples_per_turn,
                turns,
                samples: samples.collect(),
                angle: AngleSource::ConstantSpeed,
            };
            let spectrum = turned.order_spectrum(&mut Transforms::default());
            let want = read_line(&spectrum.amplitude, f64::from(teeth) * turns as f64).unwrap();
            let got = turned.mesh_line(teeth, &mut Transforms::default()).unwrap();
            assert!((got.amplitude / want.amplitude - 1.0).abs() < 1e-11, "{got:?} {want:?}");
            assert!((got.position - want.position).abs() < 1e-9, "{got:?} {want:?}");
        }
    }
}
