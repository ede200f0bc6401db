//! Default bores, supports, errors and wear of a pair: about those of the paper's pair, scaled to the size of
//! the described one.
//!
//! The stiffness of teeth of one shape and material is proportional to their width, whatever their module,
//! and a disc's mass to its volume. With supports in proportion to the teeth, and errors and wear in
//! proportion to the module, a pair vibrates like the paper's, only faster or slower.

use super::{GeometrySpec, PairSpec};

/// The paper's pair: module, face width and smaller reference radius in mm, Young's modulus in Pa, density in
/// kg/m³.
const MODULE_MM: f64 = 6.0;
const FACE_WIDTH_MM: f64 = 50.0;
const SMALLER_RADIUS_MM: f64 = 72.0;
const YOUNGS_MODULUS_PA: f64 = 2.05e11;
const DENSITY_KG_PER_M3: f64 = 7850.0;

/// Its supports (Section 3.1), errors (Eq. (26)), and the last of its 50 wear states (Figs. 19 to 22).
const SUPPORT_STIFFNESS_N_PER_M: f64 = 6.56e7;
const SUPPORT_DAMPING_N_S_PER_M: f64 = 1.8e5;
const LONG_PERIOD_UM: f64 = 30.0;
const SHORT_PERIOD_UM: f64 = 15.0;
const RANDOM_UM: f64 = 0.2;
const DEEPEST_UM: f64 = 245.0;

/// Ratio of root to bore radius of a gear whose bore is not given; the paper's pair has 3.2 and 3.5.
const USUAL_ROOT_TO_BORE: f64 = 3.0;

/// Supports (bearings) of each gear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supports {
    /// Stiffness k₁ = k₂ in N/m.
    pub stiffness_n_per_m: f64,
    /// Damping c₁ = c₂ in N·s/m.
    pub damping_n_s_per_m: f64,
}

/// Manufacturing errors, Eq. (26).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    /// Amplitude A₁ of the once-per-turn error in µm.
    pub long_period_um: f64,
    /// Amplitude A₂ of the once-per-tooth error in µm.
    pub short_period_um: f64,
    /// Phase of the once-per-tooth error in mesh periods, from the nominal start of contact on.
    pub short_period_phase: f64,
    /// Range of the random error in µm.
    pub random_um: f64,
    /// Clock rate of the random error in hertz.
    pub random_clock_hz: f64,
    /// Seed of the random error.
    pub seed: u64,
}

impl GeometrySpec {
    /// Returns the root radius of each gear in mm.
    pub fn root_radius_mm(&self) -> [f64; 2] {
        [0, 1].map(|i| {
            self.module_mm * (f64::from(self.teeth[i]) / 2.0 - self.dedendum[i] + self.profile_shift[i])
        })
    }

    /// Returns the described bore radius of each gear in mm; by default a third of the root radius.
    pub fn bore_radius_mm(&self) -> [f64; 2] {
        self.bore_radius_mm.unwrap_or(self.root_radius_mm().map(|root| root / USUAL_ROOT_TO_BORE))
    }
}

impl PairSpec {
    /// Returns the described supports; by default they have the paper's ratio of stiffness to the teeth, and
    /// its damping.
    pub fn supports(&self) -> Supports {
        let usual = self.usual_supports();
        Supports {
            stiffness_n_per_m: self.supports.stiffness_n_per_m.unwrap_or(usual.stiffness_n_per_m),
            damping_n_s_per_m: self.supports.damping_n_s_per_m.unwrap_or(usual.damping_n_s_per_m),
        }
    }

    /// Returns the default supports: the paper's ratio of stiffness to the teeth, and its damping for the
    /// smaller gear.
    pub fn usual_supports(&self) -> Supports {
        let (basic, material) = (&self.geometry, &self.material);
        let width = basic.face_width_mm / FACE_WIDTH_MM;
        let [first, second] = basic.teeth;
        let radius = basic.module_mm * f64::from(first.min(second)) / 2.0 / SMALLER_RADIUS_MM;
        let stiffness = material.youngs_modulus_pa / YOUNGS_MODULUS_PA * width;
        let mass = material.density_kg_per_m3 / DENSITY_KG_PER_M3 * width * radius * radius;
        Supports {
            stiffness_n_per_m: SUPPORT_STIFFNESS_N_PER_M * stiffness,
            damping_n_s_per_m: SUPPORT_DAMPING_N_S_PER_M * (stiffness * mass).sqrt(),
        }
    }

