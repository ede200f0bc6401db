//! The physics of one spur gear pair with worn flanks, after Shen et al. 2022: worn geometry, the new mesh relationship,
//! mesh stiffness, unloaded static transmission error, and the 4-DOF dynamics that turn them into vibration.
//!
//! Gear 1 drives; X₁ is the tooth's centre line; φ₁ is the angle of X₁ above the line of centres. Knows nothing of signals.
//!
//! The way through: a [`PairSpec`] (pair file) resolves to a [`GearPair`] (checked geometry); a [`FlankWear`] says what its flanks have
//! lost; [`MeshCycle::compute`] works out one mesh period; [`simulate`] turns it into vibration.

#[cfg(test)]
mod accuracy;
#[cfg(test)]
mod any_pair;
mod archard;
#[cfg(test)]
mod bad_pairs;
mod band_matrix;
mod body_compliance;
mod contact_band;
mod contact_load;
mod decimator;
mod dynamics;
mod error;
mod excitation;
mod flank;
mod geometry;
mod limits;
mod line_contact;
mod load_sharing;
mod loaded_cycle;
mod mesh_cycle;
#[cfg(test)]
mod mirrored;
mod pair;
mod pair_curve;
mod plane_elasticity;
#[cfg(test)]
mod reference;
mod relationship;
mod response;
mod ring_sector;
mod root;
mod run_settings;
mod sector_mesh;
mod stiffness;
#[cfg(test)]
mod testing;
mod tooth;
mod tooth_outline;
mod tooth_touch;
mod transmission_error;
#[cfg(test)]
mod trends;
mod wear;
mod wear_table;

pub use archard::ArchardWear;
pub use error::GearError;
pub use flank::{Flank, FlankPoint};
pub use geometry::{Gear, GearPair};
pub use load_sharing::ElasticBodies;
pub use mesh_cycle::MeshCycle;
pub use pair::{
    ContactRule, DynamicsSpec, ErrorSpec, GeometrySpec, MaterialSpec, OperationSpec, PairSpec, PlaneState, ResponseCoordinate, SupportSpec,
    WearPoint, WearShape, WearSpec,
};
pub use relationship::MeshRelationship;
pub use response::{simulate, simulate_together};
pub use run_settings::RunSettings;
pub use stiffness::PairStiffness;
pub use wear::FlankWear;

/// Version of the model: it changes when any number that the model gives for the same input changes.
pub const MODEL_VERSION: &str = "2";
