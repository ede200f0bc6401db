//! A record sampled over the angle of a shaft instead of over time.

use std::f64::consts::TAU;
use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use realfft::num_complex::Complex;

use super::line::{LineReading, fits, read_line, read_line_in, search_reach};
use super::shaft_angle::AngleSource;
use super::spectrum::hann_amplitude;
use super::transform::Transforms;

/// Up to this many bins to each side of a line, direct summation costs less than a full transform.
const MAX_SUMMED_REACH: usize = 8;

/// Number of bins summed at once: more sums do not fit into the registers.
const BINS_AT_ONCE: usize = 3;

/// Whole turns of a shaft, sampled at equal steps of its angle.
#[derive(Debug, Clone, PartialEq)]
pub struct AngleRecord {
    /// Unit of the samples.
    pub unit: String,
    /// Samples per turn; even, with no prime factor above 7.
    pub samples_per_turn: usize,
    /// Number of whole turns.
    pub turns: usize,
    /// Samples, turn by turn, with the record's mean removed.
    pub samples: Vec<f64>,
    /// Source and accuracy of the angle.
    pub angle: AngleSource,
}

/// A one-sided Hann amplitude (peak) spectrum over orders of a shaft.
#[derive(Debug, Clone, PartialEq)]
pub struct OrderSpectrum {
    /// Unit of the amplitudes.
    pub unit: String,
    /// Bin spacing in orders: one over the number of turns.
    pub resolution_orders: f64,
    /// Equivalent noise bandwidth in orders: 1.5 bins.
    pub bandwidth_orders: f64,
    /// Amplitude of bin k, at k × `resolution_orders`.
    pub amplitude: Vec<f64>,
    /// Source and accuracy of the angle.
    pub angle: AngleSource,
}

impl AngleRecord {
    /// Returns the mean over all turns at each angle.
    pub fn synchronous_average(&self) -> Vec<f64> {
        let mut average = Vec::new();
        self.average_into([&mut average, &mut Vec::new()]);
        average
    }

    /// Writes the average into the first buffer, with the second one as scratch.
    pub(super) fn average_into(&self, [average, odd]: [&mut Vec<f64>; 2]) {
        self.sum_into(0..self.turns, [&mut *average, &mut *odd]);
        let scale = 1.0 / self.turns as f64;
        average.iter_mut().zip(odd).for_each(|(sum, odd)| *sum = (*sum + *odd) * scale);
    }

    /// Writes the sums at each angle over the even and over the odd turns of a range, counted from its start,
    /// into `sums`.
    pub(super) fn sum_into(&self, turns: Range<usize>, sums: [&mut Vec<f64>; 2]) {
        let per_turn = self.samples_per_turn;
        let samples = &self.samples[turns.start * per_turn..turns.end * per_turn];
        for (parity, sum) in sums.into_iter().enumerate() {
            sum.clear();
            sum.resize(per_turn, 0.0);
            Arch::new().dispatch(EverySecondTurn { samples, parity, sum });
        }
    }

    /// Reads the line at order `teeth` of the Hann amplitude spectrum over orders like [`read_line`]; its
    /// position is in bins.
    ///
    /// Computes only the bins around the line. The number of samples differs from record to record and may
    /// have factors that make a full transform slow, and its plan would serve this record only.
    pub(super) fn mesh_line(&self, teeth: u32, transforms: &mut Transforms) -> Option<LineReading> {
        let position = teeth as usize * self.turns;
        let half = self.samples.len() / 2;
        if !fits(position as f64, half + 1) {
            return None;
        }
        // The line's neighbours, and those that the window combines with them.
        let reach = search_reach(position as f64).ceil() as usize + 2;
        if reach > MAX_SUMMED_REACH || position <= reach || position + reach >= half {
            return read_line(&self.order_spectrum(transforms).amplitude, position as f64);
        }
        let first = position - reach;
        let count = 2 * reach + 1;
        let bins = self.bins(first, count, transforms);
        let one_sided = 4.0 / self.samples.len() as f64;
        let mut amplitude = [0.0; 2 * MAX_SUMMED_REACH];
        for (amplitude, w) in amplitude.iter_mut().zip(bins[..count].windows(3)) {
            *amplitude = one_sided * (w[1] * 0.5 - (w[0] + w[2]) * 0.25).norm();
        }
        Some(read_line_in(&amplitude[..count - 2], first + 1, position as f64))
    }

