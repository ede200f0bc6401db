//! How likely each member of the ensemble, at each depth, makes a record.

use pulp::{Arch, Simd, WithSimd};

use super::anchor::{Anchor, anchor_reach};
use super::deviation::Deviation;
use super::exponential::ln;
use super::extrapolation::Extrapolation;
use super::healthy_lines::{Measured, MeasuredLine};
use super::load::Load;
use crate::library::{DEPTHS, Ensemble, MESH_LINES, line_name};

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

/// What follows from an ensemble alone.
#[derive(Debug, Clone)]
pub(super) struct Discrepancy {
    /// Its standard deviation far from no wear.
    most: f64,
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
        Self { most, variance }
    }

    /// Compares a record with every member at every depth.
    pub(super) fn compare(
        &self,
        ensemble: &Ensemble,
        measured: &Measured,
        reference: Reference<'_>,
    ) -> Likelihood {
        Arch::new().dispatch(Comparison { discrepancy: self, ensemble, measured, reference })
    }

    /// How each line of a record deviates from what a member expects at a depth.
    pub(super) fn deviations(
        &self,
        ensemble: &Ensemble,
        measured: &Measured,
        (member, depth): (usize, usize),
        reference: Reference<'_>,
    ) -> Vec<Deviation> {
        let mut row = self.row(ensemble, measured, reference);
        row.take_variance(self.variance_of(member));
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

    /// A row for a record.
    fn row(&self, ensemble: &Ensemble, measured: &Measured, reference: Reference<'_>) -> Row {
        let doubt = reference.extrapolation.variance_factor(self.most);
        Row::new(ensemble, measured.load, doubt as f32)
    }

    /// By depth: variance of what a member may have wrong.
    fn variance_of(&self, member: usize) -> &[f32] {
        &self.variance[member * DEPTHS..(member + 1) * DEPTHS]
    }

    /// What a member expects of a line at each depth, and the variance of that: the row's own unless torque
    /// or an inspection change it.
    #[inline(always)]
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
            row.take_variance(self.variance_of(member));
        }
        for (expected, change) in row.expected.iter_mut().zip(changes) {
            *expected = (change - from).max(floor);
        }
        if let Some(load) = &mut row.load {
            let shifts = load.shifts(changes);
            for ((expected, variance), shift) in row.expected.iter_mut().zip(&mut row.variance).zip(shifts) {
                *expected += shift;
                *variance += (LOAD_DISCREPANCY * shift).powi(2);
            }
        }
        if let Some(anchor) = reference.anchor
            && let Some(seen) = anchor.changes[index]
        {
            let at = usize::from(anchor.depths[member]);
            let contact = ensemble.members()[member].contact;
            let reach_um = anchor_reach(contact) * row.depths_um[DEPTHS - 1];
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

/// A factor on a line's variances that keeps the product over all lines within what single precision holds.
struct Scaling {
    /// The line's own variance.
    variance: f32,
    factor: f32,
    half_log: f32,
}

impl Scaling {
    fn of(variance: f32) -> Self {
        let factor = 0.1 / (0.1 + variance);
        Self { variance, factor, half_log: 0.5 * factor.ln() }
    }
}

/// A record beside all members.
#[derive(Clone, Copy)]
struct Comparison<'a> {
    discrepancy: &'a Discrepancy,
    ensemble: &'a Ensemble,
    measured: &'a Measured,
    reference: Reference<'a>,
}

impl WithSimd for Comparison<'_> {
    type Output = Likelihood;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Likelihood {
        let mut row = self.discrepancy.row(self.ensemble, self.measured, self.reference);
        let lines = &self.measured.lines;
        let scaling = lines.iter().map(|line| Scaling::of(line.variance_after_baseline() as f32));
        let scaling: Vec<Scaling> = scaling.collect();
        let mut log = vec![0.0; self.ensemble.members().len() * DEPTHS];
        let (mut best, mut highest) = ((0, 0), f32::NEG_INFINITY);
        for (member, log) in log.as_chunks_mut::<DEPTHS>().0.iter_mut().enumerate() {
            *log = self.log_likelihood(&mut row, &scaling, member);
            let most = log.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            if most > highest {
                highest = most;
                best = (member, log.iter().position(|value| *value == most).unwrap_or(0));
            }
        }
        log.iter_mut().for_each(|value| *value -= highest);
        Likelihood { log, best, highest: f64::from(highest) }
    }
}

impl Comparison<'_> {
    /// Logarithm of the likelihood by one member's depths.
    #[inline(always)]
    fn log_likelihood(&self, row: &mut Row, scaling: &[Scaling], member: usize) -> [f32; DEPTHS] {
        let Self { discrepancy, ensemble, measured, reference } = *self;
        let (mut tails, mut spreads, mut scale) = ([1.0_f32; DEPTHS], [1.0_f32; DEPTHS], 0.0);
        row.take_variance(discrepancy.variance_of(member));
        for (line, scaling) in measured.lines.iter().zip(scaling) {
            // A line that this member does not have says nothing of it.
            if ensemble.members()[member].change(line.index)[0].is_nan() {
                continue;
            }
            discrepancy.expect(row, ensemble, member, line, reference);
            let (change, scatter) = (line.change as f32, scaling.variance);
            scale += scaling.half_log;
            let of_square = scaling.factor / FREEDOM;
            for depth in 0..DEPTHS {
                let residual = change - row.expected[depth];
                let variance = scaling.factor * (row.variance[depth] + scatter);
                let tail = variance + of_square * residual * residual;
                tails[depth] *= tail.min(MOST_TAIL * variance);
                spreads[depth] *= variance;
            }
        }
        // Of Student's t, with (ν + r²/σ²)/ν as a quotient of both products.
        std::array::from_fn(|depth| {
            scale + 0.5 * (FREEDOM * ln(spreads[depth]) - (FREEDOM + 1.0) * ln(tails[depth]))
        })
    }
}

/// One member's line over the depths.
struct Row {
    depths_um: Vec<f32>,
    /// Where a line stands at this torque.
    load: Option<Load>,
    /// Factor on the variance at this speed.
    doubt: f32,
    expected: [f32; DEPTHS],
    variance: [f32; DEPTHS],
}

impl Row {
    fn new(ensemble: &Ensemble, load: f64, doubt: f32) -> Self {
        let depths_um: Vec<f32> = ensemble.depths_um().iter().map(|um| *um as f32).collect();
        let scaled = ((load - 1.0).abs() > 1e-3).then(|| Load::of(load as f32, &depths_um));
        Self { depths_um, load: scaled, doubt, expected: [0.0; DEPTHS], variance: [0.0; DEPTHS] }
    }

    /// Begins with what a member may have wrong by itself.
    #[inline(always)]
    fn take_variance(&mut self, own: &[f32]) {
        for (variance, own) in self.variance.iter_mut().zip(own) {
            *variance = self.doubt * own;
        }
    }
}
