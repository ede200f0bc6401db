//! Macro-geometry of a pair, worked out from its basic data and checked.

use std::f64::consts::{FRAC_PI_2, PI};

use super::error::{positive, within};
use super::{ErrorSpec, GearError, GeometrySpec, MaterialSpec, PairSpec};

/// Greatest bottom clearance of the basic rack in modules (ISO 53, profile A); the rack's flank is straight above it.
const RACK_CLEARANCE_MODULES: f64 = 0.25;
/// Undercut that is let pass, in modules: 17 teeth of standard form are cut without harm.
const HARMLESS_UNDERCUT_MODULES: f64 = 0.01;
/// Thinnest tip in modules that does not count as pointed.
const LEAST_TIP_THICKNESS_MODULES: f64 = 0.05;
/// Least ratio of root to bore radius for which the foundation's polynomial was made (Sainsot et al. 2004).
const LEAST_ROOT_TO_BORE: f64 = 1.4;
/// Tightness of the mesh in modules that counts as the rounding of a centre distance.
const CENTRE_ROUNDING_MODULES: f64 = 0.01;

/// One gear of a pair. Angles of flank points are the paper's α₁: the angle between the flank's normal there and the tooth's Y axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Gear {
    /// Tooth number z.
    pub teeth: u32,
    /// Reference pitch radius m·z/2 in mm.
    pub reference_radius_mm: f64,
    /// Operating pitch radius in mm: where the teeth roll without sliding.
    pub pitch_radius_mm: f64,
    /// Base radius R_b in mm.
    pub base_radius_mm: f64,
    /// Tip radius in mm.
    pub tip_radius_mm: f64,
    /// Root radius R_r in mm.
    pub root_radius_mm: f64,
    /// Bore radius in mm.
    pub bore_radius_mm: f64,
    /// Half the tooth's angle at the base circle, α₂ in rad.
    pub base_half_angle_rad: f64,
    /// Angle c of the start of active profile in rad: where the mating tip enters or leaves.
    pub root_angle_rad: f64,
    /// Angle a of the tip in rad.
    pub tip_angle_rad: f64,
    /// Radius of the start of active profile in mm.
    pub sap_radius_mm: f64,
    /// Mass in kg.
    pub mass_kg: f64,
    /// Moment of inertia in kg·m².
    pub inertia_kg_m2: f64,
}

/// A pair whose numbers are checked and whose geometry is worked out; gear 1, `gears[0]`, drives.
#[derive(Debug, Clone, PartialEq)]
pub struct GearPair {
    /// What it was made from.
    pub spec: PairSpec,
    /// Driving and driven gear.
    pub gears: [Gear; 2],
    /// Operating centre distance a_ω in mm.
    pub centre_distance_mm: f64,
    /// Operating pressure angle in rad; the paper's α₀ where the centre distance is the reference one.
    pub pressure_angle_rad: f64,
}

