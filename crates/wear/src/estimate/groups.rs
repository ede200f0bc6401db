//! Probabilities of groups of members side by side.
//!
//! Groups are in blocks of [`LANES`], as the ensemble has them. Unused lanes of the last block have no
//! probability.

use super::growth::{ByDepth, ByRate};
use crate::library::{DEPTHS, LANES, Lanes};

/// Probabilities by depth of a block of groups.
pub(super) type Depths = ByDepth<LANES>;

/// The same by rate.
pub(super) type Block = ByRate<LANES>;

/// Returns the probability by depth of a block's groups.
#[inline(always)]
pub(super) fn by_depth(block: &Block) -> Depths {
    let mut depths = [[0.0; LANES]; DEPTHS];
    for row in block {
        for (depths, row) in depths.iter_mut().zip(row) {
            for lane in 0..LANES {
                depths[lane] += row[lane];
            }
        }
    }
    depths
}

/// Returns the sum over all depths.
#[inline(always)]
pub(super) fn by_lane(depths: &Depths) -> Lanes {
    let mut total = [0.0; LANES];
    for row in depths {
        for lane in 0..LANES {
            total[lane] += row[lane];
        }
    }
    total
}

/// Number of groups in a block.
pub(super) fn lanes_in(groups: usize, block: usize) -> usize {
    (groups - block * LANES).min(LANES)
}

/// Splits cells into blocks.
#[inline(always)]
pub(super) fn blocks_of(cells: &mut [f32]) -> &mut [Block] {
    depths_of(cells).as_chunks_mut().0
}

/// Splits values into those of one block by depth.
#[inline(always)]
pub(super) fn depths_of(values: &mut [f32]) -> &mut [Depths] {
    values.as_chunks_mut::<LANES>().0.as_chunks_mut().0
}

/// Sums many numbers, in sixteen partial sums.
#[inline(always)]
pub(super) fn sum(values: &[f32]) -> f32 {
    let (rows, rest) = values.as_chunks::<LANES>();
    let mut sums = [0.0_f32; LANES];
    for row in rows {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
    sums.iter().chain(rest).sum()
}

#[inline(always)]
pub(super) fn normalise(values: &mut [f32]) {
    let total = sum(values);
    if total > 0.0 {
        let scale = 1.0 / total;
        values.iter_mut().for_each(|value| *value *= scale);
    }
}

/// Normalises each lane.
#[inline(always)]
pub(super) fn normalise_lanes(rows: &mut [Lanes]) {
    let mut total = [f32::MIN_POSITIVE; LANES];
    for row in rows.iter() {
        for lane in 0..LANES {
            total[lane] += row[lane];
        }
    }
    for row in rows {
        for lane in 0..LANES {
            row[lane] /= total[lane];
        }
    }
}
