//! What the members of an ensemble expect of a record's lines, many members side by side.

use super::anchor::{Anchor, anchor_reach};
use super::deviation::Deviation;
use super::discrepancy::Discrepancy;
use super::extrapolation::Extrapolation;
use super::healthy_lines::{MeasuredLine, MeasuredLines};
use super::load::Load;
use crate::library::{DEPTHS, Ensemble, LANES, Lanes, line_name};

/// What the scaling with the torque may be wrong by, as a part of it: pairs that are simulated at 0.5 to 2 of
/// their torque give 0.3 to 1, most of it where wear is shallow.
const LOAD_DISCREPANCY: f32 = 0.6;

/// What the lines of a record are held against besides the baseline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reference<'a> {
    /// By member, the index of the depth at which the baseline was taken; none for a new machine.
    pub(super) depths: Option<&'a [u8]>,
    /// What the last inspection says.
    pub(super) anchor: Option<&'a Anchor>,
    /// How far the record's operating point is from the simulated one.
    pub(super) extrapolation: Extrapolation,
}

/// What is expected of one record.
pub(super) struct Expectations<'a> {
    ensemble: &'a Ensemble,
    /// By block of members and depth: variance of what a member may have wrong by itself.
    variance: &'a [[Lanes; DEPTHS]],
    /// Lines that the members have. Those that are drawn have all, the described pair has what its library
    /// has.
    lines: Vec<&'a MeasuredLine>,
    reference: Reference<'a>,
    depths_um: Vec<f32>,
    /// Where a line stands at this torque.
    load: Option<Load>,
    /// Factor on the variance at this speed.
    doubt: f32,
}

/// Members side by side.
pub(super) struct Block<'a> {
    lines: Vec<BlockLine<'a>>,
    variance: &'a [Lanes; DEPTHS],
    doubt: f32,
    load: Option<&'a Load>,
    /// By depth: how nearly a member has there what it has wrong at the last inspection.
    alike: Option<Vec<Lanes>>,
}

/// One line of members side by side.
struct BlockLine<'a> {
    /// By depth.
    changes: &'a [Lanes; DEPTHS],
    /// The change at the depth of the baseline.
    from: Lanes,
    floor: f32,
    /// What the members have wrong at the last inspection, where the line was seen then.
    wrong: Option<Lanes>,
}

impl<'a> Expectations<'a> {
    /// For a record's lines.
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
            doubt: reference.extrapolation.variance_factor(discrepancy.most) as f32,
            depths_um,
        }
    }

    /// The lines of which something is expected.
    pub(super) fn lines(&self) -> &[&'a MeasuredLine] {
        &self.lines
    }

    /// How many members there are.
    pub(super) fn members(&self) -> usize {
        self.ensemble.members().len()
    }

    /// How each line deviates from what a member expects at a depth.
    pub(super) fn deviations(&self, (member, depth): (usize, usize)) -> Vec<Deviation> {
        let (block, lane) = (self.block(member / LANES), member % LANES);
        let deviation = |(index, line): (usize, &&MeasuredLine)| {
            let [expected, variance] = block.expect(index, depth);
            let residual = line.change - f64::from(expected[lane]);
            residual.is_finite().then(|| Deviation {
                name: line_name(line.index),
                residual,
                deviation: (f64::from(variance[lane]) + line.variance).sqrt(),
            })
        };
        self.lines.iter().enumerate().filter_map(deviation).collect()
    }

    /// Block number `index` of the members.
    pub(super) fn block(&self, index: usize) -> Block<'_> {
        let members = self.ensemble.members();
        let member = |lane: usize| (index * LANES + lane).min(members.len() - 1);
        let line = |line: &&MeasuredLine| {
            let changes = self.ensemble.changes_side_by_side(index, line.index);
            let of = |depths: &[u8], lane: usize| changes[usize::from(depths[member(lane)])][lane];
            let from = self.reference.depths.map_or([0.0; LANES], |depths| lanes(|lane| of(depths, lane)));
            let floor = line.floor as f32;
            let seen = self.reference.anchor.and_then(|anchor| Some((anchor, anchor.changes[line.index]?)));
            let wrong = seen.map(|(anchor, seen)| {
                lanes(|lane| seen - (of(&anchor.depths, lane) - from[lane]).max(floor))
            });
            BlockLine { changes, from, floor, wrong }
        };
        let alike = |anchor: &Anchor| {
            let greatest_um = self.depths_um[DEPTHS - 1];
            let at_um = lanes(|lane| self.depths_um[usize::from(anchor.depths[member(lane)])]);
            let reach_um = lanes(|lane| anchor_reach(members[member(lane)].contact) * greatest_um);
            let alike = |um: &f32| lanes(|lane| (-(um - at_um[lane]).abs() / reach_um[lane]).exp());
            self.depths_um.iter().map(alike).collect()
        };
        Block {
            lines: self.lines.iter().map(line).collect(),
            variance: &self.variance[index],
            doubt: self.doubt,
            load: self.load.as_ref(),
            alike: self.reference.anchor.map(alike),
        }
    }
}

impl Block<'_> {
    /// What the members expect of a line at a depth, and the variance of that.
    #[inline(always)]
    pub(super) fn expect(&self, line: usize, depth: usize) -> [Lanes; 2] {
        let BlockLine { changes, from, floor, wrong } = &self.lines[line];
        let (here, own) = (&changes[depth], &self.variance[depth]);
        let (mut expected, mut variance) = ([0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            expected[lane] = (here[lane] - from[lane]).max(*floor);
            variance[lane] = self.doubt * own[lane];
        }
        if let Some(load) = self.load {
            let (lower, part) = load.place(depth);
            let [before, after] = [&changes[lower], &changes[lower + 1]];
            for lane in 0..LANES {
                let shift = before[lane] + part * (after[lane] - before[lane]) - here[lane];
                let wrong = LOAD_DISCREPANCY * shift;
                expected[lane] += shift;
                variance[lane] += wrong * wrong;
            }
        }
        if let (Some(wrong), Some(alike)) = (wrong, &self.alike) {
            let alike = &alike[depth];
            for lane in 0..LANES {
                expected[lane] += alike[lane] * wrong[lane];
                variance[lane] *= 1.0 - alike[lane] * alike[lane];
            }
        }
        [expected, variance]
    }
}

/// A number of each member.
fn lanes(of_lane: impl Fn(usize) -> f32) -> Lanes {
    std::array::from_fn(of_lane)
}