impl GearPair {
    /// Checks every number of `spec` and works out the geometry.
    pub(super) fn resolve(spec: &PairSpec) -> Result<Self, GearError> {
        let basic = &spec.geometry;
        check_basic(basic)?;
        check_physics(spec)?;

        let alpha0 = basic.pressure_angle_deg.to_radians();
        let reference = basic.teeth.map(|z| basic.module_mm * f64::from(z) / 2.0);
        let base = reference.map(|r| r * alpha0.cos());
        let zero_backlash = zero_backlash_angle(basic, alpha0)?;
        let least_centre_mm = (base[0] + base[1]) / zero_backlash.cos();
        let centre_distance_mm = basic.centre_distance_mm.unwrap_or(least_centre_mm);
        check_centre(basic, centre_distance_mm, base, least_centre_mm)?;
        let pressure_angle_rad = ((base[0] + base[1]) / centre_distance_mm).acos();

        let tip = [0, 1].map(|i| reference[i] + (basic.addendum[i] + basic.profile_shift[i]) * basic.module_mm);
        let root = [0, 1].map(|i| reference[i] - (basic.dedendum[i] - basic.profile_shift[i]) * basic.module_mm);
        let mut gears = Vec::with_capacity(2);
        for i in 0..2 {
            check_tooth(basic, i, [base[i], tip[i], root[i]], alpha0)?;
            if tip[i] + root[1 - i] > centre_distance_mm + 1e-9 {
                let most = (centre_distance_mm - root[1 - i] - reference[i]) / basic.module_mm - basic.profile_shift[i];
                let expected = format!("at most {most:.4}, where the tip of gear {} reaches the other's root", i + 1);
                return Err(GearError::field("geometry.addendum", basic.addendum[i], expected));
            }
            let teeth = f64::from(basic.teeth[i]);
            let base_half_angle_rad = FRAC_PI_2 / teeth + involute(alpha0) + 2.0 * basic.profile_shift[i] * alpha0.tan() / teeth;
            let sap_length_mm = centre_distance_mm * pressure_angle_rad.sin() - flank_length(tip[1 - i], base[1 - i]);
            check_active_profile(basic, i, sap_length_mm, alpha0)?;
            gears.push(Gear {
                teeth: basic.teeth[i],
                reference_radius_mm: reference[i],
                pitch_radius_mm: base[i] / pressure_angle_rad.cos(),
                base_radius_mm: base[i],
                tip_radius_mm: tip[i],
                root_radius_mm: root[i],
                bore_radius_mm: basic.bore_radius_mm[i],
                base_half_angle_rad,
                root_angle_rad: sap_length_mm / base[i] - base_half_angle_rad,
                tip_angle_rad: flank_length(tip[i], base[i]) / base[i] - base_half_angle_rad,
                sap_radius_mm: base[i].hypot(sap_length_mm),
                mass_kg: mass(spec, i, reference[i]),
                inertia_kg_m2: inertia(spec, i, reference[i]),
            });
        }
        let gears = <[Gear; 2]>::try_from(gears).expect("the loop made two");
        let pair = Self {
            spec: spec.clone(),
            gears,
            centre_distance_mm,
            pressure_angle_rad,
        };
        pair.check_tips()?;
        Ok(pair)
    }

    /// Contact ratio of the unworn pair: mesh periods that one pair of teeth stays in contact.
    pub fn contact_ratio(&self) -> f64 {
        (self.gears[0].tip_angle_rad - self.gears[0].root_angle_rad) / self.gears[0].pitch_angle_rad()
    }

    /// Nominal start of contact of a pair of teeth: φ₁ in rad at which the driven tip meets the driving start of active profile.
    pub fn start_of_contact_rad(&self) -> f64 {
        self.gears[0].root_angle_rad - self.pressure_angle_rad
    }

    /// φ₁ R_b1/R_b2 − φ₂ of perfect flanks in rad, the same at every rotation: from φ₁ = α₁ − α, φ₂ = α − α₁′ and
    /// R_b1 (α₁ + α₂) + R_b2 (α₁′ + α₂′) = a sin α.
    pub fn perfect_lag_rad(&self) -> f64 {
        let [driving, driven] = &self.gears;
        let angle = self.pressure_angle_rad;
        let line = self.centre_distance_mm * angle.sin();
        let thickness = |gear: &Gear| gear.base_radius_mm * (gear.base_half_angle_rad + angle);
        (line - thickness(driving) - thickness(driven)) / driven.base_radius_mm
    }

    /// Mass m_e in kg of the relative rotation along the line of action: 1/m_e = R_b1²/I₁ + R_b2²/I₂.
    pub fn mesh_mass_kg(&self) -> f64 {
        let part = |gear: &Gear| (gear.base_radius_mm * 1e-3).powi(2) / gear.inertia_kg_m2;
        1.0 / (part(&self.gears[0]) + part(&self.gears[1]))
    }

