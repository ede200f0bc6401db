//! What is believed of a machine: a probability over the members of the ensemble, the depth of wear and its
//! rate.
//!
//! What a member has wrong it has wrong in the next record too, so a thousand records of a machine whose wear
//! stands still are not a thousand pieces of evidence. The filter therefore takes each record at a small part
//! of its weight ([`CARRIED`]), in proportion to the growth that may have gone on since the record before,
//! and the answer adds a part of the newest record ([`ADDED`]). With a small probability a record is the
//! first of a story that begins anew from the prior ([`FORGOTTEN`]; fixed share, Herbster and Warmuth 1998),
//! so that no belief is ever beyond recall.

use base64::Engine;
use base64::engine::general_purpose::STANDARD_NO_PAD;
use pulp::{Arch, Simd, WithSimd};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::exponential::exp;
use super::growth::{Growth, PRIOR, RATES};
use super::likelihood::Likelihood;
use crate::library::DEPTHS;

/// Weight of a record's likelihood in what is carried on, a unit of growth since the record before: records
/// that come more often say no more. The most is for the first record after a long interval.
const CARRIED: f32 = 0.032;

/// Weight of the newest record's likelihood in the answer.
const ADDED: f32 = 0.12;

/// Probability that what was believed before a record is forgotten for the prior.
const FORGOTTEN: f32 = 0.003;

/// Mean depth at the end of a new machine's baseline, in parts of the greatest.
const BEGINNING_PART: f64 = 0.006;

/// Cells of one group.
const BLOCK: usize = RATES * DEPTHS;

/// Numbers by depth.
type Row = [f32; DEPTHS];

/// The probability, packed: a number of 16 bits a cell. Members of one group share the probability of depth
/// and rate; each has a part of the group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Filter {
    /// By group, rate and depth.
    cells: Packed,
    /// By member: its part of its group.
    parts: Packed,
    /// What would be believed without any record, by rate and depth.
    prior: Vec<f32>,
}

/// What is believed after a record, and by the record itself.
pub(super) struct JointPosterior {
    /// By group of members and depth; the sum is 1.
    pub(super) joint: Vec<f32>,
    /// By rate and depth; the sum is 1.
    pub(super) by_rate: Vec<f32>,
}

impl JointPosterior {
    /// The same where, with this probability, there is no wear at all.
    pub(super) fn or_no_wear(mut self, probability: f32) -> Self {
        let groups = (self.joint.len() / DEPTHS).max(1) as f32;
        self.joint.iter_mut().chain(&mut self.by_rate).for_each(|p| *p *= 1.0 - probability);
        self.joint.iter_mut().step_by(DEPTHS).for_each(|p| *p += probability / groups);
        // The first rate is that of no growth.
        self.by_rate[0] += probability;
        self
    }

    /// The same where each group of members has a given probability.
    pub(super) fn with_groups(mut self, groups: &[f32]) -> Self {
        for (row, group) in self.joint.chunks_exact_mut(DEPTHS).zip(groups) {
            let scale = group / sum(row).max(f32::MIN_POSITIVE);
            row.iter_mut().for_each(|p| *p *= scale);
        }
        normalise(&mut self.joint);
        self
    }

    /// By depth.
    pub(super) fn by_depth(&self) -> Vec<f64> {
        let mut total = vec![0.0; DEPTHS];
        for row in self.joint.chunks_exact(DEPTHS) {
            total.iter_mut().zip(row).for_each(|(total, p)| *total += f64::from(*p));
        }
        total
    }
}

