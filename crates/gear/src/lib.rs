//! The physics of one spur gear pair with worn flanks, after Shen et al. 2022: worn geometry, the new mesh
//! relationship, mesh stiffness, unloaded static transmission error, and the 4-DOF dynamics that turn them
//! into vibration.
//!
//! Four types carry the model, each made from the one before:
//!
//! - [`PairSpec`]: a gear pair as described in its file (TOML);
//! - [`GearPair`]: the same pair with validated numbers and computed geometry;
//! - [`FlankWear`]: the wear depth over the flanks of both gears, in mm;
//! - [`MeshCycle`]: stiffness in N/m and transmission error in rad over one mesh period.
//!
//! [`simulate`] turns a mesh cycle into vibration, in m/s².
//!
//! ```
//! use flankwatch_gear::{FlankWear, MeshCycle, PairSpec, RunSettings, simulate};
//!
//! let spec = PairSpec::from_toml(
//!     "
//!     [geometry]
//!     teeth = [24, 26]              # driving, driven
//!     module_mm = 6.0
//!     face_width_mm = 50.0
//!     bore_radius_mm = [20.0, 20.0]
//!     centre_distance_mm = 150.0
//!
//!     [operation]
//!     torque_nm = 1300.0
//!     shaft_speed_hz = 16.64
//! ",
//! )?;
//! let pair = spec.resolve()?;
//!
//! // Worn by 0.1 mm at the deepest place, in the shape that the pair file describes.
//! let worn = FlankWear::from_shape(&pair, 0.1)?;
//! let unworn = MeshCycle::compute(&pair, &FlankWear::none(), 200)?;
//! let cycle = MeshCycle::compute(&pair, &worn, 200)?;
//! assert!(cycle.mean_stiffness_n_per_m() < unworn.mean_stiffness_n_per_m());
//!
//! // A tenth of a second at 20 kHz.
//! let acceleration = simulate(&pair, &cycle, &RunSettings::nominal(&pair, 20_000.0, 0.1))?;
//! assert_eq!(acceleration.len(), 2000);
//! # Ok::<(), flankwatch_gear::GearError>(())
//! ```
//!
//! Gear 1 drives; X₁ is the tooth's centre line; φ₁ is the angle of X₁ above the line of centres. The model
//! follows Z. Shen, L. Yang, B. Qiao, W. Luo, X. Chen and R. Yan, *Mesh relationship modeling and dynamic
//! characteristic analysis of external spur gears with gear wear*, Frontiers of Mechanical Engineering
//! 17, 2022.
//!
//! # Features
//! - `openapi`: implements `utoipa::ToSchema` for the pair file.

#[cfg(test)]
mod accuracy;
#[cfg(test)]
mod any_pair;
mod archard;
mod assessment;
#[cfg(test)]
mod bad_pairs;
mod band_matrix;
mod body_compliance;
mod contact_band;
mod contact_load;
mod decimator;
mod description;
mod dynamics;
mod error;
mod excitation;
mod feasibility;
mod flank;
mod flank_wear;
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
mod passage;
mod plane_elasticity;
#[cfg(test)]
mod reference;
mod refusals;
mod relationship;
mod response;
mod ring_sector;
mod root;
mod run_settings;
mod sector_mesh;
mod similarity;
mod stiff_step;
mod stiffness;
#[cfg(test)]
mod testing;
mod tooth;
mod tooth_outline;
mod tooth_touch;
mod transmission_error;
#[cfg(test)]
mod trends;
mod wear_shape;
mod wear_table;

pub use archard::ArchardWear;
pub use assessment::{Assessment, GeometryMeasure, MeasuredQuantity, Verdict};
pub use description::{DescriptionError, from_toml};
pub use error::GearError;
pub use flank::{Flank, FlankPoint};
pub use flank_wear::FlankWear;
pub use geometry::{Gear, GearPair};
pub use load_sharing::ElasticBodies;
pub use mesh_cycle::MeshCycle;
pub use pair::{
    ContactRule, DynamicsSpec, ErrorSpec, GeometrySpec, MaterialSpec, OperationSpec, PairSpec, PlaneState,
    ResponseCoordinate, SupportSpec, WearPoint, WearShape, WearSpec,
};
pub use relationship::MeshRelationship;
pub use response::{simulate, simulate_together};
pub use run_settings::RunSettings;
pub use similarity::{Errors, Supports};
pub use stiffness::PairStiffness;

/// Version of the model: it changes when any number that the model gives for the same input changes.
pub const MODEL_VERSION: &str = "2";
