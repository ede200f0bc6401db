//! The mesh line of a record over an angle, from a few bins of its transform without the whole transform.
//!
//! For T turns with the samples x(t, j), N in all, bin zT + m is Σⱼ exp(−2πi(zT + m)j/N) ·
//! Σₜ x(t, j)·exp(−2πimt/T). The inner sum over the turns is the same for all orders z, and for −m it is the
//! conjugate of that for m, as the samples are real.

use std::f64::consts::TAU;

use flankwatch_fourier::Complex;
use pulp::{Arch, Simd, WithSimd};
use smallvec::SmallVec;

use super::angle_record::AngleRecord;
use super::line::{LineReading, fits, read_line, read_line_in, search_reach};
use super::transform::Transforms;

/// Up to this many bins to each side of a line, direct summation costs less than a full transform.
const MAX_SUMMED_REACH: usize = 8;

/// Number of turns added at once: each partial sum is loaded and stored once for all of them.
const TURNS_PER_BLOCK: usize = 4;

/// Number of angles added over all turns at once: their partial sums stay in the first-level cache.
const ANGLES_PER_BLOCK: usize = 256;

impl AngleRecord {
    /// Reads the line at order `teeth` of the Hann amplitude spectrum over orders like [`read_line`]; its
    /// position is in bins. Also returns the mean over all turns, which comes with it for nothing.
    pub(super) fn mesh_line_and_average(
        &self,
        teeth: u32,
        transforms: &mut Transforms,
    ) -> (Option<LineReading>, Vec<f64>) {
        let [mut average, mut odd] = [transforms.buffer(), transforms.buffer()];
        let line = self.mesh_line(teeth, &mut average, transforms);
        if average.is_empty() {
            self.average_into([&mut average, &mut odd]);
        }
        transforms.recycle(odd);
        (line, average)
    }

    /// Reads the line at order `teeth` and, where that sums over all turns, writes their mean to `average`.
    ///
    /// Computes only the bins around the line. The number of samples differs from record to record and may
    /// have factors that make a full transform slow, and its plan would serve this record only.
    fn mesh_line(
        &self,
        teeth: u32,
        average: &mut Vec<f64>,
        transforms: &mut Transforms,
    ) -> Option<LineReading> {
        let position = teeth as usize * self.turns;
        let half = self.samples.len() / 2;
        if !fits(position as f64, half + 1) {
            return None;
        }
        // The line's neighbours, and those that the window combines with them.
        let reach = search_reach(position as f64) as usize + 2;
        if reach > MAX_SUMMED_REACH || position <= reach || position + reach >= half {
            return read_line(&self.order_spectrum(transforms).amplitude, position as f64);
        }
        let bins = bins_around(self, teeth as usize, reach, average, transforms);
        let scale = 1.0 / self.turns as f64;
        average.iter_mut().for_each(|sum| *sum *= scale);
        let one_sided = 4.0 / self.samples.len() as f64;
        let mut amplitude = [0.0; 2 * MAX_SUMMED_REACH];
        for (amplitude, w) in amplitude.iter_mut().zip(bins.windows(3)) {
            *amplitude = one_sided * (w[1] * 0.5 - (w[0] + w[2]) * 0.25).norm();
        }
        let line = read_line_in(&amplitude[..bins.len() - 2], position + 1 - reach, position as f64);
        transforms.recycle_complex(bins);
        Some(line)
    }
}