impl Filter {
    /// At the end of a new machine's baseline, for members in groups of `variants`.
    pub(super) fn start(depths_um: &[f64], members: usize, variants: usize) -> Self {
        let beginning_um = BEGINNING_PART * depths_um.last().copied().unwrap_or(0.0);
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

    /// Whether this is about as many members in as many groups.
    pub(super) fn fits(&self, members: usize, variants: usize) -> bool {
        self.cells.0.len() == members / variants * BLOCK
            && self.parts.0.len() == members
            && self.prior.len() == BLOCK
    }

    /// Lets wear grow over `units` and takes one record.
    pub(super) fn update(&mut self, growth: &Growth, units: f64, likelihood: &Likelihood) -> JointPosterior {
        let (mut cells, mut parts) = self.unpacked();
        growth.advance(&mut self.prior, units);
        normalise(&mut self.prior);
        let step = Step {
            growth,
            units,
            carried: CARRIED * (units as f32).min(1.0),
            prior: &self.prior,
            likelihood,
            cells: &mut cells,
            parts: &mut parts,
        };
        let posterior = Arch::new().dispatch(step);
        self.pack(&cells, &parts);
        posterior
    }

    /// Takes what an inspection says: a likelihood by member and depth, in full.
    pub(super) fn inspect(&mut self, likelihood: &[f32]) {
        let (mut cells, mut parts) = self.unpacked();
        let members = parts.len();
        let variants = members / (cells.len() / BLOCK);
        let weights = rows(likelihood).chunks_exact(variants);
        let groups = cells.chunks_exact_mut(BLOCK).zip(parts.chunks_exact_mut(variants));
        for ((block, parts), weights) in groups.zip(weights) {
            let block = block.as_chunks_mut::<DEPTHS>().0;
            weigh(block, &by_depth(block), parts, weights, |weight| weight);
        }
        let mean = |depth: usize| (0..members).map(|member| likelihood[member * DEPTHS + depth]).sum::<f32>();
        for (index, prior) in self.prior.iter_mut().enumerate() {
            // What the prior had no probability for is possible too: the inspection knows better.
            *prior = (*prior + 1e-3) * mean(index % DEPTHS);
        }
        normalise(&mut self.prior);
        self.pack(&cells, &parts);
    }

    /// Cells, and parts that add up to 1 in each group.
    fn unpacked(&self) -> (Vec<f32>, Vec<f32>) {
        let (cells, mut parts) = (self.cells.unpacked(), self.parts.unpacked());
        let variants = parts.len() / (cells.len() / BLOCK);
        parts.chunks_exact_mut(variants).for_each(normalise);
        (cells, parts)
    }

    fn pack(&mut self, cells: &[f32], parts: &[f32]) {
        self.cells = Packed::of(cells);
        self.parts = Packed::of(parts);
    }

    /// The probability of each group of members; the sum is 1.
    pub(super) fn groups(&self) -> Vec<f32> {
        let mut groups: Vec<f32> = self.cells.unpacked().chunks_exact(BLOCK).map(sum).collect();
        normalise(&mut groups);
        groups
    }

    /// The index of the mean depth of each member.
    pub(super) fn mean_depths(&self) -> Vec<u8> {
        let cells = self.cells.unpacked();
        let variants = self.parts.0.len() / (cells.len() / BLOCK);
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

/// One record's step.
struct Step<'a> {
    growth: &'a Growth,
    units: f64,
    /// Weight of the record in what is carried on.
    carried: f32,
    prior: &'a [f32],
    likelihood: &'a Likelihood,
    cells: &'a mut [f32],
    parts: &'a mut [f32],
}

impl WithSimd for Step<'_> {
    type Output = JointPosterior;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> JointPosterior {
        let Self { growth, units, carried, prior, likelihood, cells, parts } = self;
        growth.advance(cells, units);
        let groups = cells.len() / BLOCK;
        let variants = parts.len() / groups;
        let mut joint = Vec::with_capacity(groups * DEPTHS);
        let mut by_rate = vec![0.0; BLOCK];
        let (kept, fresh) = ((1.0 - FORGOTTEN) / sum(cells), FORGOTTEN / groups as f32);
        let logs = rows(&likelihood.log).chunks_exact(variants);
        let groups = cells.chunks_exact_mut(BLOCK).zip(parts.chunks_exact_mut(variants));
        for ((block, parts), logs) in groups.zip(logs) {
            let block = block.as_chunks_mut::<DEPTHS>().0;
            for (row, prior) in block.iter_mut().zip(rows(prior)) {
                (0..DEPTHS).for_each(|depth| row[depth] = kept * row[depth] + fresh * prior[depth]);
            }
            let depths = by_depth(block);
            let added = of_group(parts, logs, |log| exp(ADDED * log));
            joint.extend((0..DEPTHS).map(|depth| depths[depth] * added[depth]));
            for (row, by_rate) in block.iter().zip(by_rate.as_chunks_mut::<DEPTHS>().0) {
                (0..DEPTHS).for_each(|depth| by_rate[depth] += row[depth] * added[depth]);
            }
            weigh(block, &depths, parts, logs, |log| exp(carried * log));
        }
        normalise(&mut joint);
        normalise(&mut by_rate);
        JointPosterior { joint, by_rate }
    }
}

/// Multiplies a group's cells, `depths` of them at each depth, with weights by member and depth, and each
/// member's part of the group with what it has of them.
#[inline(always)]
fn weigh(
    block: &mut [Row],
    depths: &Row,
    parts: &mut [f32],
    members: &[Row],
    weight: impl Fn(f32) -> f32 + Copy,
) {
    let weights = of_group(parts, members, weight);
    for (part, row) in parts.iter_mut().zip(members) {
        let weighed: Row = std::array::from_fn(|depth| weight(row[depth]) * depths[depth]);
        *part *= sum(&weighed);
    }
    normalise(parts);
    let even = 1.0 / parts.len() as f32;
    parts.iter_mut().for_each(|part| *part += FORGOTTEN * (even - *part));
    for row in block {
        (0..DEPTHS).for_each(|depth| row[depth] *= weights[depth]);
    }
}

/// By depth: the mean of the members' weights, each by its part of the group.
#[inline(always)]
fn of_group(parts: &[f32], members: &[Row], weight: impl Fn(f32) -> f32) -> Row {
    let mut mean = [0.0; DEPTHS];
    for (part, row) in parts.iter().zip(members) {
        (0..DEPTHS).for_each(|depth| mean[depth] += part * weight(row[depth]));
    }
    mean
}

/// A group's probability over the depths.
#[inline(always)]
fn by_depth(block: &[Row]) -> Row {
    let mut depths = [0.0; DEPTHS];
    for row in block {
        (0..DEPTHS).for_each(|depth| depths[depth] += row[depth]);
    }
    depths
}

/// Numbers by depth.
fn rows(values: &[f32]) -> &[Row] {
    values.as_chunks().0
}

/// The sum of many numbers, eight sums at a time.
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

/// Probabilities over the highest one, of 5 bits of exponent and 11 of fraction: to a part in 4000, down to
/// 2⁻³¹.
#[derive(Debug, Clone, PartialEq)]
struct Packed(Vec<u16>);

/// Bits of a single-precision fraction that are dropped, and the exponent below which nothing is kept.
const DROPPED_BITS: u32 = 12;
const MIN_EXPONENT: u32 = (127 - 31) << 23;

impl Packed {
    fn of(values: &[f32]) -> Self {
        let (eights, rest) = values.as_chunks::<8>();
        let mut highest = [f32::MIN_POSITIVE; 8];
        for eight in eights {
            highest.iter_mut().zip(eight).for_each(|(highest, value)| *highest = highest.max(*value));
        }
        let highest = highest.iter().chain(rest).copied().fold(f32::MIN_POSITIVE, f32::max);
        let scale = 1.0 / highest;
        let packed = |value: &f32| {
            let bits = (value * scale).to_bits().saturating_add(1 << (DROPPED_BITS - 1));
            (bits.saturating_sub(MIN_EXPONENT) >> DROPPED_BITS).min(u32::from(u16::MAX)) as u16
        };
        Self(values.iter().map(packed).collect())
    }

