//! A gear pair as the user describes it in a pair file.

use super::{GearError, GearPair};
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A gear pair: the basic data of the paper's Table 1 and the numbers of its dynamic model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct PairSpec {
    /// Name for people.
    #[serde(default)]
    pub name: String,
    /// Basic data of the two gears.
    pub geometry: GeometrySpec,
    /// What they are made of.
    #[serde(default)]
    pub material: MaterialSpec,
    /// Load and speed.
    pub operation: OperationSpec,
    /// The bearings.
    #[serde(default)]
    pub supports: SupportSpec,
    /// Numbers of the dynamic model.
    #[serde(default)]
    pub dynamics: DynamicsSpec,
    /// Manufacturing errors, Eq. (26).
    #[serde(default)]
    pub errors: ErrorSpec,
    /// Shape of the wear over the flank.
    #[serde(default)]
    pub wear: WearSpec,
}

/// Basic data of the two gears; `[driving, driven]` where there are two.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct GeometrySpec {
    /// Tooth numbers z₁, z₂.
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
    /// Bore radius of each gear in mm.
    pub bore_radius_mm: [f64; 2],
    /// Profile shift of each gear in modules.
    #[serde(default)]
    pub profile_shift: [f64; 2],
    /// Operating centre distance in mm; that of zero backlash for the profile shifts where not given.
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
    /// Torque T₂ on the driven gear in N·m; the balancing one where not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output_torque_nm: Option<f64>,
    /// Rotational frequency f₁ of the driving gear in hertz.
    pub shaft_speed_hz: f64,
}

/// The bearings of each gear.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SupportSpec {
    /// Stiffness k₁ = k₂ in N/m; where not given that of the paper's pair, 6.56e7, in proportion to Young's
    /// modulus and the face width.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_n_per_m: Option<f64>,
    /// Damping c₁ = c₂ in N·s/m; where not given that of the paper's pair, 1.8e5, in proportion to the root
    /// of the usual stiffness times the smaller gear's mass.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping_n_s_per_m: Option<f64>,
}

/// Which coordinate the simulated sensor measures.
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

/// Which pairs of teeth carry the load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ContactRule {
    /// The paper's rule: the pair with the larger φ₂, and any pair within the threshold of it.
    Threshold,
    /// Elastic load sharing: pairs carry what the closing of their gaps gives, tip edges included.
    Loaded,
}

/// What the gears' width does to their plane deformation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum PlaneState {
    /// Wide against the teeth: no strain along the axis.
    #[default]
    Strain,
    /// Narrow against the teeth: no stress along the axis.
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

/// Numbers of the dynamic model that the paper leaves open.
///
/// The contact rule is elastic load sharing unless said otherwise: it agrees with finite elements within 3 %
/// where the paper's rule errs by 30 %, and a library made with it follows runs made with the paper's rule
/// far better than the other way round (`docs/estimation.md`).
///
/// The mesh damping is c = 2ζ√(k̄ m_e), with k̄ the mean of k(t) over a mesh period and 1/m_e = R_b1²/I₁ +
/// R_b2²/I₂.
///
/// The default ζ = 0.5 was chosen together with that of [`WearSpec`], because the paper's Fig. 22 has RMS,
/// kurtosis and first mesh amplitude all rise with wear and gives none of these numbers: of about a thousand
/// combinations tried it comes nearest, with Spearman coefficients of 0.90, 0.90 and 1.00 over its 50 wear
/// states. No combination makes RMS rise throughout: here it dips between 35 and 80 µm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DynamicsSpec {
    /// Mesh damping ratio ζ.
    pub mesh_damping_ratio: f64,
    /// Which coordinate is the response.
    pub response: ResponseCoordinate,
    /// Which pairs of teeth carry the load.
    pub contact: ContactRule,
    /// Threshold of the contact rule in rad.
    pub contact_threshold_rad: f64,
    /// What loaded contact takes the plane deformation of the gears for.
    pub plane: PlaneState,
    /// Masses m₁, m₂ in kg; where not given those of solid discs of the reference pitch radius and the face
    /// width, the bore filled by its shaft.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<[f64; 2]>,
    /// Moments of inertia I₁, I₂ in kg·m²; where not given those of the same discs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inertia_kg_m2: Option<[f64; 2]>,
}

