//! Distribution of the transmission error due to wear.

use super::wear::Interval;
use crate::library::{DEPTHS, Ensemble, LANES};

/// Number of bins. They are equally wide in the square root, so they are narrow where errors are small.
const BINS: usize = 2048;

/// The transmission errors of an ensemble in µm, sorted into bins.
#[derive(Debug)]
pub(super) struct TransmissionErrors {
    /// Bin by block of [`LANES`] groups of members, depth and group. The members of a group have the same
    /// wear, and so the same error.
    bins: Vec<u16>,
    bins_per_root: f32,
    greatest_um: f32,
}

impl TransmissionErrors {
    /// Sorts the errors of an ensemble's groups at all depths.
    pub(super) fn of(ensemble: &Ensemble) -> Self {
        let of_block = |block: usize| {
            let member = move |lane| &ensemble.members()[ensemble.member_in(block, lane)];
            (0..DEPTHS).flat_map(move |depth| {
                (0..LANES).map(move |lane| member(lane).transmission_error_um()[depth])
            })
        };
        let errors_um: Vec<f32> =
            (0..ensemble.blocks()).step_by(ensemble.variants()).flat_map(of_block).collect();
        let greatest_um = errors_um.iter().copied().fold(0.0, f32::max);
        let bins_per_root = (BINS - 1) as f32 / greatest_um.max(f32::MIN_POSITIVE).sqrt();
        let bin = |error_um: &f32| (error_um.max(0.0).sqrt() * bins_per_root) as u16;
        Self { bins: errors_um.iter().map(bin).collect(), bins_per_root, greatest_um }
    }

    /// Returns the median and the 90 % interval in µm, from the probability by block, depth and group.
    pub(super) fn interval_um(&self, joint: &[f32]) -> Option<Interval> {
        let mut by_bin = [0.0_f32; BINS];
        for (bin, p) in self.bins.iter().zip(joint) {
            by_bin[usize::from(*bin)] += p;
        }
        let total: f32 = by_bin.iter().sum();
        let quantile = |level: f32| {
            let mut left = level * total;
            let bin = by_bin.iter().position(|p| {
                left -= p;
                left <= 0.0
            })?;
            // `left` is now negative: minus the probability of the bin that lies above the quantile.
            let at = if bin == 0 { 0.0 } else { bin as f32 + 1.0 + left / by_bin[bin] };
            Some(f64::from((at / self.bins_per_root).powi(2).min(self.greatest_um)))
        };
        Some(Interval { median: quantile(0.5)?, p05: quantile(0.05)?, p95: quantile(0.95)? })
    }
}