    /// Pointed tips and contact ratio, which need the whole geometry.
    fn check_tips(&self) -> Result<(), GearError> {
        for (i, gear) in self.gears.iter().enumerate() {
            let half_angle = (gear.base_radius_mm / gear.tip_radius_mm).acos() - gear.tip_angle_rad;
            let thickness = 2.0 * gear.tip_radius_mm * half_angle / self.spec.geometry.module_mm;
            if thickness < LEAST_TIP_THICKNESS_MODULES {
                let expected = format!(
                    "less: the tip of gear {} would be {thickness:.3} modules thick, below {LEAST_TIP_THICKNESS_MODULES} it is pointed",
                    i + 1
                );
                return Err(GearError::field("geometry.addendum", self.spec.geometry.addendum[i], expected));
            }
        }
        let ratio = self.contact_ratio();
        if ratio < 1.0 {
            let expected = format!("a longer tooth or more teeth: the contact ratio is {ratio:.4}, at least 1 carries the mesh on");
            return Err(GearError::field(
                "geometry.addendum",
                format!("{:?}", self.spec.geometry.addendum),
                expected,
            ));
        }
        Ok(())
    }
}

impl Gear {
    /// Angle between two teeth, 2π/z, in rad.
    pub fn pitch_angle_rad(&self) -> f64 {
        2.0 * PI / f64::from(self.teeth)
    }
}

/// inv α = tan α − α.
fn involute(angle: f64) -> f64 {
    angle.tan() - angle
}

/// Length of the line from the base circle's tangent point to the involute's point at `radius`.
fn flank_length(radius: f64, base: f64) -> f64 {
    (radius * radius - base * base).max(0.0).sqrt()
}

/// Operating pressure angle of zero backlash: inv α = inv α₀ + 2 tan α₀ (x₁ + x₂)/(z₁ + z₂), by Newton's method.
fn zero_backlash_angle(basic: &GeometrySpec, alpha0: f64) -> Result<f64, GearError> {
    let teeth = f64::from(basic.teeth[0]) + f64::from(basic.teeth[1]);
    let shift = basic.profile_shift[0] + basic.profile_shift[1];
    let wanted = involute(alpha0) + 2.0 * alpha0.tan() * shift / teeth;
    if wanted <= 1e-9 {
        let expected = format!(
            "a sum above {:.4}, where the pressure angle vanishes",
            -involute(alpha0) * teeth / (2.0 * alpha0.tan())
        );
        return Err(GearError::field(
            "geometry.profile_shift",
            format!("{:?}", basic.profile_shift),
            expected,
        ));
    }
    if shift == 0.0 {
        return Ok(alpha0);
    }
    // inv is convex and rises: from above the root, Newton's steps fall monotonically onto it.
    let mut angle = (3.0 * wanted).cbrt().min(1.5);
    for _ in 0..60 {
        let step = (involute(angle) - wanted) / angle.tan().powi(2);
        angle -= step;
        if step.abs() < 1e-16 {
            break;
        }
    }
    Ok(angle)
}

fn check_basic(basic: &GeometrySpec) -> Result<(), GearError> {
    for teeth in basic.teeth {
        if !(5..=2000).contains(&teeth) {
            return Err(GearError::field("geometry.teeth", teeth, "from 5 to 2000 teeth"));
        }
    }
    positive("geometry.module_mm", basic.module_mm, 200.0)?;
    positive("geometry.face_width_mm", basic.face_width_mm, 10_000.0)?;
    within("geometry.pressure_angle_deg", basic.pressure_angle_deg, 10.0, 40.0)?;
    for i in 0..2 {
        positive("geometry.addendum", basic.addendum[i], 3.0)?;
        positive("geometry.dedendum", basic.dedendum[i], 4.0)?;
        positive("geometry.bore_radius_mm", basic.bore_radius_mm[i], 1e6)?;
        within("geometry.profile_shift", basic.profile_shift[i], -3.0, 3.0)?;
    }
    if let Some(centre) = basic.centre_distance_mm {
        positive("geometry.centre_distance_mm", centre, 1e7)?;
    }
    Ok(())
}

