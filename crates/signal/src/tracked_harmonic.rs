//! One harmonic of the mesh that is tracked: its phase, its line and what is beside it.

use std::cmp::Ordering;
use std::f64::consts::TAU;

use flankwatch_fourier::{Complex, FftDirection};
use pulp::{Arch, Simd, WithSimd};

use super::phases::{add_phase_steps, phases_of};
use super::sums::mean_of;
use super::transform::Transforms;

/// Number of iterations; each tracks the phase left by the one before.
const ITERATIONS: usize = 3;

/// The line counts as lost if its amplitude falls below this fraction of its root mean square.
const MIN_LINE_FRACTION: f64 = 0.25;

/// Smallest amplitude ratio of the line to the background.
const MIN_RATIO: f64 = 4.0;

/// From this ratio on, noise causes no phase slips, and the harmonic with the smallest angle error is the
/// best one; below it, the harmonic with the highest ratio.
const SAFE_RATIO: f64 = 8.0;

/// A harmonic that is tracked, and its phase.
pub(super) struct TrackedHarmonic {
    pub(super) harmonic: u32,
    /// Amplitude ratio of the line to the background.
    pub(super) ratio: f64,
    /// Periods of the harmonic per turn of the shaft.
    pub(super) orders: f64,
    /// First bin of the band, and number of its bins.
    pub(super) first: usize,
    pub(super) bins: usize,
    /// Largest distance of the line's bins from zero.
    pub(super) reach_bins: usize,
    /// Samples discarded at each end.
    pub(super) margin: usize,
    /// Phase per sample of the band's signal.
    pub(super) phase: Vec<f64>,
    /// The band's signal relative to its phase so far.
    pub(super) derotated: Vec<Complex<f64>>,
    /// The line in it.
    pub(super) line: Vec<Complex<f64>>,
    /// Whether the phase is complete and the line is clear.
    pub(super) is_finished: bool,
}

impl TrackedHarmonic {
    /// Completes the phase. Returns whether the line stands out and is not lost anywhere.
    ///
    /// The phase of the signal relative to the first one, below 0.45 shaft rates, is added, three times: each
    /// iteration brings the line closer to zero frequency, where sidebands no longer pass.
    pub(super) fn finish(&mut self, transforms: &mut Transforms) -> bool {
        let mut increments = transforms.buffer();
        increments.resize(self.line.len() - 1, 0.0);
        let mut left = 0.0;
        for step in 0..ITERATIONS {
            if step > 0 {
                derotate_by_phase(&mut self.derotated, &mut self.line);
                self.low_pass(transforms);
            }
            left += self.line[0].arg();
            add_phase_steps(&self.line, &mut increments);
        }
        // Once for all iterations, as each addition waits for the one before.
        self.phase[0] += left;
        for (phase, step) in self.phase[1..].iter_mut().zip(&increments) {
            left += step;
            *phase += left;
        }
        transforms.recycle(increments);
        let line = &self.line[self.margin..self.line.len() - self.margin];
        let lowest = line.iter().map(Complex::norm_sqr).fold(f64::INFINITY, f64::min).sqrt();
        let is_lost = lowest < MIN_LINE_FRACTION * mean_of(line, Complex::norm_sqr).sqrt();
        self.is_finished = self.ratio >= MIN_RATIO && !is_lost;
        self.is_finished
    }

    /// Low-passes the derotated signal and compares the line with the rest of the band.
    pub(super) fn low_pass(&mut self, transforms: &mut Transforms) {
        low_pass(&self.derotated, self.reach_bins, &mut self.line, transforms);
        let settled = self.margin..self.line.len() - self.margin;
        let line = &self.line[settled.clone()];
        let line_power = mean_of(line, Complex::norm_sqr);
        let rest = power_beside(&self.derotated[settled], line);
        let line_bins = (2 * self.reach_bins + 1) as f64;
        let other_bins = (self.bins as f64 - line_bins).max(1.0);
        // A computed signal may be exactly zero outside its line.
        let background = (rest * line_bins / other_bins).max(1e-18 * line_power);
        self.ratio = (line_power / background).sqrt();
    }

    pub(super) fn recycle(self, transforms: &mut Transforms) {
        transforms.recycle(self.phase);
        transforms.recycle_complex(self.derotated);
        transforms.recycle_complex(self.line);
    }

    pub(super) fn angle_error_deg(&self) -> f64 {
        360.0 / (TAU * self.orders * self.ratio * 2.0_f64.sqrt())
    }