/// Returns the bins within `reach` of a shaft's order, of the transform without a window. Leaves the sum over
/// all turns in `turn_sum`.
fn bins_around(
    record: &AngleRecord,
    order: usize,
    reach: usize,
    turn_sum: &mut Vec<f64>,
    transforms: &mut Transforms,
) -> Vec<Complex<f64>> {
    let (total, per_turn, turns) = (record.samples.len(), record.samples_per_turn, record.turns);
    let [mut wave, mut part, mut roots] = [(); 3].map(|()| transforms.complex_buffer());
    fill_wave(&mut roots, turns, 1, turns);
    let mut weights = transforms.buffer();
    let mut sums = SmallVec::<[_; MAX_SUMMED_REACH + 1]>::new();
    for m in 0..=reach {
        let root =
            |turn: usize| if turn < turns { roots[m * turn % turns].conj() } else { Complex::default() };
        for first in (0..turns).step_by(TURNS_PER_BLOCK) {
            let roots: [Complex<f64>; TURNS_PER_BLOCK] = std::array::from_fn(|n| root(first + n));
            weights.extend(roots.map(|root| root.re));
            weights.extend(roots.map(|root| root.im));
        }
        let mut sum = [transforms.buffer(), transforms.buffer()];
        sum.iter_mut().for_each(|sum| sum.resize(per_turn, 0.0));
        sums.push(sum);
    }
    Arch::new().dispatch(TurnSums { samples: &record.samples, turns, weights: &weights, sums: &mut sums });
    fill_wave(&mut wave, per_turn, order * turns, total);
    let mut bins = transforms.complex_buffer();
    bins.resize(2 * reach + 1, Complex::default());
    for (m, [cos, sin]) in sums.iter().enumerate() {
        fill_wave(&mut part, per_turn, m, total);
        // The parts that bins m and −m have in common, and in which they differ.
        let [mut even, mut odd] = [Complex::<f64>::default(); 2];
        for (((wave, part), cos), sin) in wave.iter().zip(&part).zip(cos).zip(sin) {
            even += wave * (part.re * cos + part.im * sin);
            odd += wave * (part.re * sin - part.im * cos);
        }
        bins[reach + m] = even - odd * Complex::i();
        bins[reach - m] = even + odd * Complex::i();
    }
    // The weights of m = 0 are one.
    std::mem::swap(turn_sum, &mut sums[0][0]);
    sums.into_iter().flatten().chain([weights]).for_each(|buffer| transforms.recycle(buffer));
    [wave, part, roots].into_iter().for_each(|buffer| transforms.recycle_complex(buffer));
    bins
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

/// Σₜ x(t, j)·cos(2πmt/T) and Σₜ x(t, j)·sin(2πmt/T) at every angle j, vectorised.
struct TurnSums<'a> {
    samples: &'a [f32],
    turns: usize,
    /// The weights of all turns for m = 0, then for m = 1 and so on: of some turns cos(2πmt/T), then
    /// sin(2πmt/T).
    weights: &'a [f64],
    /// The two sums of each m.
    sums: &'a mut [[Vec<f64>; 2]],
}

impl WithSimd for TurnSums<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let per_turn = self.samples.len() / self.turns;
        let groups = self.turns.div_ceil(TURNS_PER_BLOCK);
        let (weights, _) = self.weights.as_chunks::<TURNS_PER_BLOCK>();
        for first_angle in (0..per_turn).step_by(ANGLES_PER_BLOCK) {
            let angles = first_angle..(first_angle + ANGLES_PER_BLOCK).min(per_turn);
            for group in 0..groups {
                // A group that is not full has the last turn several times, with the weight zero.
                let turns: [&[f32]; TURNS_PER_BLOCK] = std::array::from_fn(|n| {
                    let turn = (group * TURNS_PER_BLOCK + n).min(self.turns - 1);
                    &self.samples[turn * per_turn..][angles.clone()]
                });
                for (m, [cos, sin]) in self.sums.iter_mut().enumerate() {
                    let first = 2 * (m * groups + group);
                    let weights = [&weights[first], &weights[first + 1]];
                    let (cos, sin) = (&mut cos[angles.clone()], &mut sin[angles.clone()]);
                    match m {
                        // The sines are zero.
                        0 => add(turns, [weights[0]], [cos]),
                        _ => add(turns, weights, [cos, sin]),
                    }
                }
            }
        }
    }
}

/// Adds the weighted samples of some turns to each sum.
#[inline(always)]
fn add<const SUMS: usize>(
    [a, b, c, d]: [&[f32]; TURNS_PER_BLOCK],
    weights: [&[f64; TURNS_PER_BLOCK]; SUMS],
    mut sums: [&mut [f64]; SUMS],
) {
    for (n, (((&a, &b), &c), &d)) in a.iter().zip(b).zip(c).zip(d).enumerate() {
        let [a, b, c, d] = [a, b, c, d].map(f64::from);
        for (sum, weights) in sums.iter_mut().zip(weights) {
            sum[n] += (a * weights[0] + b * weights[1]) + (c * weights[2] + d * weights[3]);
        }
    }
}
