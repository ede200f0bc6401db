//! A record between its samples: a windowed sinc.

use std::f64::consts::PI;

use pulp::{Arch, Simd, WithSimd};

/// Samples to each side of a point that it is interpolated from.
pub(super) const REACH: usize = 16;

/// Samples that a point is interpolated from.
const TAPS: usize = 2 * REACH;

/// Parts of a sampling interval in which the interpolation's weights are polynomials of their own.
const PHASES: usize = 128;

/// Coefficients of these polynomials: of degree 4, which leaves 2·10⁻¹⁴ of the largest weight.
const COEFFICIENTS: usize = 5;

/// The weights of the 32 samples around a point, as polynomials of its place between two samples.
pub(super) struct Kernel {
    phases: Vec<Phase>,
    arch: Arch,
}

/// In one part of the interval, for each power, rising, the coefficients of all samples. Aligned, because a
/// register that is loaded from two lines of the cache takes twice as long, and that is what this costs.
#[repr(align(64))]
struct Phase([[f64; TAPS]; COEFFICIENTS]);

impl Kernel {
    /// Polynomials through the weights at the Chebyshev points of each part.
    pub(super) fn new() -> Self {
        let phases = (0..PHASES).map(|phase| {
            let at = |node: usize| (PI * (node as f64 + 0.5) / COEFFICIENTS as f64).cos();
            let nodes: [[f64; TAPS]; COEFFICIENTS] =
                std::array::from_fn(|node| weights((phase as f64 + 0.5 + 0.5 * at(node)) / PHASES as f64));
            let mut powers = [[0.0; TAPS]; COEFFICIENTS];
            for tap in 0..TAPS {
                let chebyshev: [f64; COEFFICIENTS] = std::array::from_fn(|degree| {
                    let sum: f64 = (0..COEFFICIENTS)
                        .map(|node| {
                            nodes[node][tap]
                                * (PI * degree as f64 * (node as f64 + 0.5) / COEFFICIENTS as f64).cos()
                        })
                        .sum();
                    sum * if degree == 0 { 1.0 } else { 2.0 } / COEFFICIENTS as f64
                });
                let [c0, c1, c2, c3, c4] = chebyshev;
                // T2 = 2t² − 1, T3 = 4t³ − 3t, T4 = 8t⁴ − 8t² + 1.
                let monomials = [c0 - c2 + c4, c1 - 3.0 * c3, 2.0 * c2 - 8.0 * c4, 4.0 * c3, 8.0 * c4];
                for (power, value) in powers.iter_mut().zip(monomials) {
                    power[tap] = value;
                }
            }
            Phase(powers)
        });
        Self { phases: phases.collect(), arch: Arch::new() }
    }

    /// What this processor's widest registers are.
    pub(super) fn arch(&self) -> Arch {
        self.arch
    }

    /// The signal at `positions`, each at least 16 samples from either end, in the processor's widest
    /// registers.
    pub(super) fn interpolate(&self, samples: &[f64], positions: &[f64], values: &mut [f64]) {
        self.arch.dispatch(Interpolation { phases: &self.phases, samples, positions, values });
    }
}

/// Points to be interpolated, and where they go.
struct Interpolation<'a> {
    phases: &'a [Phase],
    samples: &'a [f64],
    positions: &'a [f64],
    values: &'a mut [f64],
}

impl WithSimd for Interpolation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for (&position, value) in self.positions.iter().zip(self.values) {
            // Positions are far below 2³²; wider conversions cost more.
            let before = position as u32;
            let place = (position - f64::from(before)) * PHASES as f64;
            let phase = (place as u32).min(PHASES as u32 - 1);
            let (before, phase, place) = (before as usize, phase as usize, place - f64::from(phase));
            let t = simd.splat_f64s(2.0 * place - 1.0);
            // The lanes of all registers divide 32: nothing is left over.
            let (around, _) = S::as_simd_f64s(&self.samples[before + 1 - REACH..][..TAPS]);
            let [c0, c1, c2, c3, c4] = &self.phases[phase].0;
            let ((c0, _), (c1, _), (c2, _)) = (S::as_simd_f64s(c0), S::as_simd_f64s(c1), S::as_simd_f64s(c2));
            let ((c3, _), (c4, _)) = (S::as_simd_f64s(c3), S::as_simd_f64s(c4));
            let mut sum = simd.splat_f64s(0.0);
            for (((((&x, &c0), &c1), &c2), &c3), &c4) in around.iter().zip(c0).zip(c1).zip(c2).zip(c3).zip(c4)
            {
                let weight = simd.mul_add_e_f64s(c4, t, c3);
                let weight = simd.mul_add_e_f64s(weight, t, c2);
                let weight = simd.mul_add_e_f64s(weight, t, c1);
                let weight = simd.mul_add_e_f64s(weight, t, c0);
                sum = simd.mul_add_e_f64s(weight, x, sum);
            }
            *value = simd.reduce_sum_f64s(sum);
        }
    }
}

/// sinc·Blackman at the 32 samples around a point this part of an interval after the sixteenth, over their
/// sum.
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
    fn polynomials_are_the_weights() {
        let kernel = Kernel::new();
        for step in 0..=1000 {
            let fraction = f64::from(step) / 1000.001;
            let want = weights(fraction);
            for (tap, want) in want.iter().enumerate() {
                let mut samples = [0.0; TAPS];
                samples[tap] = 1.0;
                let mut got = [0.0];
                kernel.interpolate(&samples, &[REACH as f64 - 1.0 + fraction], &mut got);
                let [got] = got;
                assert!((got - want).abs() < 1e-13, "{fraction} {tap}: {got} {want}");
            }
        }
    }
}
