//! The Bayesian filter: a probability over the members of the ensemble, the wear depth and its rate.
//!
//! A member's error recurs in every record, so a thousand records at the same wear are not a thousand
//! independent pieces of evidence. The filter therefore weights each record's likelihood with a small
//! exponent ([`CARRIED`]), in proportion to the growth since the record before. The answer adds a part of the
//! newest record ([`ADDED`]). At each record, the filter restarts from the prior with a small probability
//! ([`FORGOTTEN`]; fixed share, Herbster and Warmuth 1998), so that it can recover from any state.

use pulp::{Arch, Simd, WithSimd};
use serde::{Deserialize, Serialize};

use super::exponential::exp;
use super::growth::{Elapsed, Growth, PRIOR, RATES};
use super::likelihood::Likelihood;
use super::packed::Packed;
use crate::library::{DEPTHS, REPORTED, end_um};

/// Exponent of a record's likelihood in the filter, per unit of growth since the record before, so that more
/// frequent records carry no more weight. It is largest for the first record after a unit or more.
const CARRIED: f32 = 0.026;

/// The same after an inspection. The error that an inspection leaves a member is smaller, so that each record
/// counts more, but it still recurs in every record. Chosen on members left out of the ensembles of four
/// pairs.
const CARRIED_AFTER_INSPECTION: f32 = 0.005;

/// Exponent of the newest record's likelihood in the answer.
const ADDED: f32 = 0.28;

/// Probability that the filter restarts from the prior, per unit of growth since the record before. It is
/// largest for the first record after a unit or more.
const FORGOTTEN: f32 = 0.003;

/// Prior mean of the depth at the end of a new machine's baseline, in parts of the library's end.
const BEGINNING_PART: f64 = 0.006;

/// Number of cells of one group.
const BLOCK: usize = RATES * DEPTHS;

/// Numbers by depth.
type Row = [f32; DEPTHS];

/// The filter's state, packed to 16 bits per cell. Members of one group share the probability of rate and
/// depth; each has a part of the group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Filter {
    /// By group, rate and depth.
    cells: Packed,
    /// By member: its part of its group.
    parts: Packed,
    /// Probability without any record, by rate and depth.
    prior: Vec<f32>,
}

/// The posterior after a record.
pub(super) struct JointPosterior {
    /// By group of members and depth; the sum is 1.
    pub(super) joint: Vec<f32>,
    /// By rate and depth; the sum is 1.
    pub(super) by_rate: Vec<f32>,
}

impl JointPosterior {
    /// Mixes in depths by their probability, without growth, with a weight.
    pub(super) fn or_depths(mut self, by_depth: &[f32], weight: f32) -> Self {
        let groups = (self.joint.len() / DEPTHS).max(1) as f32;
        self.joint.iter_mut().chain(&mut self.by_rate).for_each(|p| *p *= 1.0 - weight);
        for row in self.joint.chunks_exact_mut(DEPTHS) {
            row.iter_mut().zip(by_depth).for_each(|(p, depth)| *p += weight / groups * depth);
        }
        // The first rate is that of no growth.
        self.by_rate.iter_mut().zip(by_depth).for_each(|(p, depth)| *p += weight * depth);
        self
    }

    /// Rescales the groups of members to given probabilities.
    pub(super) fn with_groups(mut self, groups: &[f32]) -> Self {
        for (row, group) in self.joint.chunks_exact_mut(DEPTHS).zip(groups) {
            let scale = group / sum(row).max(f32::MIN_POSITIVE);
            row.iter_mut().for_each(|p| *p *= scale);
        }
        normalise(&mut self.joint);
        self
    }

    /// Returns the probability by reported depth. The last one has that of all greater depths too.
    pub(super) fn by_depth(&self) -> Vec<f64> {
        let mut total = vec![0.0; DEPTHS];
        for row in self.joint.chunks_exact(DEPTHS) {
            total.iter_mut().zip(row).for_each(|(total, p)| *total += f64::from(*p));
        }
        let beyond: f64 = total.drain(REPORTED..).sum();
        total[REPORTED - 1] += beyond;
        total
    }
}

impl Filter {
    /// Creates the filter at the end of a new machine's baseline, for members in groups of `variants`.
    pub(super) fn start(depths_um: &[f64], members: usize, variants: usize) -> Self {
        let beginning_um = BEGINNING_PART * end_um(depths_um);
        let near = |um: &f64| (-um / beginning_um.max(f64::MIN_POSITIVE)).exp() as f32;
        let widths = depths_um
            .iter()
            .enumerate()
            .map(|(i, um)| depths_um.get(i + 1).map_or(0.0, |next| (next - um) as f32));
        let depths: Vec<f32> =
            depths_um.iter().map(near).zip(widths).map(|(near, width)| near * width).collect();
        let total: f32 = depths.iter().sum();
        let prior: Vec<f32> =
            PRIOR.iter().flat_map(|rate| depths.iter().map(move |p| rate * p / total)).collect();
        Self {
            cells: Packed::of(&prior.repeat(members / variants)),
            parts: Packed::of(&vec![1.0; members]),
            prior,
        }
    }

