//! Interpolation between the samples of a record by a windowed sinc.
//!
//! Samples are stored in single precision, so weights and sums are too: an interpolated value is as exact as
//! a sample, at less than half the cost of double precision.

use std::f64::consts::PI;
use std::sync::LazyLock;

use pulp::{Arch, Simd, WithSimd};

/// Samples on each side of a point used for its interpolation.
pub(super) const REACH: usize = 16;

/// Lines up to this part of the sampling rate keep their amplitude, within 0.1 %; at 0.47 they lose 15 %.
pub(super) const PASSBAND: f64 = 0.42;

/// Samples used for the interpolation of one point.
const TAPS: usize = 2 * REACH;

/// Number of parts of a sampling interval; in each, the weights are their own polynomials.
const PHASES: usize = 128;

/// Coefficients of these polynomials, of degree 2: the error is 3·10⁻⁸ of the largest weight, half the
/// rounding of single precision.
const COEFFICIENTS: usize = 3;

/// Fewest points on average that follow each other with the same stride.
const MIN_POINTS_OF_STRIDE: usize = 12;

/// Partial sums of a point that are added up in a second pass, for many points at once: adding all lanes of a
/// register up point by point takes longer.
const PARTIAL_SUMS: usize = 4;

/// Adding and subtracting this rounds a number below 2⁵¹ to the nearest whole number, whose bits are the
/// lowest of the sum. Unlike a conversion, the compiler vectorises this.
const ROUNDING_OFFSET: f64 = 6_755_399_441_055_744.0;

/// The weights of the 32 samples around a point, as polynomials of its position between two samples: one
/// table for all threads.
static PHASE_TABLE: LazyLock<Box<[Phase; PHASES]>> =
    LazyLock::new(|| Box::new(std::array::from_fn(Phase::new)));

/// Interpolates records and reuses its buffers.
pub(super) struct Kernel {
    parts: Vec<u64>,
    offsets: Vec<f32>,
    partial_sums: Vec<[f32; PARTIAL_SUMS]>,
    arch: Arch,
}

/// The polynomials of one part of the interval: for each power, in ascending order, the coefficients of all
/// samples. Aligned, because loading a register from two cache lines takes twice as long, and these loads
/// dominate the cost.
#[repr(align(64))]
struct Phase([[f32; TAPS]; COEFFICIENTS]);

impl Phase {
    /// Computes the polynomials through the weights at the Chebyshev points of one part.
    fn new(phase: usize) -> Self {
        let at = |node: usize| (PI * (node as f64 + 0.5) / COEFFICIENTS as f64).cos();
        let nodes: [[f64; TAPS]; COEFFICIENTS] =
            std::array::from_fn(|node| weights((phase as f64 + 0.5 + 0.5 * at(node)) / PHASES as f64));
        let mut powers = [[0.0; TAPS]; COEFFICIENTS];
        for tap in 0..TAPS {
            let [c0, c1, c2]: [f64; COEFFICIENTS] = std::array::from_fn(|degree| {
                let sum: f64 = (0..COEFFICIENTS)
                    .map(|node| {
                        nodes[node][tap]
                            * (PI * degree as f64 * (node as f64 + 0.5) / COEFFICIENTS as f64).cos()
                    })
                    .sum();
                sum * if degree == 0 { 1.0 } else { 2.0 } / COEFFICIENTS as f64
            });
            // T2 = 2t² − 1.
            for (power, value) in powers.iter_mut().zip([c0 - c2, c1, 2.0 * c2]) {
                power[tap] = value as f32;
            }
        }
        Self(powers)
    }
}

impl Kernel {
    /// Creates an interpolator with empty buffers.
    pub(super) fn new() -> Self {
        Self { parts: Vec::new(), offsets: Vec::new(), partial_sums: Vec::new(), arch: Arch::new() }
    }

    /// Returns the instruction set of this processor.
    pub(super) fn arch(&self) -> Arch {
        self.arch
    }

    /// Interpolates the signal at `positions`, each at least 16 samples from either end.
    pub(super) fn interpolate(&mut self, samples: &[f32], positions: &[f64], values: &mut [f32]) {
        self.parts.resize(positions.len(), 0);
        self.offsets.resize(positions.len(), 0.0);
        self.partial_sums.resize(positions.len(), [0.0; PARTIAL_SUMS]);
        self.arch.dispatch(Interpolation {
            phases: &PHASE_TABLE,
            samples,
            positions,
            parts: &mut self.parts,
            offsets: &mut self.offsets,
            partial_sums: &mut self.partial_sums,
            values,
        });
    }
}

/// Points to interpolate, and their destination.
struct Interpolation<'a> {
    phases: &'a [Phase; PHASES],
    samples: &'a [f32],
    positions: &'a [f64],
    /// The part of the record that each point lies in, of which an interval has 128.
    parts: &'a mut [u64],
    /// The point's offset from −1 to 1 within its part.
    offsets: &'a mut [f32],
    partial_sums: &'a mut [[f32; PARTIAL_SUMS]],
    values: &'a mut [f32],
}

