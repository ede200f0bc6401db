//! The physics of one spur gear pair with worn flanks, after Shen et al. 2022: worn geometry, the new mesh relationship,
//! mesh stiffness, unloaded static transmission error, and the 4-DOF dynamics that turn them into vibration.
//!
//! Gear 1 drives; X₁ is the tooth's centre line; φ₁ is the angle of X₁ above the line of centres. Knows nothing of signals.

mod pair;

pub use pair::{
    ContactRule, DynamicsSpec, ErrorSpec, GearError, GeometrySpec, MaterialSpec, OperationSpec, PairSpec, ResponseCoordinate, SupportSpec,
    WearShape, WearSpec,
};