fn check_physics(spec: &PairSpec) -> Result<(), GearError> {
    let MaterialSpec {
        youngs_modulus_pa,
        poisson_ratio,
        density_kg_per_m3,
    } = spec.material;
    within("material.youngs_modulus_pa", youngs_modulus_pa, 1e6, 1e13)?;
    within("material.poisson_ratio", poisson_ratio, 0.0, 0.499)?;
    within("material.density_kg_per_m3", density_kg_per_m3, 1.0, 1e5)?;
    positive("operation.torque_nm", spec.operation.torque_nm, 1e9)?;
    if let Some(torque) = spec.operation.output_torque_nm {
        positive("operation.output_torque_nm", torque, 1e9)?;
    }
    positive("operation.shaft_speed_hz", spec.operation.shaft_speed_hz, 1e4)?;
    positive("supports.stiffness_n_per_m", spec.supports.stiffness_n_per_m, 1e13)?;
    within("supports.damping_n_s_per_m", spec.supports.damping_n_s_per_m, 0.0, 1e10)?;
    positive("dynamics.mesh_damping_ratio", spec.dynamics.mesh_damping_ratio, 2.0)?;
    positive("dynamics.contact_threshold_rad", spec.dynamics.contact_threshold_rad, 0.1)?;
    for i in 0..2 {
        if let Some(masses) = spec.dynamics.mass_kg {
            positive("dynamics.mass_kg", masses[i], 1e8)?;
        }
        if let Some(inertias) = spec.dynamics.inertia_kg_m2 {
            positive("dynamics.inertia_kg_m2", inertias[i], 1e10)?;
        }
    }
    let ErrorSpec {
        long_period_um,
        short_period_um,
        random_um,
        random_clock_hz,
        seed: _,
    } = spec.errors;
    within("errors.long_period_um", long_period_um, 0.0, 1e4)?;
    within("errors.short_period_um", short_period_um, 0.0, 1e4)?;
    within("errors.random_um", random_um, 0.0, 1e4)?;
    within("errors.random_clock_hz", random_clock_hz, 1.0, 1e7)?;
    Ok(())
}

fn check_centre(basic: &GeometrySpec, centre_mm: f64, base: [f64; 2], least_mm: f64) -> Result<(), GearError> {
    let field = "geometry.centre_distance_mm";
    if centre_mm <= base[0] + base[1] {
        let expected = format!("more than {:.4}, the sum of the base radii", base[0] + base[1]);
        return Err(GearError::field(field, centre_mm, expected));
    }
    if centre_mm < least_mm - CENTRE_ROUNDING_MODULES * basic.module_mm {
        let expected = format!("at least {least_mm:.4}, below it the teeth jam");
        return Err(GearError::field(field, centre_mm, expected));
    }
    Ok(())
}

/// Undercut, tooth height and bore of gear `i` with its `[base, tip, root]` radii.
fn check_tooth(basic: &GeometrySpec, i: usize, [base, tip, root]: [f64; 3], alpha0: f64) -> Result<(), GearError> {
    let number = i + 1;
    if tip <= base || tip <= root {
        let expected = format!("more: the tip radius {tip:.4} of gear {number} mm is not above its base and root circles");
        return Err(GearError::field("geometry.addendum", basic.addendum[i], expected));
    }
    let bore = basic.bore_radius_mm[i];
    if root <= 0.0 || bore * LEAST_ROOT_TO_BORE > root {
        let expected = format!(
            "at most {:.4}: the root radius {root:.4} of gear {number} over {LEAST_ROOT_TO_BORE}",
            root / LEAST_ROOT_TO_BORE
        );
        return Err(GearError::field("geometry.bore_radius_mm", bore, expected));
    }
    let teeth = f64::from(basic.teeth[i]);
    let least_shift = rack_depth(basic, i) - teeth * alpha0.sin().powi(2) / 2.0;
    if basic.profile_shift[i] < least_shift - HARMLESS_UNDERCUT_MODULES {
        let least_teeth = (2.0 * (rack_depth(basic, i) - basic.profile_shift[i]) / alpha0.sin().powi(2)).ceil();
        let expected = format!(
            "at least {least_teeth} teeth on gear {number} or a profile shift of at least {least_shift:.4}, below it the tooth is undercut"
        );
        return Err(GearError::field("geometry.teeth", basic.teeth[i], expected));
    }
    Ok(())
}