    fn unpacked(&self) -> Vec<f32> {
        let value = |packed: &u16| match packed {
            0 => 0.0,
            packed => f32::from_bits((u32::from(*packed) << DROPPED_BITS) + MIN_EXPONENT),
        };
        self.0.iter().map(value).collect()
    }
}

/// In text: cells in little-endian order, a run of zeros as a zero and its length, in Base64.
impl Serialize for Packed {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = Vec::with_capacity(self.0.len());
        let mut cells = self.0.iter().peekable();
        while let Some(cell) = cells.next() {
            bytes.extend_from_slice(&cell.to_le_bytes());
            if *cell == 0 {
                let mut run: u16 = 1;
                while run < u16::MAX && cells.next_if(|next| **next == 0).is_some() {
                    run += 1;
                }
                bytes.extend_from_slice(&run.to_le_bytes());
            }
        }
        serializer.serialize_str(&STANDARD_NO_PAD.encode(bytes))
    }
}

impl<'de> Deserialize<'de> for Packed {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let bytes = STANDARD_NO_PAD.decode(text).map_err(serde::de::Error::custom)?;
        let mut words = bytes.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]]));
        let mut cells = Vec::new();
        while let Some(cell) = words.next() {
            let run = if cell == 0 { words.next().unwrap_or(1) } else { 1 };
            cells.extend(std::iter::repeat_n(cell, run.into()));
        }
        Ok(Self(cells))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packing_keeps_a_part_in_four_thousand() {
        let values: Vec<f32> = (0..2000).map(|i| (-0.01 * i as f32).exp()).collect();
        let packed = Packed::of(&values);
        for (value, back) in values.iter().zip(packed.unpacked()) {
            assert!((value - back).abs() <= value / 4000.0 || *value < 1e-9, "{value} {back}");
        }
        // Once packed, the same again.
        assert_eq!(Packed::of(&packed.unpacked()), packed);
        let text = serde_json::to_string(&packed).unwrap();
        assert_eq!(serde_json::from_str::<Packed>(&text).unwrap(), packed);
    }

    #[test]
    fn no_wear_at_all_takes_its_part_of_what_is_believed() {
        let mut joint = vec![0.0; 3 * DEPTHS];
        joint[DEPTHS + 7] = 1.0;
        let mut by_rate = vec![0.0; BLOCK];
        by_rate[2 * DEPTHS + 7] = 1.0;
        let less = JointPosterior { joint, by_rate }.or_no_wear(0.25);
        let depths = less.by_depth();
        assert!((depths[0] - 0.25).abs() < 1e-6 && (depths[7] - 0.75).abs() < 1e-6);
        assert_eq!((less.by_rate[0], less.by_rate[2 * DEPTHS + 7]), (0.25, 0.75));
    }

    #[test]
    fn a_run_of_zeros_is_short() {
        let mut values = vec![0.0_f32; 200_000];
        values[100_000] = 1.0;
        let packed = Packed::of(&values);
        let text = serde_json::to_string(&packed).unwrap();
        assert!(text.len() < 60, "{}", text.len());
        assert_eq!(serde_json::from_str::<Packed>(&text).unwrap(), packed);
    }
}
