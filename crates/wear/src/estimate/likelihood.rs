//! How likely each member of the ensemble, at each depth, makes a record.

use serde::{Deserialize, Serialize};

use super::healthy_lines::{Measured, MeasuredLine};
use super::novelty::Deviation;
use crate::library::{DEPTHS, Ensemble, FlankPlace, MESH_LINES, line_name};

/// Degrees of freedom of a line's Student t distribution: a line that a member has wrong by far does not decide.
const FREEDOM: f32 = 4.0;

/// What a member may be wrong by: the standard deviation of a line's change grows from 0 without wear towards this,
const DISCREPANCY: f64 = 0.5;

/// over this root mean square of the member's changes.
const DISCREPANCY_OVER: f64 = 0.65;

/// What the scaling with the torque may be wrong by, as a part of it.
const LOAD_DISCREPANCY: f32 = 0.35;

/// Depth in µm over which what a member is wrong by at an inspection is forgotten.
const ANCHOR_REACH_UM: f32 = 80.0;

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
        let mut variance = Vec::with_capacity(ensemble.members().len() * DEPTHS);
        for member in ensemble.members() {
            for depth in 0..DEPTHS {
                let known = (0..MESH_LINES)
                    .map(|line| f64::from(member.change(line)[depth]))
                    .filter(|change| change.is_finite());
                let (count, square) = known.fold((0.0, 0.0), |(count, sum), change| (count + 1.0, sum + change * change));
                let square = square / f64::max(count, 1.0) / (DISCREPANCY_OVER * DISCREPANCY_OVER);
                variance.push((DISCREPANCY * DISCREPANCY * (1.0 - (-square).exp())) as f32);
            }
        }
        Self { variance }
    }

    /// Compares a record with every member at every depth.
    pub(super) fn compare(&self, ensemble: &Ensemble, measured: &Measured, reference: Reference<'_>) -> Likelihood {
        let members = ensemble.members().len();
        let mut log = vec![0.0_f32; members * DEPTHS];
        let mut row = Row::new(ensemble, measured.load);
        for member in 0..members {
            let (mut tails, mut spreads) = ([1.0_f64; DEPTHS], [1.0_f64; DEPTHS]);
            for line in &measured.lines {
                self.expect(&mut row, ensemble, member, line, reference);
                let (change, scatter) = (line.change as f32, line.variance as f32);
                for depth in 0..DEPTHS {
                    let variance = row.variance[depth] + scatter;
                    let residual = change - row.expected[depth];
                    let tail = 1.0 + residual * residual / (FREEDOM * variance);
                    // A line that this member does not have says nothing of it.
                    if tail.is_finite() {
                        tails[depth] *= f64::from(tail);
                        spreads[depth] *= f64::from(variance);
                    }
                }
            }
            for depth in 0..DEPTHS {
                log[member * DEPTHS + depth] = -(0.5 * f64::from(FREEDOM + 1.0) * tails[depth].ln() + 0.5 * spreads[depth].ln()) as f32;
            }
        }
        let best = (0..log.len()).max_by(|&a, &b| log[a].total_cmp(&log[b])).unwrap_or(0);
        let highest = log.get(best).copied().unwrap_or(0.0);
        log.iter_mut().for_each(|value| *value -= highest);
        Likelihood {
            log,
            best: (best / DEPTHS, best % DEPTHS),
            highest: f64::from(highest),
        }
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

    /// What a member expects of a line at each depth, and the variance of that.
    fn expect(&self, row: &mut Row, ensemble: &Ensemble, member: usize, line: &MeasuredLine, reference: Reference<'_>) {
        let (index, floor) = (line.index, line.floor as f32);
        let changes = ensemble.members()[member].change(index);
        let from = reference.depths.map_or(0.0, |depths| changes[usize::from(depths[member])]);
        row.variance.copy_from_slice(&self.variance[member * DEPTHS..(member + 1) * DEPTHS]);
        for depth in 0..DEPTHS {
            row.expected[depth] = (changes[depth] - from).max(floor);
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
            let wrong = seen - (changes[at] - from).max(floor);
            if wrong.is_finite() {
                for depth in 0..DEPTHS {
                    let alike = (-(row.depths_um[depth] - row.depths_um[at]).abs() / ANCHOR_REACH_UM).exp();
                    row.expected[depth] += alike * wrong;
                    row.variance[depth] *= 1.0 - alike * alike;
                }
            }
        }
    }
}

/// One member's line over the depths.
struct Row {
    depths_um: Vec<f32>,
    /// By depth, where the line stands at this torque: loads and depths that grow in proportion give responses that do.
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
        Self {
            depths_um,
            load: scaled,
            expected: [0.0; DEPTHS],
            variance: [0.0; DEPTHS],
        }
    }
}

impl Anchor {
    /// What an inspection that found `depth_um` at a place means for each member.
    pub(super) fn depths_at(ensemble: &Ensemble, depth_um: f64, gear: Option<usize>, place: FlankPlace) -> Vec<u8> {
        let nearest = |member: &crate::library::Member| {
            let parts = member.at_place(gear, place);
            let off = |depth: &usize| (ensemble.depths_um()[*depth] * f64::from(parts[*depth]) - depth_um).abs();
            (0..DEPTHS).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0) as u8
        };
        ensemble.members().iter().map(nearest).collect()
    }
}
