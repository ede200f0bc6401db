//! A gear pair as described in a pair file.

use super::GearError;
use super::description::from_toml;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A gear pair: the basic data of the paper's Table 1 and the numbers of its dynamic model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct PairSpec {
    /// Display name.
    #[serde(default)]
    pub name: String,
    /// Basic data of the two gears.
    pub geometry: GeometrySpec,
    /// Material of both gears.
    #[serde(default)]
    pub material: MaterialSpec,
    /// Load and speed.
    pub operation: OperationSpec,
    /// Supports (bearings).
    #[serde(default)]
    pub supports: SupportSpec,
    /// Parameters of the dynamic model.
    #[serde(default)]
    pub dynamics: DynamicsSpec,
    /// Manufacturing errors, Eq. (26).
    #[serde(default)]
    pub errors: ErrorSpec,
    /// Shape of the wear over the flank.
    #[serde(default)]
    pub wear: WearSpec,
}

/// Basic data of the two gears; arrays are `[driving, driven]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct GeometrySpec {
    /// Tooth counts z₁, z₂.
    pub teeth: [u32; 2],
    /// Module in mm.
    pub module_mm: f64,
    /// Face width in mm.
    pub face_width_mm: f64,
    /// Pressure angle α₀ of the basic rack in degrees.
    #[serde(default = "defaults::pressure_angle_deg")]
    pub pressure_angle_deg: f64,
    /// Addendum of each gear in modules.
    #[serde(default = "defaults::addendum")]
    pub addendum: [f64; 2],
    /// Dedendum of each gear in modules.
    #[serde(default = "defaults::dedendum")]
    pub dedendum: [f64; 2],
    /// Bore radius of each gear in mm; by default a third of the root radius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bore_radius_mm: Option<[f64; 2]>,
    /// Profile shift of each gear in modules.
    #[serde(default)]
    pub profile_shift: [f64; 2],
    /// Operating centre distance in mm; by default that of zero backlash for the profile shifts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub centre_distance_mm: Option<f64>,
}

/// Material of both gears.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct MaterialSpec {
    /// Young's modulus in Pa.
    pub youngs_modulus_pa: f64,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
    /// Density in kg/m³.
    pub density_kg_per_m3: f64,
}

/// Load and speed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct OperationSpec {
    /// Torque T₁ on the driving gear in N·m.
    pub torque_nm: f64,
    /// Torque T₂ on the driven gear in N·m; by default the balancing one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output_torque_nm: Option<f64>,
    /// Rotational frequency f₁ of the driving gear in hertz.
    pub shaft_speed_hz: f64,
}

/// Supports (bearings) of each gear.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SupportSpec {
    /// Stiffness k₁ = k₂ in N/m; by default that of the paper's pair, 6.56e7, in proportion to Young's
    /// modulus and the face width.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_n_per_m: Option<f64>,
    /// Damping c₁ = c₂ in N·s/m; by default that of the paper's pair, 1.8e5, in proportion to the square root
    /// of the default stiffness times the smaller gear's mass.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping_n_s_per_m: Option<f64>,
}

/// Coordinate measured by the simulated sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ResponseCoordinate {
    /// Acceleration ÿ₁ of gear 1 at its bearings along the line of action.
    Bearing1,
    /// Acceleration ÿ₂ of gear 2 at its bearings along the line of action.
    Bearing2,
    /// Relative acceleration R_b1 θ̈₁ − R_b2 θ̈₂ − ÿ₁ + ÿ₂ of the gears along the line of action: ẍ_m without
    /// the error's own ë.
    Mesh,
}

/// Rule that selects the pairs of teeth that carry the load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ContactRule {
    /// The paper's rule: the pair with the larger φ₂, and any pair within the threshold of it.
    Threshold,
    /// Elastic load sharing: pairs carry the load that results from closing their gaps, including tip edges.
    Loaded,
}

/// Plane state for the deformation of the gears, according to their width.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum PlaneState {
    /// Plane strain for wide gears: no strain along the axis.
    #[default]
    Strain,
    /// Plane stress for narrow gears: no stress along the axis.
    Stress,
}

impl fmt::Display for ContactRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Threshold => "threshold",
            Self::Loaded => "loaded",
        })
    }
}

