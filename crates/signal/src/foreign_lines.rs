//! Removal of the lines of other meshes from a record over the shaft angle.
//!
//! Their orders are known exactly; amplitudes and phases are measured under a Hann window over the turns. If
//! not removed, a line between two whole orders would leave a residue in the mean turn that jumps from its
//! end to its start, as if one tooth were different.

use std::f64::consts::TAU;

use flankwatch_fourier::Complex;
use pulp::{Arch, Simd, WithSimd};

use super::angle_record::AngleRecord;
use super::mesh_context::MeshContext;

/// A line within this many bins (one bin is one over the number of turns) of a whole shaft order cannot be
/// distinguished from the shaft's own line.
pub(super) const NEAR_ORDER_BINS: f64 = 2.0;

/// Lines are removed up to this harmonic of the mesh under analysis: nothing is read above it.
const MAX_HARMONIC: f64 = 10.5;

/// Interleaved sums over a turn.
const PARTIAL_SUMS: usize = 16;

impl AngleRecord {
    /// Removes the lines of the other known meshes.
    pub(super) fn without_other_meshes(mut self, mesh: &MeshContext) -> Self {
        if mesh.others.is_empty() {
            return self;
        }
        let (per_turn, turns) = (self.samples_per_turn, self.turns);
        let highest = (MAX_HARMONIC * f64::from(mesh.teeth)).min(0.5 * per_turn as f64 - 1.0);
        let near = NEAR_ORDER_BINS / turns as f64;
        let weights: Vec<f64> = (0..turns)
            .map(|turn| 2.0 * (0.5 * TAU * (turn as f64 + 0.5) / turns as f64).sin().powi(2) / turns as f64)
            .collect();
        let arch = Arch::new();
        let (mut cos, mut minus_sin) = (vec![0.0; per_turn], vec![0.0; per_turn]);
        for order in mesh.others.lines_up_to(highest) {
            if (order - order.round()).abs() <= near {
                continue;
            }
            for (j, (cos, minus_sin)) in cos.iter_mut().zip(&mut minus_sin).enumerate() {
                let (s, c) = (TAU * order * j as f64 / per_turn as f64).sin_cos();
                (*cos, *minus_sin) = (c, -s);
            }
            let at_turn = |turn: usize| Complex::from_polar(1.0, TAU * (order * turn as f64).fract());
            let all = self.samples.chunks_exact(per_turn).zip(&weights).enumerate();
            let sum: Complex<f64> = all
                .map(|(number, (turn, weight))| {
                    let one_turn = Turn { samples: turn, cos: &cos, sin: &minus_sin };
                    arch.dispatch(one_turn) * at_turn(number).conj() * *weight
                })
                .sum();
            let line = sum * (2.0 / per_turn as f64);
            for (number, turn) in self.samples.chunks_exact_mut(per_turn).enumerate() {
                let Complex { re, im } = line * at_turn(number);
                for (x, (cos, minus_sin)) in turn.iter_mut().zip(cos.iter().zip(&minus_sin)) {
                    *x = (f64::from(*x) - (re * cos + im * minus_sin)) as f32;
                }
            }
        }
        self
    }
}

/// Σ x·(cos + i·sin) over one turn, vectorised.
struct Turn<'a> {
    samples: &'a [f32],
    cos: &'a [f64],
    sin: &'a [f64],
}

impl WithSimd for Turn<'_> {
    type Output = Complex<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Complex<f64> {
        let Self { samples, cos, sin } = self;
        let of = |factors: &[f64]| {
            let mut sums = [0.0; PARTIAL_SUMS];
            let (samples, samples_rest) = samples.as_chunks::<PARTIAL_SUMS>();
            let (factors, factors_rest) = factors.as_chunks::<PARTIAL_SUMS>();
            for (samples, factors) in samples.iter().zip(factors) {
                for n in 0..PARTIAL_SUMS {
                    sums[n] += f64::from(samples[n]) * factors[n];
                }
            }
            let rest = samples_rest.iter().zip(factors_rest);
            rest.fold(sums.iter().sum(), |sum: f64, (&x, factor)| sum + f64::from(x) * factor)
        };
        Complex::new(of(cos), of(sin))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{AngleSource, OtherMesh, OtherMeshes};
    use super::*;

    #[test]
    fn lines_of_other_meshes_are_removed_and_own_ones_kept() {
        let (per_turn, turns) = (240, 20);
        let signal = |lines: &[(f64, f64)]| -> Vec<f64> {
            let at = |i: usize| {
                lines
                    .iter()
                    .map(move |(order, a)| a * (TAU * order * i as f64 / per_turn as f64 + order).sin())
            };
            (0..per_turn * turns).map(|i| at(i).sum()).collect()
        };
        let others = OtherMeshes::of([OtherMesh { mesh_orders: 17.54, shaft_orders: [0.9, 0.35] }]);
        let mesh = MeshContext { teeth: 10, others, ..MeshContext::unknown() };
        let own = [(1.0, 0.3), (10.0, 1.0), (20.0, 0.5), (33.0, 0.2)];
        let foreign = [(17.54, 2.0), (17.54 - 0.9, 0.4), (3.0 * 17.54, 0.7), (2.0 * 17.54 + 0.7, 0.1)];
        let record = AngleRecord {
            unit: "g".into(),
            samples_per_turn: per_turn,
            turns,
            highest_order: per_turn / 2,
            samples: signal(&[&own[..], &foreign].concat()).into_iter().map(|x| x as f32).collect(),
            angle: AngleSource::ConstantSpeed,
        };
        let left = record.without_other_meshes(&mesh);
        let worst =
            left.samples.iter().zip(signal(&own)).map(|(x, y)| (f64::from(*x) - y).abs()).fold(0.0, f64::max);
        assert!(worst < 0.01, "{worst}");
    }
}