    /// Returns `count` bins of the unwindowed transform from `first` on, summed term by term: exp(−2πikn/N)
    /// at sample j of turn t is exp(−2πikt/turns)·exp(−2πikj/N).
    fn bins(
        &self,
        first: usize,
        count: usize,
        transforms: &mut Transforms,
    ) -> [Complex<f64>; 2 * MAX_SUMMED_REACH + 1 + BINS_AT_ONCE] {
        let arch = Arch::new();
        let (total, per_turn) = (self.samples.len(), self.samples_per_turn);
        let [mut step, mut current, mut roots] = [(); 3].map(|()| transforms.complex_buffer());
        fill_wave(&mut step, per_turn, 1, total);
        fill_wave(&mut current, per_turn, first, total);
        fill_wave(&mut roots, self.turns, 1, self.turns);
        let mut waves: [[Vec<f64>; 2]; BINS_AT_ONCE] =
            std::array::from_fn(|_| [transforms.buffer(), transforms.buffer()]);
        waves.as_flattened_mut().iter_mut().for_each(|wave| wave.resize(per_turn, 0.0));
        let mut bins = [Complex::default(); 2 * MAX_SUMMED_REACH + 1 + BINS_AT_ONCE];
        for done in (0..count).step_by(BINS_AT_ONCE) {
            for [cos, sin] in &mut waves {
                for ((wave, step), (re, im)) in current.iter_mut().zip(&step).zip(cos.iter_mut().zip(sin)) {
                    (*re, *im) = (wave.re, wave.im);
                    *wave *= step;
                }
            }
            let mut turns = self.samples.chunks_exact(per_turn).enumerate();
            while let Some((number, turn)) = turns.next() {
                // A last turn without a partner is processed twice and counted once.
                let (next, weight) = turns.next().map_or((turn, 0.0), |(_, next)| (next, 1.0));
                let waves = waves.each_ref().map(|wave| wave.each_ref().map(Vec::as_slice));
                let parts = arch.dispatch(TurnBins { turns: [turn, next], waves });
                for (bin, [part, next_part]) in parts.into_iter().enumerate() {
                    let k = first + done + bin;
                    let at_turn = |number: usize| roots[k * number % self.turns];
                    bins[done + bin] += part * at_turn(number) + next_part * at_turn(number + 1) * weight;
                }
            }
        }
        waves.into_iter().flatten().for_each(|wave| transforms.recycle(wave));
        [step, current, roots].into_iter().for_each(|buffer| transforms.recycle_complex(buffer));
        bins
    }

    /// Returns the Hann amplitude spectrum over orders.
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

/// The sum over every second turn, as a plain loop compiled for each instruction set.
struct EverySecondTurn<'a> {
    samples: &'a [f64],
    parity: usize,
    sum: &'a mut [f64],
}

impl WithSimd for EverySecondTurn<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for turn in self.samples.chunks_exact(self.sum.len()).skip(self.parity).step_by(2) {
            for (sum, sample) in self.sum.iter_mut().zip(turn) {
                *sum += sample;
            }
        }
    }
}

/// Fills `wave` with exp(−2πikj/period), j = 0 … `count` − 1, as products of two factors to save sine
/// evaluations.
fn fill_wave(wave: &mut Vec<Complex<f64>>, count: usize, k: usize, period: usize) {
    const FINE: usize = 64;
    let at = |j: usize| Complex::from_polar(1.0, -TAU * ((k * j) % period) as f64 / period as f64);
    let fine: [Complex<f64>; FINE] = std::array::from_fn(at);
    wave.clear();
    for coarse in (0..count).step_by(FINE) {
        let turned = at(coarse);
        wave.extend(fine.iter().take(count - coarse).map(|fine| turned * fine));
    }
}

/// Σ x·(cos + i·sin) over each of two turns, vectorised; the waves are loaded once for both.
struct TurnBins<'a> {
    turns: [&'a [f64]; 2],
    /// Cosine and sine of each bin.
    waves: [[&'a [f64]; 2]; BINS_AT_ONCE],
}

impl WithSimd for TurnBins<'_> {
    /// One value per bin and turn.
    type Output = [[Complex<f64>; 2]; BINS_AT_ONCE];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let [(first, first_rest), (second, second_rest)] = self.turns.map(|turn| S::as_simd_f64s(turn));
        let waves = self.waves.map(|wave| wave.map(|part| S::as_simd_f64s(part)));
        let [[(c0, _), (s0, _)], [(c1, _), (s1, _)], [(c2, _), (s2, _)]] = waves;
        let mut sums = [[simd.splat_f64s(0.0); 2]; 2 * BINS_AT_ONCE];
        let rows = first.iter().zip(second).zip(c0).zip(s0).zip(c1).zip(s1).zip(c2).zip(s2);
        for (((((((&x, &y), &c0), &s0), &c1), &s1), &c2), &s2) in rows {
            for ([first_sum, second_sum], wave) in sums.iter_mut().zip([c0, s0, c1, s1, c2, s2]) {
                *first_sum = simd.mul_add_e_f64s(x, wave, *first_sum);
                *second_sum = simd.mul_add_e_f64s(y, wave, *second_sum);
            }
        }
        std::array::from_fn(|bin| {
            let [(_, cos), (_, sin)] = waves[bin];
            std::array::from_fn(|turn| {
                let [re, im] = [sums[2 * bin][turn], sums[2 * bin + 1][turn]];
                let sum = Complex::new(simd.reduce_sum_f64s(re), simd.reduce_sum_f64s(im));
                let rest = [first_rest, second_rest][turn].iter().zip(cos).zip(sin);
                rest.fold(sum, |sum, ((&x, &cos), &sin)| sum + Complex::new(x * cos, x * sin))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The line read from a few bins is the one in the whole spectrum.
    #[test]
    fn summed_line_equals_the_transform() {
        for (turns, samples_per_turn, teeth) in [(4, 120, 20), (37, 210, 24), (163, 96, 17)] {
            let samples = (0..turns * samples_per_turn).map(|n| {
                let turn = TAU * n as f64 / samples_per_turn as f64;
                0.7 + (f64::from(teeth) * 1.0007 * turn).sin()
                    + 0.4 * (3.3 * turn).cos()
                    + 0.1 * ((n * n % 17) as f64)
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
