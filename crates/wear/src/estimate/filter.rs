//! The Bayesian filter: a probability over the members of the ensemble, the wear depth and its rate.
//!
//! A member's error recurs in every record, so a thousand records at the same wear are not a thousand
//! independent pieces of evidence. The filter therefore weights each record's likelihood with a small
//! exponent ([`STORED_EXPONENT`]), in proportion to the growth since the record before. The estimate adds a
//! part of the newest record ([`NEWEST_EXPONENT`]). At each record, the filter restarts from the prior with a
//! small probability ([`RESTART_PROBABILITY`]; fixed share, Herbster and Warmuth 1998), so that it can
//! recover from any state.

use pulp::{Arch, Simd, WithSimd};
use serde::{Deserialize, Serialize};

use super::exponential::exp;
use super::groups::{Block, Depths, blocks_of, by_depth, by_lane, lanes_in, normalise, normalise_lanes, sum};
use super::growth::{Elapsed, Growth, PRIOR, RATES};
use super::joint_posterior::JointPosterior;
use super::likelihood::Likelihood;
use super::packed::Packed;
use crate::library::{DEPTHS, LANES, Lanes, end_um};

/// Exponent of a record's likelihood in the filter, per unit of growth since the record before, so that more
/// frequent records carry no more weight. It is largest for the first record after a unit or more.
const STORED_EXPONENT: f32 = 0.026;

/// The same after an inspection. The error that an inspection leaves a member is smaller, so that each record
/// counts more, but it still recurs in every record. Chosen on members left out of the ensembles of four
/// pairs.
const STORED_EXPONENT_AFTER_INSPECTION: f32 = 0.005;

/// Exponent of the newest record's likelihood in the estimate.
const NEWEST_EXPONENT: f32 = 0.28;

/// Probability that the filter restarts from the prior, per unit of growth since the record before. It is
/// largest for the first record after a unit or more.
const RESTART_PROBABILITY: f32 = 0.003;

/// Prior mean of the depth at the end of a new machine's baseline, in parts of the library's end.
const BEGINNING_PART: f64 = 0.006;

/// The filter's state, packed to 16 bits per cell. Members of one group share the probability of rate and
/// depth; each has a part of the group. Groups are in blocks, as the ensemble has them, and unused lanes of
/// the last block have no probability.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Filter {
    groups: usize,
    /// By block, rate, depth and group.
    cells: Packed,
    /// By block, variant and group: the member's part of its group.
    parts: Packed,
    /// Probability without any record, by rate and depth.
    prior: Vec<f32>,
}

impl Filter {
    /// Creates the filter at the end of a new machine's baseline, for groups of `variants` members.
    pub(super) fn start(depths_um: &[f64], groups: usize, variants: usize) -> Self {
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
        let blocks = groups.div_ceil(LANES);
        let of_block = |block: usize| {
            let used = lanes_in(groups, block);
            prior.iter().flat_map(move |p| (0..LANES).map(move |lane| if lane < used { *p } else { 0.0 }))
        };
        let cells: Vec<f32> = (0..blocks).flat_map(of_block).collect();
        Self {
            groups,
            cells: Packed::of(&cells),
            parts: Packed::of(&vec![1.0; blocks * variants * LANES]),
            prior,
        }
    }

