//! How likely each member of the ensemble, at each depth, makes a record.

use serde::{Deserialize, Serialize};
use wide::f32x8;

use super::healthy_lines::{Measured, MeasuredLine};
use super::novelty::Deviation;
use crate::library::{DEPTHS, Ensemble, FlankPlace, MESH_LINES, line_name};

/// Numbers that are taken together.
const LANES: usize = 8;

/// Degrees of freedom of a line's Student t distribution: a line that a member has wrong by far does not
/// decide.
const FREEDOM: f32 = 4.0;

/// A line that is further off counts as this far off: the factor of its distribution by which it is less
/// likely than where it is expected, to the power 2/(ν + 1).
const MOST_TAIL: f32 = 200.0;

/// What a member may be wrong by: the standard deviation of a line's change grows from 0 without wear towards
/// this where nobody knows the shape of the wear, ...
const DISCREPANCY: f64 = 0.45;

/// ... where it was measured, ...
const DISCREPANCY_MEASURED: f64 = 0.3;

/// ... or where the described pair alone is believed,
const DISCREPANCY_DESCRIBED: f64 = 0.25;

/// over this root mean square of the member's changes.
const DISCREPANCY_OVER: f64 = 0.65;

/// What the scaling with the torque may be wrong by, as a part of it.
const LOAD_DISCREPANCY: f32 = 0.35;

/// Depth over which what a member is wrong by at an inspection is forgotten, in parts of the greatest.
const ANCHOR_REACH: f32 = 0.4;

/// Depths and lines known from an inspection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Anchor {
    /// By member: the index of the depth that the inspection means.
    pub(super) depths: Vec<u8>,
    /// Mean change of each line at that time.
    pub(super) changes: Vec<Option<f32>>,
}

/// What the lines of a record are held against besides the baseline.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Reference<'a> {
    /// By member, the index of the depth at which the baseline was taken; none for a new machine.
    pub(super) depths: Option<&'a [u8]>,
    /// What the last inspection says.
    pub(super) anchor: Option<&'a Anchor>,
}

/// What follows from an ensemble alone.
#[derive(Debug, Clone)]
pub(super) struct Discrepancy {
    /// By member and depth: variance of what a line's change may be wrong by.
    variance: Vec<f32>,
}

/// A record against all members at all depths.
pub(super) struct Likelihood {
    /// Logarithm by member and depth, less the highest.
    pub(super) log: Vec<f32>,
    /// Member and depth of the highest.
    pub(super) best: (usize, usize),
    /// Logarithm of the highest.
    pub(super) highest: f64,
}

impl Likelihood {
    /// The likelihood over the highest one to a power, by member and depth.
    pub(super) fn to_power(&self, power: f32) -> Vec<f32> {
        by_lanes([&self.log, &self.log], |[log, _]| (log * power).exp())
    }

    /// The depths around the best one that the best member cannot tell from it by this record.
    pub(super) fn resolved(&self) -> [usize; 2] {
        let (member, best) = self.best;
        let row = &self.log[member * DEPTHS..(member + 1) * DEPTHS];
        let alike = |depth: &usize| row[*depth] > row[best] - 2.0;
        let low = (0..best).rev().take_while(alike).last().unwrap_or(best);
        let high = (best + 1..DEPTHS).take_while(alike).last().unwrap_or(best);
        [low, high]
    }
}

impl Discrepancy {
    /// Works out how wrong each member may be at each depth.
    pub(super) fn of(ensemble: &Ensemble) -> Self {
        let most = match ensemble.members() {
            [_] => DISCREPANCY_DESCRIBED,
            _ if ensemble.described().pair().wear.measured => DISCREPANCY_MEASURED,
            _ => DISCREPANCY,
        };
        let mut variance = Vec::with_capacity(ensemble.members().len() * DEPTHS);
        for member in ensemble.members() {
            for depth in 0..DEPTHS {
                let known = (0..MESH_LINES)
                    .map(|line| f64::from(member.change(line)[depth]))
                    .filter(|change| change.is_finite());
                let (count, square) =
                    known.fold((0.0, 0.0), |(count, sum), change| (count + 1.0, sum + change * change));
                let square = square / f64::max(count, 1.0) / (DISCREPANCY_OVER * DISCREPANCY_OVER);
                variance.push((most * most * (1.0 - (-square).exp())) as f32);
            }
        }
        Self { variance }
    }

