//! What is known of a mesh before its records are analysed.

use super::other_meshes::OtherMeshes;

/// The known data of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshContext {
    /// Teeth on the reference shaft, whose speed is given (the driving gear, the pinion); 0 without a mesh.
    pub teeth: u32,
    /// Teeth of the mating gear; 0 if unknown.
    pub mate_teeth: u32,
    /// Nominal rotational frequency of the reference shaft in hertz.
    pub nominal_shaft_speed_hz: f64,
    /// Largest relative deviation of the speed from nominal (0.05 for ± 5 %).
    pub tolerance: f64,
    /// Whether the nominal speed is exact, so no search is needed.
    pub nominal_is_exact: bool,
    /// Other meshes that the sensor measures.
    pub others: OtherMeshes,
}

impl MeshContext {
    /// Creates the context of a mesh with these teeth, reference shaft first (0 if unknown), whose speed
    /// differs from nominal by at most the fraction `tolerance`.
    pub const fn new(teeth: [u32; 2], nominal_shaft_speed_hz: f64, tolerance: f64) -> Self {
        Self {
            teeth: teeth[0],
            mate_teeth: teeth[1],
            nominal_shaft_speed_hz,
            tolerance,
            nominal_is_exact: false,
            others: OtherMeshes::NONE,
        }
    }

    /// Creates the context of a mesh at an exactly known speed.
    pub const fn at_exact_speed(teeth: [u32; 2], shaft_speed_hz: f64) -> Self {
        Self { nominal_is_exact: true, ..Self::new(teeth, shaft_speed_hz, 0.0) }
    }

    /// Returns the context of an unknown mesh: indicators that need it are omitted.
    pub const fn unknown() -> Self {
        Self::new([0, 0], 0.0, 0.0)
    }
}