    /// Whether the filter has this number of members in groups of `variants`.
    pub(super) fn fits(&self, members: usize, variants: usize) -> bool {
        let blocks = self.groups.div_ceil(LANES);
        self.groups * variants == members
            && self.cells.len() == blocks * RATES * DEPTHS * LANES
            && self.parts.len() == blocks * variants * LANES
            && self.prior.len() == RATES * DEPTHS
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
        growth.advance(self.prior.as_chunks_mut::<1>().0.as_chunks_mut().0.as_chunks_mut().0, elapsed);
        normalise(&mut self.prior);
        let units = (elapsed.units as f32).min(1.0);
        let stored_exponent = if is_inspected { STORED_EXPONENT_AFTER_INSPECTION } else { STORED_EXPONENT };
        let step = Step {
            growth,
            elapsed,
            stored_exponent: stored_exponent * units,
            restart_probability: RESTART_PROBABILITY * units,
            groups: self.groups,
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
        let variants = self.variants();
        let of_depths = likelihood.as_chunks::<DEPTHS>().0;
        for (index, block) in blocks_of(&mut cells).iter_mut().enumerate() {
            let parts = &mut parts.as_chunks_mut::<LANES>().0[index * variants..][..variants];
            let depths = by_depth(block);
            let mut weights = Weights::of(&depths);
            for (variant, part) in parts.iter_mut().enumerate() {
                let member = |lane: usize| (index * LANES + lane).min(self.groups - 1) * variants + variant;
                weights.add(part, |depth| std::array::from_fn(|lane| of_depths[member(lane)][depth]));
            }
            weights.apply(block, parts, RESTART_PROBABILITY);
        }
        let mean = |depth: usize| of_depths.iter().map(|of_depth| of_depth[depth]).sum::<f32>();
        for (index, prior) in self.prior.iter_mut().enumerate() {
            // The inspection may contradict the prior, so depths of zero prior probability stay possible.
            *prior = (*prior + 1e-3) * mean(index % DEPTHS);
        }
        normalise(&mut self.prior);
        self.pack(&cells, &parts);
    }

    /// Number of members of a group.
    fn variants(&self) -> usize {
        self.parts.len() / (self.groups.div_ceil(LANES) * LANES)
    }

    /// Unpacks cells and parts; the parts of each group are normalised to 1.
    fn unpacked(&self) -> (Vec<f32>, Vec<f32>) {
        let (cells, mut parts) = (self.cells.unpacked(), self.parts.unpacked());
        parts.as_chunks_mut::<LANES>().0.chunks_exact_mut(self.variants()).for_each(normalise_lanes);
        (cells, parts)
    }

    fn pack(&mut self, cells: &[f32], parts: &[f32]) {
        self.cells.set(cells);
        self.parts.set(parts);
    }

    /// Returns the probability of each group of members; the sum is 1.
    pub(super) fn groups(&self) -> Vec<f32> {
        let mut cells = self.cells.unpacked();
        let of_block = |block: &Block| by_lane(&by_depth(block));
        let mut groups: Vec<f32> = blocks_of(&mut cells).iter().flat_map(of_block).collect();
        groups.truncate(self.groups);
        normalise(&mut groups);
        groups
    }

    /// Returns the index of each member's mean depth.
    pub(super) fn mean_depths(&self) -> Vec<u8> {
        let mut cells = self.cells.unpacked();
        let of_block = |block: &Block| {
            let depths = by_depth(block);
            let mean = move |lane: usize| {
                let (mut sum, mut total) = (0.0, f32::MIN_POSITIVE);
                for (depth, row) in depths.iter().enumerate() {
                    sum += row[lane] * depth as f32;
                    total += row[lane];
                }
                (sum / total).round().clamp(0.0, (DEPTHS - 1) as f32) as u8
            };
            (0..LANES).map(mean)
        };
        let groups = blocks_of(&mut cells).iter().flat_map(of_block).take(self.groups);
        groups.flat_map(|mean| std::iter::repeat_n(mean, self.variants())).collect()
    }
}

/// The update with one record.
struct Step<'a> {
    growth: &'a Growth,
    elapsed: Elapsed,
    /// Exponent of the record's likelihood.
    stored_exponent: f32,
    /// Probability of a restart.
    restart_probability: f32,
    groups: usize,
    prior: &'a [f32],
    likelihood: &'a Likelihood,
    cells: &'a mut [f32],
    parts: &'a mut [f32],
}

