//! The posterior after a record, jointly over groups of members and depth.

use super::groups::{by_lane, depths_of, lanes_in, normalise, sum};
use crate::library::{DEPTHS, LANES, REPORTED};

/// The posterior after a record.
pub(super) struct JointPosterior {
    /// Number of groups.
    pub(super) groups: usize,
    /// By block of groups, depth and group; the sum is 1.
    pub(super) joint: Vec<f32>,
    /// Probability that wear does not grow.
    pub(super) standstill: f32,
}

impl JointPosterior {
    /// Mixes in depths by their probability, without growth, with a weight.
    pub(super) fn or_depths(mut self, by_depth: &[f32], weight: f32) -> Self {
        self.joint.iter_mut().for_each(|p| *p *= 1.0 - weight);
        let each = weight / self.groups as f32;
        for (block, rows) in depths_of(&mut self.joint).iter_mut().enumerate() {
            for (row, depth) in rows.iter_mut().zip(by_depth) {
                row[..lanes_in(self.groups, block)].iter_mut().for_each(|p| *p += each * depth);
            }
        }
        self.standstill = weight + (1.0 - weight) * self.standstill;
        self
    }

    /// Rescales the groups of members to given probabilities.
    pub(super) fn with_groups(mut self, groups: &[f32]) -> Self {
        for (rows, groups) in depths_of(&mut self.joint).iter_mut().zip(groups.chunks(LANES)) {
            let totals = by_lane(rows);
            for row in rows {
                for ((p, total), group) in row.iter_mut().zip(totals).zip(groups) {
                    *p *= group / total.max(f32::MIN_POSITIVE);
                }
            }
        }
        normalise(&mut self.joint);
        self
    }

    /// Returns the probability by reported depth. The last one has that of all greater depths too.
    pub(super) fn by_depth(&self) -> Vec<f64> {
        let mut total = vec![0.0; DEPTHS];
        for (index, row) in self.joint.as_chunks::<LANES>().0.iter().enumerate() {
            total[index % DEPTHS] += f64::from(sum(row));
        }
        let beyond: f64 = total.drain(REPORTED..).sum();
        total[REPORTED - 1] += beyond;
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_reported_depth_has_the_probability_of_all_greater_ones() {
        let mut joint = [[0.0; LANES]; DEPTHS];
        (joint[3][0], joint[REPORTED - 1][0], joint[DEPTHS - 1][1]) = (0.5, 0.125, 0.375);
        let joint = joint.as_flattened().to_vec();
        let depths = JointPosterior { groups: 2, joint, standstill: 0.0 }.by_depth();
        assert_eq!((depths.len(), depths[3], depths[REPORTED - 1]), (REPORTED, 0.5, 0.5));
    }

    #[test]
    fn no_wear_is_mixed_into_the_posterior() {
        let mut joint = [[0.0; LANES]; DEPTHS];
        joint[7][1] = 1.0;
        let joint = joint.as_flattened().to_vec();
        let mixed = JointPosterior { groups: 3, joint, standstill: 0.2 }.or_depths(&[0.5, 0.5], 0.5);
        assert!((sum(&mixed.joint) - 1.0).abs() < 1e-6);
        let depths = mixed.by_depth();
        assert!((depths[0] - 0.25).abs() < 1e-6 && (depths[1] - 0.25).abs() < 1e-6);
        assert!((depths[7] - 0.5).abs() < 1e-6);
        assert!((mixed.standstill - 0.6).abs() < 1e-6);
    }
}
