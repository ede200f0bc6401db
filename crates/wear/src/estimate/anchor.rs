//! What an inspection teaches of the members: how far each is wrong at the depth that was found.

use serde::{Deserialize, Serialize};

use crate::library::{DEPTHS, Ensemble, FlankPlace, Member};
use flankwatch_gear::ContactRule;

/// Depth over which what a member is wrong by at an inspection is forgotten, in parts of the greatest. Under
/// load the teeth that share it change with the depth; by the threshold rule contact changes little, and so
/// does what is wrong.
pub(super) const fn anchor_reach(contact: ContactRule) -> f32 {
    match contact {
        ContactRule::Loaded => 0.4,
        ContactRule::Threshold => 1.0,
    }
}

/// Depths and lines known from an inspection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Anchor {
    /// By member: the index of the depth that the inspection means.
    pub(super) depths: Vec<u8>,
    /// Mean change of each line at that time.
    pub(super) changes: Vec<Option<f32>>,
}

impl Anchor {
    /// What an inspection that found `depth_um` at a place means for each member.
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