    /// Compares by tracking quality.
    pub(super) fn cmp(&self, other: &Self) -> Ordering {
        let quality = |tracked: &Self| {
            if tracked.ratio >= SAFE_RATIO {
                (true, -tracked.angle_error_deg())
            } else {
                (false, tracked.ratio)
            }
        };
        let ((is_safe, this), (other_is_safe, other)) = (quality(self), quality(other));
        is_safe.cmp(&other_is_safe).then(this.total_cmp(&other))
    }
}

/// Mean square of what a signal has beside its line. Little weight is on the ends, where the band filter has
/// settled least.
fn power_beside(signal: &[Complex<f64>], line: &[Complex<f64>]) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for (j, (z, line)) in signal.iter().zip(line).enumerate() {
        let place = (j as f64 + 0.5) / signal.len() as f64;
        let weight = (place * (1.0 - place)).powi(2);
        sum += weight * (z - line).norm_sqr();
        weights += weight;
    }
    sum / weights
}

/// Computes the phase from the frequency over `turn` samples around each sample, weighted by power, and the
/// signal derotated by it.
pub(super) fn derotate_by_frequency(
    signal: &[Complex<f64>],
    turn: usize,
    phase: &mut Vec<f64>,
    derotated: &mut Vec<Complex<f64>>,
    transforms: &mut Transforms,
) {
    let (mut sums, mut steps) = (transforms.complex_buffer(), transforms.complex_buffer());
    let mut sum = Complex::default();
    sums.push(sum);
    sums.extend(signal.windows(2).map(|pair| {
        sum += pair[1] * pair[0].conj();
        sum
    }));
    let half = turn.div_ceil(2);
    let around = |j: usize| sums[(j + 1 + half).min(sums.len() - 1)] - sums[j.saturating_sub(half)];
    steps.extend((0..signal.len() - 1).map(around));
    phases_of(&steps, phase);
    // The rotation is accumulated step by step, without a sine.
    Arch::new().dispatch(UnitPhasors(&mut steps));
    let (mut total, mut rotation) = (0.0, Complex::new(1.0, 0.0));
    derotated.push(signal[0]);
    derotated.extend(signal[1..].iter().zip(&steps).zip(phase.iter_mut()).map(|((z, step), phase)| {
        total += *phase;
        *phase = total;
        rotation *= step.conj();
        z * rotation
    }));
    phase.insert(0, 0.0);
    transforms.recycle_complex(sums);
    transforms.recycle_complex(steps);
}

/// Derotates each sample by the phase of `line`, the latest addition to the tracked phase; leaves phasors of
/// modulus 1 in `line`.
fn derotate_by_phase(signal: &mut [Complex<f64>], line: &mut [Complex<f64>]) {
    Arch::new().dispatch(Derotation { signal, line });
}

/// That, as plain loops compiled for each instruction set.
struct Derotation<'a> {
    signal: &'a mut [Complex<f64>],
    line: &'a mut [Complex<f64>],
}

impl WithSimd for Derotation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        UnitPhasors(self.line).with_simd(simd);
        for (z, line) in self.signal.iter_mut().zip(self.line) {
            *z *= line.conj();
        }
    }
}

/// Divides each value by its modulus, as a plain loop compiled for each instruction set. Zero, which has no
/// phase, becomes 1.
struct UnitPhasors<'a>(&'a mut [Complex<f64>]);

impl WithSimd for UnitPhasors<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for z in self.0 {
            let square = z.norm_sqr();
            let is_zero = f64::from(u8::from(square == 0.0));
            let scale = (square + is_zero).sqrt().recip();
            *z = Complex::new(z.re * scale + is_zero, z.im * scale);
        }
    }
}

/// Low-passes a signal: keeps the bins within `reach` of zero.
fn low_pass(
    signal: &[Complex<f64>],
    reach: usize,
    line: &mut Vec<Complex<f64>>,
    transforms: &mut Transforms,
) {
    line.clear();
    line.extend_from_slice(signal);
    transforms.complex(line, FftDirection::Forward);
    let scale = 1.0 / signal.len() as f64;
    // The bins from zero up, the rest, and those from zero down.
    let above = (reach + 1).min(line.len());
    let below = line.len().saturating_sub(reach).max(above);
    line[..above].iter_mut().for_each(|bin| *bin *= scale);
    line[above..below].fill(Complex::default());
    line[below..].iter_mut().for_each(|bin| *bin *= scale);
    transforms.complex(line, FftDirection::Inverse);
}