    /// Whether the filter has this number of members in groups of `variants`.
    pub(super) fn fits(&self, members: usize, variants: usize) -> bool {
        self.cells.len() == members / variants * BLOCK
            && self.parts.len() == members
            && self.prior.len() == BLOCK
    }

    /// Lets wear grow, then updates with one record, which may follow an inspection.
    pub(super) fn update(
        &mut self,
        growth: &Growth,
        elapsed: Elapsed,
        likelihood: &Likelihood,
        is_inspected: bool,
    ) -> JointPosterior {
        let (mut cells, mut parts) = self.unpacked();
        growth.advance(&mut self.prior, elapsed);
        normalise(&mut self.prior);
        let units = (elapsed.units as f32).min(1.0);
        let carried = if is_inspected { CARRIED_AFTER_INSPECTION } else { CARRIED };
        let step = Step {
            growth,
            elapsed,
            carried: carried * units,
            forgotten: FORGOTTEN * units,
            prior: &self.prior,
            likelihood,
            cells: &mut cells,
            parts: &mut parts,
        };
        let posterior = Arch::new().dispatch(step);
        self.pack(&cells, &parts);
        posterior
    }

    /// Updates with an inspection's likelihood by member and depth, at full weight.
    pub(super) fn inspect(&mut self, likelihood: &[f32]) {
        let (mut cells, mut parts) = self.unpacked();
        let members = parts.len();
        let variants = members / (cells.len() / BLOCK);
        let weights = rows(likelihood).chunks_exact(variants);
        let groups = cells.chunks_exact_mut(BLOCK).zip(parts.chunks_exact_mut(variants));
        for ((block, parts), weights) in groups.zip(weights) {
            let block = block.as_chunks_mut::<DEPTHS>().0;
            weigh(block, &by_depth(block), parts, weights, FORGOTTEN, |weight| weight);
        }
        let mean = |depth: usize| (0..members).map(|member| likelihood[member * DEPTHS + depth]).sum::<f32>();
        for (index, prior) in self.prior.iter_mut().enumerate() {
            // The inspection may contradict the prior, so depths of zero prior probability stay possible.
            *prior = (*prior + 1e-3) * mean(index % DEPTHS);
        }
        normalise(&mut self.prior);
        self.pack(&cells, &parts);
    }

    /// Unpacks cells and parts; the parts of each group are normalised to 1.
    fn unpacked(&self) -> (Vec<f32>, Vec<f32>) {
        let (cells, mut parts) = (self.cells.unpacked(), self.parts.unpacked());
        let variants = parts.len() / (cells.len() / BLOCK);
        parts.chunks_exact_mut(variants).for_each(normalise);
        (cells, parts)
    }

    fn pack(&mut self, cells: &[f32], parts: &[f32]) {
        self.cells.set(cells);
        self.parts.set(parts);
    }

    /// Returns the probability of each group of members; the sum is 1.
    pub(super) fn groups(&self) -> Vec<f32> {
        let mut groups: Vec<f32> = self.cells.unpacked().chunks_exact(BLOCK).map(sum).collect();
        normalise(&mut groups);
        groups
    }

    /// Returns the index of each member's mean depth.
    pub(super) fn mean_depths(&self) -> Vec<u8> {
        let cells = self.cells.unpacked();
        let variants = self.parts.len() / (cells.len() / BLOCK);
        let mean = |block: &[f32]| {
            let (mut sum, mut total) = (0.0, f32::MIN_POSITIVE);
            for (index, p) in block.iter().enumerate() {
                sum += p * (index % DEPTHS) as f32;
                total += p;
            }
            (sum / total).round().clamp(0.0, (DEPTHS - 1) as f32) as u8
        };
        let groups = cells.chunks_exact(BLOCK).map(mean);
        groups.flat_map(|mean| std::iter::repeat_n(mean, variants)).collect()
    }
}

/// The update with one record.
struct Step<'a> {
    growth: &'a Growth,
    elapsed: Elapsed,
    /// Exponent of the record's likelihood.
    carried: f32,
    /// Probability of a restart.
    forgotten: f32,
    prior: &'a [f32],
    likelihood: &'a Likelihood,
    cells: &'a mut [f32],
    parts: &'a mut [f32],
}

