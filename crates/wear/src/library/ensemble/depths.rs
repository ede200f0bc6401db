//! The wear depths at which members are simulated.

/// Number of wear depths that estimates report: from 0 to the library's last one.
pub const REPORTED: usize = 50;

/// Number of wear depths of a member: those that are reported, and some beyond the library's end. Without the
/// latter, the probability of deeper wear would pile up at the end.
pub const DEPTHS: usize = REPORTED + 4;

/// Returns the library's end in µm, the last reported one of the depths; 0 without depths.
pub(crate) fn end_um(depths_um: &[f64]) -> f64 {
    depths_um.get(REPORTED - 1).copied().unwrap_or(0.0)
}

/// Depths in µm from 0 to the library's end and beyond, closer together where wear is small and the lines
/// change fast.
pub(super) fn depths_um(end_um: f64) -> Vec<f64> {
    let part = |index: usize| index as f64 / (REPORTED - 1) as f64;
    (0..DEPTHS).map(|index| end_um * part(index) * (0.25 + 0.75 * part(index))).collect()
}