    /// Compares a record with every member at every depth.
    pub(super) fn compare(
        &self,
        ensemble: &Ensemble,
        measured: &Measured,
        reference: Reference<'_>,
    ) -> Likelihood {
        let members = ensemble.members().len();
        let mut tails = vec![1.0_f32; members * DEPTHS];
        let mut spreads = vec![1.0_f32; members * DEPTHS];
        let mut row = Row::new(ensemble, measured.load);
        let cells = tails.chunks_exact_mut(DEPTHS).zip(spreads.chunks_exact_mut(DEPTHS)).enumerate();
        for (member, (tails, spreads)) in cells {
            row.variance.copy_from_slice(self.variance_of(member));
            for line in &measured.lines {
                // A line that this member does not have says nothing of it.
                if ensemble.members()[member].change(line.index)[0].is_nan() {
                    continue;
                }
                self.expect(&mut row, ensemble, member, line, reference);
                let (change, scatter) = (line.change as f32, line.variance as f32);
                let expected = row.expected.iter().zip(&row.variance);
                for ((tail, spread), (expected, variance)) in
                    tails.iter_mut().zip(spreads.iter_mut()).zip(expected)
                {
                    let (residual, variance) = (change - expected, variance + scatter);
                    *tail *= (1.0 + residual * residual / (FREEDOM * variance)).min(MOST_TAIL);
                    *spread *= variance;
                }
            }
        }
        let mut log = by_lanes([&tails, &spreads], |[tails, spreads]| {
            tails.ln() * (-0.5 * (FREEDOM + 1.0)) - spreads.ln() * 0.5
        });
        let best = (0..log.len()).max_by(|&a, &b| log[a].total_cmp(&log[b])).unwrap_or(0);
        let highest = log.get(best).copied().unwrap_or(0.0);
        log.iter_mut().for_each(|value| *value -= highest);
        Likelihood { log, best: (best / DEPTHS, best % DEPTHS), highest: f64::from(highest) }
    }

    /// How each line of a record deviates from what a member expects at a depth.
    pub(super) fn deviations(
        &self,
        ensemble: &Ensemble,
        measured: &Measured,
        (member, depth): (usize, usize),
        reference: Reference<'_>,
    ) -> Vec<Deviation> {
        let mut row = Row::new(ensemble, measured.load);
        row.variance.copy_from_slice(self.variance_of(member));
        let deviation = |line: &MeasuredLine| {
            self.expect(&mut row, ensemble, member, line, reference);
            let residual = line.change - f64::from(row.expected[depth]);
            residual.is_finite().then(|| Deviation {
                name: line_name(line.index),
                residual,
                deviation: (f64::from(row.variance[depth]) + line.variance).sqrt(),
            })
        };
        measured.lines.iter().filter_map(deviation).collect()
    }

    /// By depth: variance of what a member may have wrong.
    fn variance_of(&self, member: usize) -> &[f32] {
        &self.variance[member * DEPTHS..(member + 1) * DEPTHS]
    }

