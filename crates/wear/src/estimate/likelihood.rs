//! Likelihood of a record by member of the ensemble and depth.

use pulp::{Arch, Simd, WithSimd};

use super::expectation::{Block, Expectations};
use super::exponential::ln;
use super::measured_lines::MeasuredLine;
use crate::library::{DEPTHS, LANES, Lanes};

/// Degrees of freedom of a line's Student t distribution, whose wide tails keep a single badly modelled line
/// from deciding.
const FREEDOM: f32 = 4.0;

/// Limit of a line's influence: the factor by which its density may fall below that at its expectation, to
/// the power 2/(ν + 1).
const MAX_TAIL: f32 = 200.0;

/// Depths whose products over the lines are in registers together; it divides their number.
const TOGETHER: usize = 3;

/// Likelihood of a record for all members at all depths.
pub(super) struct Likelihood {
    /// Logarithm by member and depth, minus the highest.
    pub(super) log: Vec<f32>,
    /// Member and depth of the highest.
    pub(super) best: (usize, usize),
    /// Logarithm of the highest.
    pub(super) highest: f64,
}

impl Likelihood {
    /// Compares a record with the expectations of every member at every depth.
    pub(super) fn of(expectations: &Expectations<'_>) -> Self {
        let lines = expectations.lines().iter().map(|line| ComparedLine::of(line)).collect();
        Arch::new().dispatch(Comparison { expectations, lines })
    }

    /// Returns the range of depth indices that this record cannot distinguish from the best one.
    pub(super) fn resolved(&self) -> [usize; 2] {
        let (member, best) = self.best;
        let row = &self.log[member * DEPTHS..(member + 1) * DEPTHS];
        let alike = |depth: &usize| row[*depth] > row[best] - 2.0;
        let low = (0..best).rev().take_while(alike).last().unwrap_or(best);
        let high = (best + 1..DEPTHS).take_while(alike).last().unwrap_or(best);
        [low, high]
    }
}

/// A measured line, prepared for the comparison.
struct ComparedLine {
    change: f32,
    /// Factor on the variances that keeps the product over all lines within the range of single precision.
    factor: f32,
    /// The line's own variance, multiplied by it.
    scaled_variance: f32,
    half_log_factor: f32,
}

impl ComparedLine {
    fn of(line: &MeasuredLine) -> Self {
        let variance = line.variance_after_baseline() as f32;
        let factor = 0.1 / (0.1 + variance);
        Self {
            change: line.change as f32,
            factor,
            scaled_variance: factor * variance,
            half_log_factor: 0.5 * factor.ln(),
        }
    }
}

/// Comparison of a record with all members.
struct Comparison<'a> {
    expectations: &'a Expectations<'a>,
    lines: Vec<ComparedLine>,
}

impl WithSimd for Comparison<'_> {
    type Output = Likelihood;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Likelihood {
        let scale: f32 = self.lines.iter().map(|line| line.half_log_factor).sum();
        let mut log = vec![0.0; self.expectations.members() * DEPTHS];
        let (mut best, mut highest) = ((0, 0), f32::NEG_INFINITY);
        for (index, rows) in log.as_chunks_mut::<DEPTHS>().0.chunks_mut(LANES).enumerate() {
            let block = self.expectations.block(index);
            let mut most = [f32::NEG_INFINITY; LANES];
            let by_depth = self.log_likelihood(&block);
            for (depth, logs) in by_depth.iter().enumerate() {
                let logs = logs.map(|log| scale + log);
                rows.iter_mut().zip(logs).for_each(|(row, log)| row[depth] = log);
                for (most, log) in most.iter_mut().zip(logs) {
                    *most = if log > *most { log } else { *most };
                }
            }
            for (lane, row) in rows.iter().enumerate() {
                if most[lane] > highest {
                    highest = most[lane];
                    let depth = row.iter().position(|value| *value == highest).unwrap_or(0);
                    best = (index * LANES + lane, depth);
                }
            }
        }
        log.iter_mut().for_each(|value| *value -= highest);
        Likelihood { log, best, highest: f64::from(highest) }
    }
}

impl Comparison<'_> {
    /// Logarithm of the likelihood by depth and member of a block, up to a constant.
    #[inline(always)]
    fn log_likelihood(&self, block: &Block<'_>) -> [Lanes; DEPTHS] {
        let mut logs = [[0.0; LANES]; DEPTHS];
        for (part, logs) in logs.as_chunks_mut::<TOGETHER>().0.iter_mut().enumerate() {
            let own: [Lanes; TOGETHER] =
                std::array::from_fn(|depth| block.own_variance(part * TOGETHER + depth));
            let (mut tails, mut spreads) = ([[1.0_f32; LANES]; TOGETHER], [[1.0_f32; LANES]; TOGETHER]);
            for (index, line) in self.lines.iter().enumerate() {
                let of_square = line.factor / FREEDOM;
                for depth in 0..TOGETHER {
                    let [expected, variance] = block.expect(index, part * TOGETHER + depth, &own[depth]);
                    for lane in 0..LANES {
                        let residual = line.change - expected[lane];
                        let variance = line.factor * variance[lane] + line.scaled_variance;
                        let tail = variance + of_square * residual * residual;
                        // In place of `min`, which takes three instructions.
                        let limit = MAX_TAIL * variance;
                        tails[depth][lane] *= if tail < limit { tail } else { limit };
                        spreads[depth][lane] *= variance;
                    }
                }
            }
            // Student's t, with (ν + r²/σ²)/ν as the quotient of both products.
            for depth in 0..TOGETHER {
                for lane in 0..LANES {
                    logs[depth][lane] =
                        0.5 * (FREEDOM * ln(spreads[depth][lane]) - (FREEDOM + 1.0) * ln(tails[depth][lane]));
                }
            }
        }
        logs
    }
}