/// Depth in modules of the straight part of the rack that cuts gear `i`.
fn rack_depth(basic: &GeometrySpec, i: usize) -> f64 {
    basic.dedendum[i] - (basic.dedendum[i] - basic.addendum[1 - i]).clamp(0.0, RACK_CLEARANCE_MODULES)
}

/// The mating tip must meet gear `i` on its involute, at or above the form circle where the fillet ends.
fn check_active_profile(basic: &GeometrySpec, i: usize, sap_length_mm: f64, alpha0: f64) -> Result<(), GearError> {
    let reference = basic.module_mm * f64::from(basic.teeth[i]) / 2.0;
    let form_length_mm = reference * alpha0.sin() - (rack_depth(basic, i) - basic.profile_shift[i]) * basic.module_mm / alpha0.sin();
    if sap_length_mm < form_length_mm.max(0.0) - 1e-6 * basic.module_mm {
        let expected = format!(
            "less: the tip of gear {} meets gear {} {:.4} mm of line of action below the end of its involute",
            2 - i,
            i + 1,
            form_length_mm.max(0.0) - sap_length_mm
        );
        return Err(GearError::field("geometry.addendum", basic.addendum[1 - i], expected));
    }
    Ok(())
}

fn disc_mass(spec: &PairSpec, radius_mm: f64) -> f64 {
    spec.material.density_kg_per_m3 * PI * (radius_mm * 1e-3).powi(2) * spec.geometry.face_width_mm * 1e-3
}

fn mass(spec: &PairSpec, i: usize, radius_mm: f64) -> f64 {
    spec.dynamics.mass_kg.map_or_else(|| disc_mass(spec, radius_mm), |masses| masses[i])
}

fn inertia(spec: &PairSpec, i: usize, radius_mm: f64) -> f64 {
    let disc = || disc_mass(spec, radius_mm) * (radius_mm * 1e-3).powi(2) / 2.0;
    spec.dynamics.inertia_kg_m2.map_or_else(disc, |inertias| inertias[i])
}

#[cfg(test)]
mod tests {
    use super::super::testing::{shen2022, shen2022_spec};
    use crate::gear::{GearError, PairSpec};

    #[test]
    fn table_1_is_reproduced_to_its_last_digit() {
        let pair = shen2022();
        let rounded = |value: f64, digits: i32| (value * 10.0_f64.powi(digits)).round() / 10.0_f64.powi(digits);
        let of = |value: fn(&crate::gear::Gear) -> f64, digits| pair.gears.each_ref().map(|gear| rounded(value(gear), digits));
        assert_eq!(of(|gear| gear.base_radius_mm, 1), [67.7, 73.3]);
        assert_eq!(of(|gear| gear.root_radius_mm, 1), [64.5, 70.5]);
        assert_eq!(of(|gear| gear.root_angle_rad, 4), [0.0714, 0.0951]);
        assert_eq!(of(|gear| gear.tip_angle_rad, 4), [0.4933, 0.4845]);
        // To more digits than the table has: z m cos α₀/2 and π/(2z) + inv α₀ by hand.
        assert_eq!(of(|gear| gear.base_radius_mm, 3), [67.658, 73.296]);
        assert_eq!(of(|gear| gear.base_half_angle_rad, 6), [0.080_354, 0.075_320]);
        assert_eq!(of(|gear| gear.tip_radius_mm, 6), [78.0, 84.0]);
        assert_eq!(rounded(pair.centre_distance_mm, 6), 150.0);
        assert_eq!(rounded(pair.contact_ratio(), 4), 1.6114);
        assert_eq!(rounded(pair.start_of_contact_rad(), 5), -0.27762);
    }