    /// What a member expects of a line at each depth, and the variance of that: the row's own unless torque
    /// or an inspection change it.
    fn expect(
        &self,
        row: &mut Row,
        ensemble: &Ensemble,
        member: usize,
        line: &MeasuredLine,
        reference: Reference<'_>,
    ) {
        let (index, floor) = (line.index, line.floor as f32);
        let changes = ensemble.members()[member].change(index);
        let from = reference.depths.map_or(0.0, |depths| changes[usize::from(depths[member])]);
        if row.load.is_some() || reference.anchor.is_some() {
            row.variance.copy_from_slice(self.variance_of(member));
        }
        for (expected, change) in row.expected.iter_mut().zip(changes) {
            *expected = (change - from).max(floor);
        }
        if let Some(load) = &row.load {
            for depth in 0..DEPTHS {
                let (before, part) = load[depth];
                let after = (before + 1).min(DEPTHS - 1);
                let shift = changes[before] + part * (changes[after] - changes[before]) - changes[depth];
                row.expected[depth] += shift;
                row.variance[depth] += (LOAD_DISCREPANCY * shift).powi(2);
            }
        }
        if let Some(anchor) = reference.anchor
            && let Some(seen) = anchor.changes[index]
        {
            let at = usize::from(anchor.depths[member]);
            let reach_um = ANCHOR_REACH * row.depths_um[DEPTHS - 1];
            let wrong = seen - (changes[at] - from).max(floor);
            if wrong.is_finite() {
                for depth in 0..DEPTHS {
                    let alike = (-(row.depths_um[depth] - row.depths_um[at]).abs() / reach_um).exp();
                    row.expected[depth] += alike * wrong;
                    row.variance[depth] *= 1.0 - alike * alike;
                }
            }
        }
    }
}

/// A function of two rows of numbers, eight at a time.
fn by_lanes(rows: [&[f32]; 2], of: impl Fn([f32x8; 2]) -> f32x8) -> Vec<f32> {
    let (parts, rests): ([&[[f32; LANES]]; 2], [&[f32]; 2]) = {
        let [(a, a_rest), (b, b_rest)] = rows.map(|row| row.as_chunks::<LANES>());
        ([a, b], [a_rest, b_rest])
    };
    let mut values = Vec::with_capacity(rows[0].len());
    for (a, b) in parts[0].iter().zip(parts[1]) {
        values.extend_from_slice(&of([f32x8::from(*a), f32x8::from(*b)]).to_array());
    }
    let padded = rests.map(|rest| {
        let mut lanes = [1.0; LANES];
        lanes[..rest.len()].copy_from_slice(rest);
        f32x8::from(lanes)
    });
    values.extend_from_slice(&of(padded).to_array()[..rests[0].len()]);
    values
}

/// One member's line over the depths.
struct Row {
    depths_um: Vec<f32>,
    /// By depth, where the line stands at this torque: loads and depths that grow in proportion give
    /// responses that do.
    load: Option<Vec<(usize, f32)>>,
    expected: [f32; DEPTHS],
    variance: [f32; DEPTHS],
}

impl Row {
    fn new(ensemble: &Ensemble, load: f64) -> Self {
        let depths_um: Vec<f32> = ensemble.depths_um().iter().map(|um| *um as f32).collect();
        let place = |um: &f32| {
            let um = um / load as f32;
            let upper = depths_um.partition_point(|depth| *depth <= um).clamp(1, DEPTHS - 1);
            let part = (um - depths_um[upper - 1]) / (depths_um[upper] - depths_um[upper - 1]);
            (upper - 1, part.clamp(0.0, 1.0))
        };
        let scaled = ((load - 1.0).abs() > 1e-3).then(|| depths_um.iter().map(place).collect());
        Self { depths_um, load: scaled, expected: [0.0; DEPTHS], variance: [0.0; DEPTHS] }
    }
}

impl Anchor {
    /// What an inspection that found `depth_um` at a place means for each member.
    pub(super) fn depths_at(
        ensemble: &Ensemble,
        depth_um: f64,
        gear: Option<usize>,
        place: FlankPlace,
    ) -> Vec<u8> {
        let nearest = |member: &crate::library::Member| {
            let parts = member.at_place(gear, place);
            let off =
                |depth: &usize| (ensemble.depths_um()[*depth] * f64::from(parts[*depth]) - depth_um).abs();
            (0..DEPTHS).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0) as u8
        };
        ensemble.members().iter().map(nearest).collect()
    }
}
