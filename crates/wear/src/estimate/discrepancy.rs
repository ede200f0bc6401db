//! Model discrepancy: the error of an ensemble's members with respect to a real machine.

use crate::library::{DEPTHS, Ensemble, Lanes, MESH_LINES};

/// Standard deviation of a member's error in a line's change. It grows from 0 without wear towards this value
/// where the shape of the wear is not known, ...
const DISCREPANCY: f64 = 0.45;

/// ... this one where the shape was measured, ...
const DISCREPANCY_MEASURED: f64 = 0.36;

/// ... or this one for the described pair alone, ...
const DISCREPANCY_DESCRIBED: f64 = 0.25;

/// ... over this root mean square of the member's changes.
const DISCREPANCY_OVER: f64 = 0.65;

/// Discrepancy of each member at each depth; it follows from the ensemble alone.
#[derive(Debug, Clone)]
pub(super) struct Discrepancy {
    /// Its standard deviation at deep wear.
    pub(super) most: f64,
    /// By block of members and depth: variance of the error of a line's change.
    pub(super) variance: Vec<[Lanes; DEPTHS]>,
}

impl Discrepancy {
    /// Computes the discrepancy of each member at each depth.
    pub(super) fn of(ensemble: &Ensemble) -> Self {
        let most = match ensemble.members() {
            [_] => DISCREPANCY_DESCRIBED,
            _ if ensemble.described().pair().wear.measured => DISCREPANCY_MEASURED,
            _ => DISCREPANCY,
        };
        let of_cell = |block: usize, depth: usize, lane: usize| {
            let known = (0..MESH_LINES)
                .map(|line| f64::from(ensemble.changes_side_by_side(block)[depth][line][lane]))
                .filter(|change| change.is_finite());
            let (count, square) =
                known.fold((0.0, 0.0), |(count, sum), change| (count + 1.0, sum + change * change));
            let square = square / f64::max(count, 1.0) / (DISCREPANCY_OVER * DISCREPANCY_OVER);
            (most * most * (1.0 - (-square).exp())) as f32
        };
        let of_block = |block| -> [Lanes; DEPTHS] {
            std::array::from_fn(|depth| std::array::from_fn(|lane| of_cell(block, depth, lane)))
        };
        let variance = (0..ensemble.blocks()).map(of_block).collect();
        Self { most, variance }
    }
}
