//! A record over the angle of a shaft instead of time.

use std::f64::consts::TAU;
use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use realfft::num_complex::Complex;

use super::line::{LineReading, fits, read_line, read_line_in, search_reach};
use super::shaft_angle::AngleSource;
use super::spectrum::hann_amplitude;
use super::transform::Transforms;

/// Bins to each side of a line up to which it costs less to sum these bins than to transform everything.
const MOST_SUMMED_REACH: usize = 8;

/// Bins that are summed at once: more sums than this do not fit the registers.
const BINS_AT_ONCE: usize = 3;

/// Samples of a turn after which the next turn is taken, so that the bins' waves stay in the first cache.
const COLUMNS: usize = 256;

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
    /// The mean over all turns at each angle.
    pub fn synchronous_average(&self) -> Vec<f64> {
        let [mut average, odd] = self.sums(0..self.turns);
        let scale = 1.0 / self.turns as f64;
        average.iter_mut().zip(&odd).for_each(|(sum, odd)| *sum = (*sum + odd) * scale);
        average
    }

    /// The sums over the even and over the odd ones of some turns, counted from the first of them, at each
    /// angle.
    pub(super) fn sums(&self, turns: Range<usize>) -> [Vec<f64>; 2] {
        let mut sums = [vec![0.0; self.samples_per_turn], vec![0.0; self.samples_per_turn]];
        let chosen = &self.samples[turns.start * self.samples_per_turn..turns.end * self.samples_per_turn];
        for (number, turn) in chosen.chunks_exact(self.samples_per_turn).enumerate() {
            sums[number % 2].iter_mut().zip(turn).for_each(|(sum, sample)| *sum += sample);
        }
        sums
    }

    /// The line at order `teeth` of the Hann amplitude spectrum over orders, as [`read_line`] finds it there;
    /// its position in bins.
    ///
    /// Only the bins around it are summed up: the number of samples, another one in each record, may have
    /// factors that make its whole transform slow, and the plan for it would serve this record alone.
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
        let amplitude: Vec<f64> =
            bins.windows(3).map(|w| one_sided * (w[1] * 0.5 - (w[0] + w[2]) * 0.25).norm()).collect();
        Some(read_line_in(&amplitude, first + 1, position as f64))
    }

    /// `count` bins of the unwindowed transform from `first` on, summed term by term: exp(−2πikn/N) at sample
    /// j of turn t is exp(−2πikt/turns)·exp(−2πikj/N).
    fn bins(&self, first: usize, count: usize) -> Vec<Complex<f64>> {
        let arch = Arch::new();
        let (total, per_turn) = (self.samples.len(), self.samples_per_turn);
        let wave = |k: usize, j: usize, period: usize| {
            Complex::from_polar(1.0, -TAU * ((k * j) % period) as f64 / period as f64)
        };
        let step: Vec<Complex<f64>> = (0..per_turn).map(|j| wave(1, j, total)).collect();
        let mut current: Vec<Complex<f64>> = (0..per_turn).map(|j| wave(first, j, total)).collect();
        let mut waves: [[Vec<f64>; 2]; BINS_AT_ONCE] =
            std::array::from_fn(|_| [vec![0.0; per_turn], vec![0.0; per_turn]]);
        let mut bins = Vec::with_capacity(count + BINS_AT_ONCE);
        while bins.len() < count {
            for [cos, sin] in &mut waves {
                for ((wave, step), (re, im)) in current.iter_mut().zip(&step).zip(cos.iter_mut().zip(sin)) {
                    (*re, *im) = (wave.re, wave.im);
                    *wave *= step;
                }
            }
            let mut sums = vec![[Complex::<f64>::default(); BINS_AT_ONCE]; self.turns];
            for begin in (0..per_turn).step_by(COLUMNS) {
                let columns = begin..per_turn.min(begin + COLUMNS);
                let waves = waves.each_ref().map(|wave| wave.each_ref().map(|part| &part[columns.clone()]));
                for (turn, sums) in self.samples.chunks_exact(per_turn).zip(&mut sums) {
                    let turn = &turn[columns.clone()];
                    let parts = arch.dispatch(TurnBins { turn, waves });
                    sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum += part);
                }
            }
            let k = first + bins.len();
            for bin in 0..BINS_AT_ONCE {
                let of_turns =
                    sums.iter().enumerate().map(|(t, sums)| sums[bin] * wave(k + bin, t, self.turns));
                bins.push(of_turns.sum::<Complex<f64>>());
            }
        }
        bins.truncate(count);
        bins
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

/// Σ x·(cos + i·sin) over a part of one turn, in the processor's widest registers.
struct TurnBins<'a> {
    turn: &'a [f64],
    /// Cosine and sine of each bin.
    waves: [[&'a [f64]; 2]; BINS_AT_ONCE],
}

impl WithSimd for TurnBins<'_> {
    type Output = [Complex<f64>; BINS_AT_ONCE];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let (turn, rest) = S::as_simd_f64s(self.turn);
        let waves = self.waves.map(|wave| wave.map(|part| S::as_simd_f64s(part)));
        let [[(c0, _), (s0, _)], [(c1, _), (s1, _)], [(c2, _), (s2, _)]] = waves;
        let mut sums = [simd.splat_f64s(0.0); 2 * BINS_AT_ONCE];
        let rows = turn.iter().zip(c0).zip(s0).zip(c1).zip(s1).zip(c2).zip(s2);
        for ((((((&x, &c0), &s0), &c1), &s1), &c2), &s2) in rows {
            for (sum, wave) in sums.iter_mut().zip([c0, s0, c1, s1, c2, s2]) {
                *sum = simd.mul_add_e_f64s(x, wave, *sum);
            }
        }
        std::array::from_fn(|bin| {
            let [(_, cos), (_, sin)] = waves[bin];
            let [re, im] = [sums[2 * bin], sums[2 * bin + 1]].map(|sum| simd.reduce_sum_f64s(sum));
            let left = rest.iter().zip(cos).zip(sin);
            left.fold(Complex::new(re, im), |sum, ((&x, &cos), &sin)| sum + Complex::new(x * cos, x * sin))
        })
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