impl WithSimd for Step<'_> {
    type Output = JointPosterior;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> JointPosterior {
        let Self {
            growth,
            elapsed,
            stored_exponent,
            restart_probability,
            groups,
            prior,
            likelihood,
            cells,
            parts,
        } = self;
        let blocks = blocks_of(cells);
        growth.advance(blocks, elapsed);
        let variants = likelihood.log.len() / blocks.len();
        let keep = (1.0 - restart_probability) / sum(blocks.as_flattened().as_flattened().as_flattened());
        let (priors, _) = prior.as_chunks::<DEPTHS>();
        let mut joint = Vec::with_capacity(blocks.len() * DEPTHS * LANES);
        let mut standing = [0.0; LANES];
        let parts = parts.as_chunks_mut::<LANES>().0.chunks_exact_mut(variants);
        let logs = likelihood.log.chunks_exact(variants);
        for (index, ((block, parts), logs)) in blocks.iter_mut().zip(parts).zip(logs).enumerate() {
            let used = lanes_in(groups, index);
            let restart: Lanes =
                std::array::from_fn(
                    |lane| if lane < used { restart_probability / groups as f32 } else { 0.0 },
                );
            for (row, prior) in block.iter_mut().zip(priors) {
                for (row, prior) in row.iter_mut().zip(prior) {
                    for lane in 0..LANES {
                        row[lane] = keep * row[lane] + restart[lane] * prior;
                    }
                }
            }
            let depths = by_depth(block);
            let mut added = [[0.0; LANES]; DEPTHS];
            let mut weights = Weights::of(&depths);
            for (part, log) in parts.iter_mut().zip(logs) {
                for (added, log) in added.iter_mut().zip(log) {
                    let weights = raised(log, likelihood.highest, NEWEST_EXPONENT);
                    for lane in 0..LANES {
                        added[lane] += part[lane] * weights[lane];
                    }
                }
                weights.add(part, |depth| raised(&log[depth], likelihood.highest, stored_exponent));
            }
            for (depths, added) in depths.iter().zip(&added) {
                joint.extend((0..LANES).map(|lane| depths[lane] * added[lane]));
            }
            // The first rate is that of no growth.
            for (row, added) in block[0].iter().zip(&added) {
                for lane in 0..LANES {
                    standing[lane] += row[lane] * added[lane];
                }
            }
            weights.apply(block, parts, restart_probability);
        }
        let standstill = sum(&standing) / sum(&joint).max(f32::MIN_POSITIVE);
        normalise(&mut joint);
        JointPosterior { groups, joint, standstill }
    }
}

/// Weights of a block's groups by depth, averaged over the members by their parts of the group.
struct Weights<'a> {
    /// The groups' probability by depth.
    depths: &'a Depths,
    weights: Depths,
}

impl<'a> Weights<'a> {
    #[inline(always)]
    fn of(depths: &'a Depths) -> Self {
        Self { depths, weights: [[0.0; LANES]; DEPTHS] }
    }

    /// Adds one member of each group with its weights by depth, and multiplies its part of the group with its
    /// mean weight.
    #[inline(always)]
    fn add(&mut self, part: &mut Lanes, at_depth: impl Fn(usize) -> Lanes) {
        let mut mean = [0.0; LANES];
        for (depth, weights) in self.weights.iter_mut().enumerate() {
            let of_members = at_depth(depth);
            for lane in 0..LANES {
                weights[lane] += part[lane] * of_members[lane];
                mean[lane] += of_members[lane] * self.depths[depth][lane];
            }
        }
        for lane in 0..LANES {
            part[lane] *= mean[lane];
        }
    }

    /// Multiplies a block's cells with the weights. The part `restart_probability` of what tells members
    /// apart is lost.
    #[inline(always)]
    fn apply(&self, block: &mut Block, parts: &mut [Lanes], restart_probability: f32) {
        normalise_lanes(parts);
        let even = 1.0 / parts.len() as f32;
        parts.as_flattened_mut().iter_mut().for_each(|part| *part += restart_probability * (even - *part));
        for row in block {
            for (row, weights) in row.iter_mut().zip(&self.weights) {
                for lane in 0..LANES {
                    row[lane] *= weights[lane];
                }
            }
        }
    }
}

/// Returns likelihoods over the highest one, raised to a power.
#[inline(always)]
fn raised(log: &Lanes, highest: f32, exponent: f32) -> Lanes {
    let mut raised = [0.0; LANES];
    for lane in 0..LANES {
        raised[lane] = exp(exponent * (log[lane] - highest));
    }
    raised
}