/// Manufacturing errors, Eq. (26).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ErrorSpec {
    /// Amplitude A₁ of the once-per-turn error in µm; where not given 5 µm for each mm of module.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub long_period_um: Option<f64>,
    /// Amplitude A₂ of the once-per-tooth error in µm; where not given 2.5 µm for each mm of module.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub short_period_um: Option<f64>,
    /// Phase of the once-per-tooth error in mesh periods, from the nominal start of contact on.
    #[serde(skip_serializing_if = "is_zero")]
    pub short_period_phase: f64,
    /// Range of the random error in µm; where not given 1/30 µm for each mm of module.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub random_um: Option<f64>,
    /// Clock on which the random error takes new values, in hertz.
    pub random_clock_hz: f64,
    /// Seed of the random error.
    pub seed: u64,
}

/// Shape of the wear over the flank.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum WearShape {
    /// Least at the pitch point, growing to root and tip with a power.
    Parabolic,
    /// The same depth along Y over the whole flank.
    Floor,
    /// The depths of [`WearSpec::table`], scaled so that the greatest of them is h_max.
    Table,
    /// What Archard's law takes off both flanks under the pair's own torque until the greatest depth is
    /// h_max, Eq. (22).
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
/// The defaults f = 0.05, t = 0.7, p = 4 have almost no wear at the pitch point and most of it towards root
/// and tip, as Fig. 6; they were chosen for the trends of the indicators together with the damping of
/// [`DynamicsSpec`].
///
/// For the shape `archard` K and H set how many turns a depth takes; the shape itself depends on the
/// proportion of the two hardnesses alone. H = 7 GPa is 60 HRC (700 HV): what data sheets of the
/// case-hardening steel 16MnCr5 give for its carburised surface (Akrostal, 16HG/1.7131/16MnCr5: at least 60
/// HRC; Lucefin, 16MnCr5, 2014: 64 HRC down to 57 HRC by the tempering). That Archard's law describes the
/// mild wear of gears is A. Flodin's finding on an FZG rig (Wear of spur and helical gears, KTH Stockholm,
/// 2000). K = 1.7e-7 is that of lubricated steel on steel in a table of such constants (the crate
/// sciforge-lib 0.0.4, `constants/physics/solid_mechanics/wear.rs`, which has 7e-4 for the same dry); an
/// encyclopaedia (article "Wear coefficient") has 1e-2 for severe dry wear down to 1e-6 and less for mild
/// lubricated wear. A value measured on gears could not be read at its source. With the default the typical
/// pair loses 25 µm in 4.7 million turns; turns go with 1/K, and K spans three decades: where they matter,
/// measure it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields, default)]
pub struct WearSpec {
    /// The shape.
    pub shape: WearShape,
    /// f: wear at the pitch point as a part of the greatest.
    pub floor: f64,
    /// t: wear at the tip as a part of that at the root.
    pub tip_ratio: f64,
    /// p: exponent, above 1 so that the slope is continuous at the pitch point.
    pub exponent: f64,
    /// K: dimensionless wear coefficient of the shape `archard`.
    pub coefficient: f64,
    /// H: indentation hardness of the driving and the driven flanks in Pa, for the shape `archard`.
    pub hardness_pa: [f64; 2],
    /// m: how wear grows with the contact pressure for the shape `archard`, dh/ds ∝ (p/p₀)^m with p₀ = 1 GPa.
    /// 1 is Archard's law; experiments scatter around it.
    #[serde(skip_serializing_if = "is_one")]
    pub pressure_exponent: f64,
    /// Whether this shape was measured on the machine's own gears, so that the wear estimate need not doubt
    /// it.
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

/// Archard's own exponent is not written out.
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
    /// [`GearError::Toml`] for anything but TOML of these fields; numbers are looked at by
    /// [`PairSpec::resolve`].
    pub fn from_toml(text: &str) -> Result<Self, GearError> {
        Ok(toml::from_str(text)?)
    }

    /// Checks every number and works out the geometry. Whether worn flanks still carry is looked at by
    /// [`PairSpec::check`].
    ///
    /// # Errors
    /// [`GearError::Field`] with the first field that cannot be used, its value and the limit.
    pub fn resolve(&self) -> Result<GearPair, GearError> {
        GearPair::resolve(self)
    }
}