impl FromStr for ContactRule {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "threshold" => Ok(Self::Threshold),
            "loaded" => Ok(Self::Loaded),
            _ => Err(format!("{name:?} is not a contact rule, expected threshold or loaded")),
        }
    }
}

/// Parameters of the dynamic model that the paper leaves open.
///
/// The default contact rule is elastic load sharing: it agrees with finite elements within 3 % where the
/// paper's rule is off by 30 %, and a library made with it fits runs made with the paper's rule far better
/// than the other way round (`docs/estimation.md`).
///
/// The mesh damping is c = 2ζ√(k̄ m_e), with k̄ the mean of k(t) over a mesh period and 1/m_e = R_b1²/I₁ +
/// R_b2²/I₂.
///
/// The default ζ = 0.5 was chosen together with those of [`WearSpec`]. In the paper's Fig. 22 RMS, kurtosis
/// and first mesh amplitude all increase with wear, but the paper gives none of these parameters. Of about a
/// thousand combinations this one is closest, with Spearman coefficients of 0.90, 0.88 and 1.00 over the 50
/// wear states. In no combination does RMS increase throughout: here it falls between 30 and 80 µm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DynamicsSpec {
    /// Mesh damping ratio ζ.
    pub mesh_damping_ratio: f64,
    /// Coordinate of the response.
    pub response: ResponseCoordinate,
    /// Rule that selects the pairs of teeth that carry the load.
    pub contact: ContactRule,
    /// Threshold of the contact rule in rad.
    pub contact_threshold_rad: f64,
    /// Plane state used for loaded contact.
    pub plane: PlaneState,
    /// Masses m₁, m₂ in kg; by default those of solid discs of the reference pitch radius and the face width,
    /// the bore filled by its shaft.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<[f64; 2]>,
    /// Moments of inertia I₁, I₂ in kg·m²; by default those of the same discs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inertia_kg_m2: Option<[f64; 2]>,
}

/// Manufacturing errors, Eq. (26).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ErrorSpec {
    /// Amplitude A₁ of the once-per-turn error in µm; by default 5 µm per mm of module.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub long_period_um: Option<f64>,
    /// Amplitude A₂ of the once-per-tooth error in µm; by default 2.5 µm per mm of module.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub short_period_um: Option<f64>,
    /// Phase of the once-per-tooth error in mesh periods, from the nominal start of contact on.
    #[serde(skip_serializing_if = "is_zero")]
    pub short_period_phase: f64,
    /// Range of the random error in µm; by default 1/30 µm per mm of module.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub random_um: Option<f64>,
    /// Clock rate of the random error in hertz.
    pub random_clock_hz: f64,
    /// Seed of the random error.
    pub seed: u64,
}

/// Shape of the wear over the flank.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum WearShape {
    /// Smallest at the pitch point, increasing to root and tip by a power law.
    Parabolic,
    /// The same depth along Y over the whole flank.
    Floor,
    /// The depths of [`WearSpec::table`], scaled so that the largest is h_max.
    Table,
    /// Wear by Archard's law on both flanks under the pair's own torque until the largest depth is h_max, Eq.
    /// (22).
    Archard,
}

/// One line of a wear table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct WearPoint {
    /// 1 for the driving gear, 2 for the driven.
    pub gear: u32,
    /// Radius of the unworn flank point in mm.
    pub radius_mm: f64,
    /// Wear depth along Y in µm.
    pub depth_um: f64,
}