    #[test]
    fn centre_distance_follows_from_the_profile_shifts() {
        // Niemann/Winter's formulae by hand: z 20/40, m 3, x 0.3/0.2; inv α_w = inv 20° + 2 tan 20° 0.5/60 = 0.020 970 7,
        // α_w = 22.336°, a = 90 cos 20°/cos α_w.
        let mut spec = shen2022_spec();
        spec.geometry.teeth = [20, 40];
        spec.geometry.module_mm = 3.0;
        spec.geometry.profile_shift = [0.3, 0.2];
        spec.geometry.bore_radius_mm = [10.0, 10.0];
        spec.geometry.centre_distance_mm = None;
        let pair = spec.resolve().unwrap();
        let angle = pair.pressure_angle_rad;
        assert!((angle.tan() - angle - 0.020_970_7).abs() < 2e-7, "inv {}", angle.tan() - angle);
        assert!((pair.centre_distance_mm - 90.0 * 20.0_f64.to_radians().cos() / angle.cos()).abs() < 1e-9);
        assert!((pair.gears[0].pitch_radius_mm * 3.0 - pair.centre_distance_mm).abs() < 1e-9);
        // Zero backlash: the two operating pitch circles' thicknesses fill one pitch.
        let thickness: f64 = pair
            .gears
            .iter()
            .map(|gear| 2.0 * gear.pitch_radius_mm * (gear.base_half_angle_rad - (angle.tan() - angle)))
            .sum();
        assert!((thickness - pair.gears[0].pitch_radius_mm * pair.gears[0].pitch_angle_rad()).abs() < 1e-9);
    }

    #[test]
    fn length_of_contact_over_the_base_pitch_is_the_contact_ratio() {
        // The textbook's ε = (√(r_a1² − r_b1²) + √(r_a2² − r_b2²) − a sin α_w)/p_b, at an extended centre distance.
        let mut spec = shen2022_spec();
        spec.geometry.centre_distance_mm = Some(151.5);
        let pair = spec.resolve().unwrap();
        let reach: f64 = pair
            .gears
            .iter()
            .map(|gear| (gear.tip_radius_mm.powi(2) - gear.base_radius_mm.powi(2)).sqrt())
            .sum();
        let length = reach - 151.5 * pair.pressure_angle_rad.sin();
        let base_pitch = pair.gears[0].base_radius_mm * pair.gears[0].pitch_angle_rad();
        assert!((length / base_pitch - pair.contact_ratio()).abs() < 1e-12);
        assert!(pair.contact_ratio() < 1.6114);
    }

