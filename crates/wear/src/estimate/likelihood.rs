//! Likelihood of a record by member of the ensemble and depth.

use pulp::{Arch, Simd, WithSimd};

use super::expectation::{Block, Expectations};
use super::exponential::ln;
use super::measured_lines::MeasuredLine;
use crate::library::{DEPTHS, Ensemble, LANES, Lanes};

/// Degrees of freedom of a line's Student t distribution, whose wide tails keep a single badly modelled line
/// from deciding.
const FREEDOM: f32 = 4.0;

/// Limit of a line's influence: the factor by which its density may fall below that at its expectation, to
/// the power 2/(ν + 1).
const MAX_TAIL: f32 = 200.0;

/// Likelihood of a record for all members at all depths.
pub(super) struct Likelihood {
    /// Logarithm by block of members, depth and member.
    pub(super) log: Vec<[Lanes; DEPTHS]>,
    /// Member and depth of the highest.
    pub(super) best: (usize, usize),
    /// Logarithm of the highest.
    pub(super) highest: f32,
}

impl Likelihood {
    /// Compares a record with the expectations of every member at every depth.
    pub(super) fn of(expectations: &Expectations<'_>) -> Self {
        let lines = expectations.lines().iter().map(|line| ComparedLine::of(line)).collect();
        Arch::new().dispatch(Comparison { expectations, lines })
    }

    /// Returns the range of depth indices that this record cannot distinguish from the best one.
    pub(super) fn resolved(&self, ensemble: &Ensemble) -> [usize; 2] {
        let (member, best) = self.best;
        let (block, lane) = ensemble.place_of(member);
        let row = &self.log[block];
        let alike = |depth: &usize| row[*depth][lane] > row[best][lane] - 2.0;
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
        let mut log = vec![[[0.0; LANES]; DEPTHS]; self.expectations.ensemble().blocks()];
        for (index, log) in log.iter_mut().enumerate() {
            let block = self.expectations.block(index);
            match (block.is_loaded(), block.is_anchored()) {
                (false, false) => self.log_likelihood::<false, false>(&block, log),
                (false, true) => self.log_likelihood::<false, true>(&block, log),
                (true, false) => self.log_likelihood::<true, false>(&block, log),
                (true, true) => self.log_likelihood::<true, true>(&block, log),
            }
        }
        let ((block, lane), depth, highest) = highest(&log);
        let best = (self.expectations.ensemble().member_in(block, lane), depth);
        Likelihood { log, best, highest }
    }
}

/// Returns block and lane, depth, and value of the highest number.
#[inline(always)]
fn highest(log: &[[Lanes; DEPTHS]]) -> ((usize, usize), usize, f32) {
    let mut highest = f32::NEG_INFINITY;
    let mut best_block = 0;
    for (index, block) in log.iter().enumerate() {
        let mut most = [f32::NEG_INFINITY; LANES];
        for logs in block {
            for (most, log) in most.iter_mut().zip(logs) {
                // In place of `max`, which takes three instructions.
                *most = if *log > *most { *log } else { *most };
            }
        }
        let most = most.into_iter().fold(f32::NEG_INFINITY, f32::max);
        if most > highest {
            (best_block, highest) = (index, most);
        }
    }
    let cells = log[best_block].as_flattened();
    let at = cells.iter().position(|log| *log == highest).unwrap_or(0);
    ((best_block, at % LANES), at / LANES, highest)
}

impl Comparison<'_> {
    /// Computes the logarithm of the likelihood by depth and member of a block.
    #[inline(always)]
    fn log_likelihood<const LOADED: bool, const ANCHORED: bool>(
        &self,
        block: &Block<'_>,
        log: &mut [Lanes; DEPTHS],
    ) {
        let scale: f32 = self.lines.iter().map(|line| line.half_log_factor).sum();
        for (depth, log) in log.iter_mut().enumerate() {
            let own = block.own_variance(depth);
            let (mut tails, mut spreads) = ([1.0_f32; LANES], [1.0_f32; LANES]);
            for (index, line) in self.lines.iter().enumerate() {
                let [expected, variance] = block.expect::<LOADED, ANCHORED>(index, depth, &own);
                let of_square = line.factor / FREEDOM;
                for lane in 0..LANES {
                    let residual = line.change - expected[lane];
                    let variance = line.factor * variance[lane] + line.scaled_variance;
                    let tail = variance + of_square * residual * residual;
                    // In place of `min`, which takes three instructions.
                    let limit = MAX_TAIL * variance;
                    tails[lane] *= if tail < limit { tail } else { limit };
                    spreads[lane] *= variance;
                }
            }
            // Student's t, with (ν + r²/σ²)/ν as the quotient of both products.
            for lane in 0..LANES {
                let tails = (FREEDOM + 1.0) * ln(tails[lane]);
                log[lane] = scale + 0.5 * (FREEDOM * ln(spreads[lane]) - tails);
            }
        }
    }
}