/// Wear over the flank of both gears, measured along Y. Parabolic: with s the radius of the unworn flank
/// point, r_p the pitch radius, r_SAP the start of active profile and r_a the tip, the root side has h =
/// h_max·[f + (1−f)·((r_p−s)/(r_p−r_SAP))^p], held at its r_SAP value below, the tip side h = h_max·[f +
/// (t−f)·((s−r_p)/(r_a−r_p))^p].
///
/// The defaults f = 0.05, t = 0.7, p = 4 give almost no wear at the pitch point and most of it towards root
/// and tip, as in Fig. 6. They were chosen for the trends of the indicators, together with the damping of
/// [`DynamicsSpec`].
///
/// For the shape `archard` K and H determine how many turns a depth takes; the shape itself depends only on
/// the ratio of the two hardnesses. H = 7 GPa is 60 HRC (700 HV), that of a carburised surface of the
/// case-hardening steel 16MnCr5 (57 to 64 HRC depending on the tempering). That Archard's law describes the
/// mild wear of gears is A. Flodin's finding on an FZG rig (Wear of spur and helical gears, KTH Stockholm,
/// 2000). K = 1.7e-7 is a value for lubricated steel on steel that was not measured on gears; K ranges from
/// 1e-2 for severe dry wear to below 1e-6 for mild lubricated wear. With the default the typical pair loses
/// 25 µm in 4.7 million turns. Turns are proportional to 1/K: if they matter, measure it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct WearSpec {
    /// The shape.
    pub shape: WearShape,
    /// f: wear at the pitch point relative to the largest.
    pub floor: f64,
    /// t: wear at the tip relative to that at the root.
    pub tip_ratio: f64,
    /// p: exponent, above 1 so that the slope is continuous at the pitch point.
    pub exponent: f64,
    /// K: dimensionless wear coefficient of the shape `archard`.
    pub coefficient: f64,
    /// H: indentation hardness of the driving and the driven flanks in Pa, for the shape `archard`.
    pub hardness_pa: [f64; 2],
    /// m: exponent of the contact pressure for the shape `archard`, dh/ds ∝ (p/p₀)^m with p₀ = 1 GPa. 1 is
    /// Archard's law; experiments scatter around it.
    #[serde(skip_serializing_if = "is_one")]
    pub pressure_exponent: f64,
    /// Whether this shape was measured on the machine's own gears, so that the wear estimate does not need to
    /// vary it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub measured: bool,
    /// Depths over the radius of the unworn flank, for the shape `table`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub table: Vec<WearPoint>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

mod defaults {
    pub(super) fn pressure_angle_deg() -> f64 {
        20.0
    }

    pub(super) fn addendum() -> [f64; 2] {
        [1.0, 1.0]
    }

    pub(super) fn dedendum() -> [f64; 2] {
        [1.25, 1.25]
    }
}

impl Default for MaterialSpec {
    fn default() -> Self {
        Self { youngs_modulus_pa: 2.05e11, poisson_ratio: 0.3, density_kg_per_m3: 7850.0 }
    }
}

impl Default for DynamicsSpec {
    fn default() -> Self {
        Self {
            mesh_damping_ratio: 0.5,
            response: ResponseCoordinate::Bearing1,
            contact: ContactRule::Loaded,
            contact_threshold_rad: 1e-4,
            plane: PlaneState::Strain,
            mass_kg: None,
            inertia_kg_m2: None,
        }
    }
}

impl Default for ErrorSpec {
    fn default() -> Self {
        Self {
            long_period_um: None,
            short_period_um: None,
            short_period_phase: 0.0,
            random_um: None,
            random_clock_hz: 20_000.0,
            seed: 1,
        }
    }
}

/// Archard's own exponent is not serialised.
fn is_one(exponent: &f64) -> bool {
    *exponent == 1.0
}

impl Default for WearSpec {
    fn default() -> Self {
        Self {
            shape: WearShape::Parabolic,
            floor: 0.05,
            tip_ratio: 0.7,
            exponent: 4.0,
            coefficient: 1.7e-7,
            hardness_pa: [7e9, 7e9],
            pressure_exponent: 1.0,
            measured: false,
            table: Vec::new(),
        }
    }
}

impl PairSpec {
    /// Reads a pair file.
    ///
    /// # Errors
    /// [`GearError::Toml`] for anything but TOML with these fields; numbers are validated by
    /// [`PairSpec::resolve`].
    pub fn from_toml(text: &str) -> Result<Self, GearError> {
        Ok(from_toml(text)?)
    }

    /// Returns the pair with the torques of both gears multiplied by `factor`.
    #[must_use]
    pub fn with_torque(&self, factor: f64) -> Self {
        let mut pair = self.clone();
        pair.operation.torque_nm *= factor;
        pair.operation.output_torque_nm = pair.operation.output_torque_nm.map(|output| output * factor);
        pair
    }
}
