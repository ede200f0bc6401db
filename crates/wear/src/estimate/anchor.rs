//! What an inspection shows of the ensemble's members: each one's error at the depth that was measured.

use serde::{Deserialize, Serialize};

use crate::library::{DEPTHS, Ensemble, FlankPlace, Member};
use flankwatch_gear::ContactRule;

/// Correlation length over depth of a member's error, in parts of the library's end. Under load, the teeth
/// that share it change with the depth; by the threshold rule, contact changes little, and so does the error.
pub(super) const fn anchor_reach(contact: ContactRule) -> f32 {
    match contact {
        ContactRule::Loaded => 0.4,
        ContactRule::Threshold => 1.0,
    }
}

/// Depths and line changes at the last inspection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Anchor {
    /// By member: index of the depth that corresponds to the measurement.
    pub(super) depths: Vec<u8>,
    /// Mean change of each line at that time; `None` for lines not seen.
    pub(super) changes: Vec<Option<f32>>,
}

impl Anchor {
    /// Returns for each member the index of the depth at which its flank has `depth_um` at a place.
    pub(super) fn depths_at(
        ensemble: &Ensemble,
        depth_um: f64,
        gear: Option<usize>,
        place: FlankPlace,
    ) -> Vec<u8> {
        let nearest = |member: &Member| {
            let parts = member.at_place(gear, place);
            let off =
                |depth: &usize| (ensemble.depths_um()[*depth] * f64::from(parts[*depth]) - depth_um).abs();
            (0..DEPTHS).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0) as u8
        };
        ensemble.members().iter().map(nearest).collect()
    }
}
