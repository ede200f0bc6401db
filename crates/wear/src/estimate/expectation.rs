//! Expected line changes of a record by member and depth, for many members side by side.

use super::anchor::{Anchor, anchor_reach};
use super::deviation::Deviation;
use super::discrepancy::Discrepancy;
use super::extrapolation::Extrapolation;
use super::load::Load;
use super::measured_lines::{MeasuredLine, MeasuredLines};
use crate::library::{DEPTHS, DepthChanges, Ensemble, LANES, Lanes, REPORTED, line_name};

/// Standard deviation of the torque scaling's error, as a part of its effect: pairs simulated at 0.5 to 2
/// times their torque give 0.3 to 1, the largest where wear is shallow.
const LOAD_DISCREPANCY: f32 = 0.6;

/// What a record's lines are compared with, besides the baseline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reference<'a> {
    /// By member, the index of the depth at which the baseline was taken; `None` for a new machine.
    pub(super) depths: Option<&'a [u8]>,
    /// The last inspection.
    pub(super) anchor: Option<&'a Anchor>,
    /// The record's operating point relative to the simulated one.
    pub(super) extrapolation: Extrapolation,
}

/// Expectations for one record.
pub(super) struct Expectations<'a> {
    ensemble: &'a Ensemble,
    /// By block of members and depth: variance of a member's own error.
    variance: &'a [[Lanes; DEPTHS]],
    /// The record's lines that the members have: drawn ones all, the described pair those of its library.
    lines: Vec<&'a MeasuredLine>,
    reference: Reference<'a>,
    depths_um: Vec<f32>,
    /// Depths at which lines are read at this torque, where it is not the described one.
    load: Option<Load>,
    /// Factor on the variance at this speed.
    variance_factor: f32,
}

/// Expectations of a block of members side by side.
pub(super) struct Block<'a> {
    /// Changes by depth and line.
    changes: &'a [DepthChanges; DEPTHS],
    lines: Vec<BlockLine>,
    variance: &'a [Lanes; DEPTHS],
    variance_factor: f32,
    load: Option<&'a Load>,
    /// By depth: correlation of a member's error there with its error at the last inspection.
    correlation: Option<Vec<Lanes>>,
}

/// One line of a block of members.
struct BlockLine {
    /// Index of the line (0 is the first mesh harmonic).
    index: usize,
    /// Change at the depth of the baseline.
    reference: Lanes,
    /// Least change that can be seen above the noise.
    floor: f32,
    /// Error of the members at the last inspection, where the line was seen then.
    error: Option<Lanes>,
}

impl<'a> Expectations<'a> {
    /// Prepares the expectations for a record's lines.
    pub(super) fn of(
        discrepancy: &'a Discrepancy,
        ensemble: &'a Ensemble,
        measured: &'a MeasuredLines,
        reference: Reference<'a>,
    ) -> Self {
        let depths_um: Vec<f32> = ensemble.depths_um().iter().map(|um| *um as f32).collect();
        let load = measured.load as f32;
        let is_known = |line: &&MeasuredLine| !ensemble.change(0, line.index, 0).is_nan();
        Self {
            ensemble,
            variance: &discrepancy.variance,
            lines: measured.lines.iter().filter(is_known).collect(),
            reference,
            load: ((load - 1.0).abs() > 1e-3).then(|| Load::of(load, &depths_um)),
            variance_factor: reference.extrapolation.variance_factor(discrepancy.most) as f32,
            depths_um,
        }
    }

    /// Returns the lines for which there are expectations.
    pub(super) fn lines(&self) -> &[&'a MeasuredLine] {
        &self.lines
    }

    pub(super) fn ensemble(&self) -> &Ensemble {
        self.ensemble
    }

    /// Returns the deviation of each line from its expectation for a member at a depth.
    pub(super) fn deviations(&self, (member, depth): (usize, usize)) -> Vec<Deviation> {
        let (block, lane) = self.ensemble.place_of(member);
        let block = self.block(block);
        let deviation = |(index, line): (usize, &&MeasuredLine)| {
            let [expected, variance] = block.expect::<true, true>(index, depth, &block.own_variance(depth));
            let residual = line.change - f64::from(expected[lane]);
            residual.is_finite().then(|| Deviation {
                name: line_name(line.index),
                residual,
                deviation: (f64::from(variance[lane]) + line.variance).sqrt(),
            })
        };
        self.lines.iter().enumerate().filter_map(deviation).collect()
    }