    #[test]
    fn values_that_cannot_be_used_are_refused_with_the_field() {
        type Change = fn(&mut PairSpec);
        let cases: [(&str, Change); 31] = [
            ("geometry.teeth", |s| s.geometry.teeth[0] = 0),
            ("geometry.teeth", |s| s.geometry.teeth[1] = 12),
            ("geometry.teeth", |s| s.geometry.profile_shift = [-0.5, 0.5]),
            ("geometry.module_mm", |s| s.geometry.module_mm = 0.0),
            ("geometry.module_mm", |s| s.geometry.module_mm = f64::NAN),
            ("geometry.face_width_mm", |s| s.geometry.face_width_mm = -50.0),
            ("geometry.pressure_angle_deg", |s| s.geometry.pressure_angle_deg = 0.0),
            ("geometry.pressure_angle_deg", |s| s.geometry.pressure_angle_deg = 90.0),
            ("geometry.addendum", |s| s.geometry.addendum[1] = f64::INFINITY),
            ("geometry.addendum", |s| s.geometry.addendum = [0.3, 0.3]),
            ("geometry.addendum", |s| s.geometry.addendum = [1.3, 1.0]),
            ("geometry.dedendum", |s| s.geometry.dedendum[0] = 0.0),
            ("geometry.profile_shift", |s| s.geometry.profile_shift[0] = f64::NAN),
            ("geometry.bore_radius_mm", |s| s.geometry.bore_radius_mm[0] = 64.5),
            ("geometry.bore_radius_mm", |s| s.geometry.bore_radius_mm[1] = 0.0),
            ("geometry.centre_distance_mm", |s| s.geometry.centre_distance_mm = Some(140.0)),
            ("geometry.centre_distance_mm", |s| s.geometry.centre_distance_mm = Some(149.0)),
            ("geometry.addendum", |s| s.geometry.centre_distance_mm = Some(158.0)),
            ("material.youngs_modulus_pa", |s| s.material.youngs_modulus_pa = 0.0),
            ("material.poisson_ratio", |s| s.material.poisson_ratio = 0.5),
            ("material.density_kg_per_m3", |s| s.material.density_kg_per_m3 = f64::NAN),
            ("operation.torque_nm", |s| s.operation.torque_nm = 0.0),
            ("operation.torque_nm", |s| s.operation.torque_nm = f64::NAN),
            ("operation.output_torque_nm", |s| s.operation.output_torque_nm = Some(-1.0)),
            ("operation.shaft_speed_hz", |s| s.operation.shaft_speed_hz = 0.0),
            ("supports.stiffness_n_per_m", |s| s.supports.stiffness_n_per_m = 0.0),
            ("supports.damping_n_s_per_m", |s| s.supports.damping_n_s_per_m = -1.0),
            ("dynamics.mesh_damping_ratio", |s| s.dynamics.mesh_damping_ratio = 0.0),
            ("dynamics.contact_threshold_rad", |s| s.dynamics.contact_threshold_rad = f64::NAN),
            ("dynamics.mass_kg", |s| s.dynamics.mass_kg = Some([1.0, 0.0])),
            ("errors.random_clock_hz", |s| s.errors.random_clock_hz = 0.0),
        ];
        for (wanted, change) in cases {
            let mut spec = shen2022_spec();
            change(&mut spec);
            match spec.resolve() {
                Err(GearError::Field { field, expected, .. }) => assert_eq!(field, wanted, "{expected}"),
                other => panic!("{wanted}: {other:?}"),
            }
        }
    }

    #[test]
    fn refusals_say_what_is_wrong_with_the_teeth() {
        let refusal = |change: fn(&mut PairSpec)| {
            let mut spec = shen2022_spec();
            spec.geometry.centre_distance_mm = None;
            change(&mut spec);
            spec.resolve().unwrap_err().to_string()
        };
        assert!(refusal(|s| s.geometry.teeth = [12, 26]).contains("at least 18 teeth on gear 1"));
        let pointed = refusal(|s| {
            s.geometry.teeth = [16, 60];
            s.geometry.profile_shift = [1.2, 0.0];
            s.geometry.addendum = [1.0, 0.6];
        });
        assert!(pointed.contains("pointed"), "{pointed}");
        let short = refusal(|s| s.geometry.addendum = [0.4, 0.4]);
        assert!(short.contains("contact ratio"), "{short}");
    }

    #[test]
    fn masses_and_inertias_are_those_of_solid_discs_unless_given() {
        let mut spec = shen2022_spec();
        let pair = spec.resolve().unwrap();
        // 7850 π 0.072² 0.05 kg and half of that times 0.072².
        assert!((pair.gears[0].mass_kg - 6.392_261).abs() < 1e-6);
        assert!((pair.gears[0].inertia_kg_m2 - 0.016_568_74).abs() < 1e-8);
        spec.dynamics.mass_kg = Some([5.0, 6.0]);
        spec.dynamics.inertia_kg_m2 = Some([0.01, 0.02]);
        let pair = spec.resolve().unwrap();
        assert_eq!((pair.gears[1].mass_kg, pair.gears[0].inertia_kg_m2), (6.0, 0.01));
    }
}