impl WithSimd for Interpolation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for ((part, offset), position) in self.parts.iter_mut().zip(&mut *self.offsets).zip(self.positions) {
            let scaled = position * PHASES as f64;
            let rounded = scaled - 0.5 + ROUNDING_OFFSET;
            *part = rounded.to_bits();
            *offset = (2.0 * (scaled - (rounded - ROUNDING_OFFSET)) - 1.0) as f32;
        }
        // A separate loop, as the inputs of all points are ready and several points can be computed at once.
        let count = self.values.len().min(self.parts.len());
        let (parts, offsets) = (&self.parts[..count], &self.offsets[..count]);
        let sums = &mut self.partial_sums[..count];
        let stride = stride(self.positions);
        let around = |part: u64| {
            let before = ((part - ROUNDING_OFFSET.to_bits()) / PHASES as u64) as usize;
            &self.samples[before + 1 - REACH..][..TAPS]
        };
        let phase = |part: u64| part as usize % PHASES;
        for first in 0..stride {
            let mut at = first;
            while at < count {
                let part = parts[at];
                let weights = &self.phases[phase(part)];
                let next = at + stride;
                if let Some(&other) = parts.get(next)
                    && phase(other) == phase(part)
                {
                    let samples = [around(part), around(other)];
                    let offsets = [offsets[at], offsets[next]];
                    [sums[at], sums[next]] = weighted_sums(simd, weights, samples, offsets);
                    at = next + stride;
                } else {
                    [sums[at]] = weighted_sums(simd, weights, [around(part)], [offsets[at]]);
                    at = next;
                }
            }
        }
        for (value, [a, b, c, d]) in self.values.iter_mut().zip(sums) {
            *value = (*a + *b) + (*c + *d);
        }
    }
}

/// Returns the weighted sums at points in the same part of an interval, each with its samples and its offset.
#[inline(always)]
fn weighted_sums<S: Simd, const POINTS: usize>(
    simd: S,
    Phase(rows): &Phase,
    samples: [&[f32]; POINTS],
    offsets: [f32; POINTS],
) -> [[f32; PARTIAL_SUMS]; POINTS] {
    // The lane count of every register type divides 32: there is no remainder.
    let samples = samples.map(|samples| S::as_simd_f32s(samples).0);
    let [c0, c1, c2] = rows.each_ref().map(|row| S::as_simd_f32s(row).0);
    let offsets = offsets.map(|offset| simd.splat_f32s(offset));
    let mut sums = [simd.splat_f32s(0.0); POINTS];
    for (k, ((&c0, &c1), &c2)) in c0.iter().zip(c1).zip(c2).enumerate() {
        for ((sum, &t), samples) in sums.iter_mut().zip(&offsets).zip(samples) {
            let weight = simd.mul_add_e_f32s(c2, t, c1);
            let weight = simd.mul_add_e_f32s(weight, t, c0);
            *sum = simd.mul_add_e_f32s(weight, samples[k], *sum);
        }
    }
    sums.map(|sum| folded(pulp::bytemuck::cast_slice(&[sum])))
}

/// Adds the lanes of a register up to four.
#[inline(always)]
fn folded(lanes: &[f32]) -> [f32; PARTIAL_SUMS] {
    if let [lanes] = lanes.as_chunks().0 {
        let lanes: &[f32; 16] = lanes;
        let halves: [f32; 8] = std::array::from_fn(|n| lanes[n] + lanes[n + 8]);
        return std::array::from_fn(|n| halves[n] + halves[n + 4]);
    }
    if let [lanes] = lanes.as_chunks().0 {
        let lanes: &[f32; 8] = lanes;
        return std::array::from_fn(|n| lanes[n] + lanes[n + 4]);
    }
    std::array::from_fn(|n| lanes.get(n).copied().unwrap_or(0.0))
}

/// Returns the stride after which points lie at nearly the same offset between two samples, so that the
/// coefficients of one part serve several of them: the denominator of the last convergent of the step's
/// continued fraction that leaves enough points to each stride.
fn stride(positions: &[f64]) -> usize {
    let [Some(first), Some(last)] = [positions.first(), positions.last()] else { return 1 };
    let step = (last - first) / (positions.len().max(2) - 1) as f64;
    let max_stride = positions.len() / MIN_POINTS_OF_STRIDE;
    let (mut before, mut stride, mut rest) = (0, 1, step.fract().abs());
    while rest > 0.0 {
        let quotient = rest.recip();
        let next = quotient.floor() * stride as f64 + before as f64;
        if next > max_stride as f64 {
            break;
        }
        (before, stride, rest) = (stride, next as usize, quotient.fract());
    }
    stride
}

/// Returns sinc·Blackman at the 32 samples around a point that lies `fraction` of an interval after the
/// sixteenth, divided by their sum.
fn weights(fraction: f64) -> [f64; TAPS] {
    let weights: [f64; TAPS] = std::array::from_fn(|k| {
        let u = k as f64 + 1.0 - REACH as f64 - fraction;
        let sinc = if u == 0.0 { 1.0 } else { (PI * u).sin() / (PI * u) };
        let angle = PI * u / REACH as f64;
        sinc * (0.42 + 0.5 * angle.cos() + 0.08 * (2.0 * angle).cos())
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_equal_the_weights() {
        let mut kernel = Kernel::new();
        for step in 0..=1000 {
            let fraction = f64::from(step) / 1000.001;
            let want = weights(fraction);
            for (tap, want) in want.iter().enumerate() {
                let mut samples = [0.0; TAPS + 1];
                samples[tap + 1] = 1.0;
                let mut got = [0.0];
                kernel.interpolate(&samples, &[REACH as f64 + fraction], &mut got);
                let [got] = got.map(f64::from);
                assert!((got - want).abs() < 1.2e-7, "{fraction} {tap}: {got} {want}");
            }
        }
    }
}