    /// Returns the expectations of block number `index` of the members.
    pub(super) fn block(&self, index: usize) -> Block<'_> {
        let members = self.ensemble.members();
        let member = |lane: usize| self.ensemble.member_in(index, lane);
        let changes = self.ensemble.changes_side_by_side(index);
        let line = |line: &&MeasuredLine| {
            let of =
                |depths: &[u8], lane: usize| changes[usize::from(depths[member(lane)])][line.index][lane];
            let reference =
                self.reference.depths.map_or([0.0; LANES], |depths| lanes(|lane| of(depths, lane)));
            let floor = line.floor as f32;
            let seen = self.reference.anchor.and_then(|anchor| Some((anchor, anchor.changes[line.index]?)));
            let error = seen.map(|(anchor, seen)| {
                lanes(|lane| seen - (of(&anchor.depths, lane) - reference[lane]).max(floor))
            });
            BlockLine { index: line.index, reference, floor, error }
        };
        let correlation = |anchor: &Anchor| {
            let end_um = self.depths_um[REPORTED - 1];
            let at_um = lanes(|lane| self.depths_um[usize::from(anchor.depths[member(lane)])]);
            let reach_um = lanes(|lane| anchor_reach(members[member(lane)].contact) * end_um);
            let at_depth = |um: &f32| lanes(|lane| (-(um - at_um[lane]).abs() / reach_um[lane]).exp());
            self.depths_um.iter().map(at_depth).collect()
        };
        Block {
            changes,
            lines: self.lines.iter().map(line).collect(),
            variance: &self.variance[index],
            variance_factor: self.variance_factor,
            load: self.load.as_ref(),
            correlation: self.reference.anchor.map(correlation),
        }
    }
}

impl Block<'_> {
    /// Whether the record's torque is not the described one.
    pub(super) fn is_loaded(&self) -> bool {
        self.load.is_some()
    }

    /// Whether there was an inspection.
    pub(super) fn is_anchored(&self) -> bool {
        self.correlation.is_some()
    }

    /// Returns the variance of each member's own error at a depth, the same for all lines.
    #[inline(always)]
    pub(super) fn own_variance(&self, depth: usize) -> Lanes {
        self.variance[depth].map(|own| self.variance_factor * own)
    }

    /// Returns the expected change of a line at a depth for each member, and its variance, from the variance
    /// of each member's own error there. `LOADED` and `ANCHORED` are false where the block is not: without
    /// these terms the loop over lines is short.
    #[inline(always)]
    pub(super) fn expect<const LOADED: bool, const ANCHORED: bool>(
        &self,
        line: usize,
        depth: usize,
        own_variance: &Lanes,
    ) -> [Lanes; 2] {
        let BlockLine { index, reference, floor, error } = &self.lines[line];
        let at = |depth: usize| &self.changes[depth][*index];
        let (mut expected, mut variance) = (*at(depth), *own_variance);
        for lane in 0..LANES {
            let change = expected[lane] - reference[lane];
            // In place of `max`, which takes three instructions.
            expected[lane] = if change > *floor { change } else { *floor };
        }
        if LOADED && let Some(load) = self.load {
            let (lower, part) = load.place(depth);
            let [before, after] = [at(lower), at(lower + 1)];
            for lane in 0..LANES {
                let shift = before[lane] + part * (after[lane] - before[lane]) - at(depth)[lane];
                let deviation = LOAD_DISCREPANCY * shift;
                expected[lane] += shift;
                variance[lane] += deviation * deviation;
            }
        }
        if ANCHORED && let (Some(error), Some(correlation)) = (error, &self.correlation) {
            let correlation = &correlation[depth];
            for lane in 0..LANES {
                expected[lane] += correlation[lane] * error[lane];
                variance[lane] *= 1.0 - correlation[lane] * correlation[lane];
            }
        }
        [expected, variance]
    }
}

/// Collects one number per member.
fn lanes(of_lane: impl Fn(usize) -> f32) -> Lanes {
    std::array::from_fn(of_lane)
}