impl WithSimd for Step<'_> {
    type Output = JointPosterior;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> JointPosterior {
        let Self { growth, elapsed, carried, forgotten, prior, likelihood, cells, parts } = self;
        growth.advance(cells, elapsed);
        let groups = cells.len() / BLOCK;
        let variants = parts.len() / groups;
        let mut joint = Vec::with_capacity(groups * DEPTHS);
        let mut by_rate = vec![0.0; BLOCK];
        let (keep, restart) = ((1.0 - forgotten) / sum(cells), forgotten / groups as f32);
        let logs = rows(&likelihood.log).chunks_exact(variants);
        let groups = cells.chunks_exact_mut(BLOCK).zip(parts.chunks_exact_mut(variants));
        for ((block, parts), logs) in groups.zip(logs) {
            let block = block.as_chunks_mut::<DEPTHS>().0;
            for (row, prior) in block.iter_mut().zip(rows(prior)) {
                (0..DEPTHS).for_each(|depth| row[depth] = keep * row[depth] + restart * prior[depth]);
            }
            let depths = by_depth(block);
            let added = of_group(parts, logs, |log| exp(ADDED * log));
            joint.extend((0..DEPTHS).map(|depth| depths[depth] * added[depth]));
            for (row, by_rate) in block.iter().zip(by_rate.as_chunks_mut::<DEPTHS>().0) {
                (0..DEPTHS).for_each(|depth| by_rate[depth] += row[depth] * added[depth]);
            }
            weigh(block, &depths, parts, logs, forgotten, |log| exp(carried * log));
        }
        normalise(&mut joint);
        normalise(&mut by_rate);
        JointPosterior { joint, by_rate }
    }
}

/// Multiplies a group's cells with weights by member and depth, and updates each member's part of the group.
/// `depths` is the group's probability by depth. The part `forgotten` of what tells members apart is lost.
#[inline(always)]
fn weigh(
    block: &mut [Row],
    depths: &Row,
    parts: &mut [f32],
    members: &[Row],
    forgotten: f32,
    weight: impl Fn(f32) -> f32 + Copy,
) {
    let mut weights = [0.0; DEPTHS];
    for (part, row) in parts.iter_mut().zip(members) {
        let of_member: Row = std::array::from_fn(|depth| weight(row[depth]));
        (0..DEPTHS).for_each(|depth| weights[depth] += *part * of_member[depth]);
        let weighed: Row = std::array::from_fn(|depth| of_member[depth] * depths[depth]);
        *part *= sum(&weighed);
    }
    normalise(parts);
    let even = 1.0 / parts.len() as f32;
    parts.iter_mut().for_each(|part| *part += forgotten * (even - *part));
    for row in block {
        (0..DEPTHS).for_each(|depth| row[depth] *= weights[depth]);
    }
}

/// Returns the weights by depth, averaged over the members by their parts of the group.
#[inline(always)]
fn of_group(parts: &[f32], members: &[Row], weight: impl Fn(f32) -> f32) -> Row {
    let mut mean = [0.0; DEPTHS];
    for (part, row) in parts.iter().zip(members) {
        (0..DEPTHS).for_each(|depth| mean[depth] += part * weight(row[depth]));
    }
    mean
}

/// Returns a group's probability by depth.
#[inline(always)]
fn by_depth(block: &[Row]) -> Row {
    let mut depths = [0.0; DEPTHS];
    for row in block {
        (0..DEPTHS).for_each(|depth| depths[depth] += row[depth]);
    }
    depths
}

/// Splits values into rows by depth.
fn rows(values: &[f32]) -> &[Row] {
    values.as_chunks().0
}

/// Sums many numbers, in eight partial sums.
#[inline(always)]
fn sum(values: &[f32]) -> f32 {
    let (eights, rest) = values.as_chunks::<8>();
    let mut sums = [0.0_f32; 8];
    for eight in eights {
        sums.iter_mut().zip(eight).for_each(|(sum, value)| *sum += value);
    }
    sums.iter().chain(rest).sum()
}

#[inline(always)]
fn normalise(values: &mut [f32]) {
    let total = sum(values);
    if total > 0.0 {
        let scale = 1.0 / total;
        values.iter_mut().for_each(|value| *value *= scale);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_reported_depth_has_the_probability_of_all_greater_ones() {
        let mut joint = vec![0.0; 2 * DEPTHS];
        (joint[3], joint[REPORTED - 1], joint[2 * DEPTHS - 1]) = (0.5, 0.125, 0.375);
        let depths = JointPosterior { joint, by_rate: vec![0.0; BLOCK] }.by_depth();
        assert_eq!((depths.len(), depths[3], depths[REPORTED - 1]), (REPORTED, 0.5, 0.5));
    }

    #[test]
    fn no_wear_is_mixed_into_the_posterior() {
        let mut joint = vec![0.0; 3 * DEPTHS];
        joint[DEPTHS + 7] = 1.0;
        let mut by_rate = vec![0.0; BLOCK];
        by_rate[2 * DEPTHS + 7] = 1.0;
        let mixed = JointPosterior { joint, by_rate }.or_depths(&[0.5, 0.5], 0.5);
        let depths = mixed.by_depth();
        assert!((depths[0] - 0.25).abs() < 1e-6 && (depths[1] - 0.25).abs() < 1e-6);
        assert!((depths[7] - 0.5).abs() < 1e-6);
        assert_eq!((mixed.by_rate[0], mixed.by_rate[1], mixed.by_rate[2 * DEPTHS + 7]), (0.25, 0.25, 0.5));
    }
}