    /// Returns the described errors; by default the paper's in proportion to the module.
    pub fn errors(&self) -> Errors {
        let usual = self.usual_errors();
        Errors {
            long_period_um: self.errors.long_period_um.unwrap_or(usual.long_period_um),
            short_period_um: self.errors.short_period_um.unwrap_or(usual.short_period_um),
            random_um: self.errors.random_um.unwrap_or(usual.random_um),
            ..usual
        }
    }

    /// Returns the default errors: the paper's in proportion to the module.
    pub fn usual_errors(&self) -> Errors {
        let size = self.size();
        Errors {
            long_period_um: LONG_PERIOD_UM * size,
            short_period_um: SHORT_PERIOD_UM * size,
            short_period_phase: self.errors.short_period_phase,
            random_um: RANDOM_UM * size,
            random_clock_hz: self.errors.random_clock_hz,
            seed: self.errors.seed,
        }
    }

    /// Returns the default greatest wear in µm: 245 µm at module 6 mm, in proportion to the module.
    pub fn usual_wear_um(&self) -> f64 {
        DEEPEST_UM * self.size()
    }

    /// Returns the ratio of the module to the paper's, 6 mm.
    pub fn size(&self) -> f64 {
        self.geometry.module_mm / MODULE_MM
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::shen2022_spec;
    use crate::{ErrorSpec, PairSpec, SupportSpec};

    #[test]
    fn the_bore_is_a_third_of_the_root_radius_where_it_is_not_given() {
        let file = "geometry = { teeth = [20, 40], module_mm = 2.0, face_width_mm = 8.0 }\n\
                    operation = { torque_nm = 5.0, shaft_speed_hz = 25.0 }";
        let spec: PairSpec = toml::from_str(file).unwrap();
        let gears = spec.resolve().unwrap().gears;
        for (gear, expected) in gears.iter().zip([17.5 / 3.0, 37.5 / 3.0]) {
            assert!((gear.bore_radius_mm - expected).abs() < 1e-12, "{}", gear.bore_radius_mm);
        }
        assert!(!toml::to_string(&spec).unwrap().contains("bore"));
    }

    #[test]
    fn defaults_of_the_papers_pair_are_its_own_values() {
        let given = shen2022_spec();
        let mut silent = given.clone();
        (silent.supports, silent.errors) = (SupportSpec::default(), ErrorSpec::default());
        assert_eq!((silent.supports(), silent.errors()), (given.supports(), given.errors()));
        assert_eq!(silent.usual_wear_um(), 245.0);
    }

    /// A sixth as large in every direction: stiffness goes with the length, mass with its cube, damping with
    /// its square.
    #[test]
    fn a_smaller_pair_has_supports_and_errors_of_its_size() {
        let mut spec = shen2022_spec();
        (spec.supports, spec.errors) = (SupportSpec::default(), ErrorSpec::default());
        (spec.geometry.module_mm, spec.geometry.face_width_mm) = (1.0, 50.0 / 6.0);
        let (supports, errors) = (spec.supports(), spec.errors());
        assert!((supports.stiffness_n_per_m / 6.56e7 * 6.0 - 1.0).abs() < 1e-12);
        assert!((supports.damping_n_s_per_m / 1.8e5 * 36.0 - 1.0).abs() < 1e-12);
        assert!((errors.long_period_um - 5.0).abs() < 1e-12 && (errors.short_period_um - 2.5).abs() < 1e-12);
        spec.material.youngs_modulus_pa /= 100.0;
        assert!((spec.supports().stiffness_n_per_m / supports.stiffness_n_per_m * 100.0 - 1.0).abs() < 1e-12);
        spec.supports.damping_n_s_per_m = Some(7.0);
        assert_eq!(spec.supports().damping_n_s_per_m, 7.0);
    }
}
