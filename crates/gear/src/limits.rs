//! Limits of a gear pair's numbers. Each error names the field, the value and the limit.

use std::f64::consts::FRAC_PI_4;

use super::error::{positive, within};
use super::refusals::Refusals;
use super::{ErrorSpec, GearError, GeometrySpec, MaterialSpec, PairSpec, WearShape, WearSpec, wear_table};

/// Largest bottom clearance of the basic rack in modules (ISO 53, profile A); above it the rack's flank is
/// straight.
const RACK_CLEARANCE_MODULES: f64 = 0.25;
/// Tolerated undercut in modules: 17 teeth of standard form are undercut without harm.
pub(super) const HARMLESS_UNDERCUT_MODULES: f64 = 0.01;
/// Smallest ratio of root to bore radius in the fit of the foundation's polynomial (Sainsot et al. 2004).
pub(super) const MIN_ROOT_TO_BORE: f64 = 1.4;
/// Largest force on the teeth over Young's modulus, face width and module. The deflection of a pair of teeth
/// is about 12 times that, in modules. Steel withstands a thirtieth of it, plastics a third.
const MAX_LOAD: f64 = 0.02;
/// Interference of the mesh in modules that is attributed to rounding of the centre distance.
pub(super) const CENTRE_ROUNDING_MODULES: f64 = 0.01;

/// Checks the range of every number of the basic data.
pub(super) fn check_basic(basic: &GeometrySpec, refusals: &mut Refusals) {
    for teeth in basic.teeth {
        if !(5..=2000).contains(&teeth) {
            refusals.add(GearError::field("geometry.teeth", teeth, "from 5 to 2000 teeth"));
        }
    }
    refusals.check(positive("geometry.module_mm", basic.module_mm, 200.0));
    refusals.check(positive("geometry.face_width_mm", basic.face_width_mm, 10_000.0));
    refusals.check(within("geometry.pressure_angle_deg", basic.pressure_angle_deg, 10.0, 40.0));
    for i in 0..2 {
        refusals.check(positive("geometry.addendum", basic.addendum[i], 3.0));
        refusals.check(positive("geometry.dedendum", basic.dedendum[i], 4.0));
        if let Some(bore) = basic.bore_radius_mm {
            refusals.check(positive("geometry.bore_radius_mm", bore[i], 1e6));
        }
        refusals.check(within("geometry.profile_shift", basic.profile_shift[i], -3.0, 3.0));
    }
    if let Some(centre) = basic.centre_distance_mm {
        refusals.check(positive("geometry.centre_distance_mm", centre, 1e7));
    }
}

/// Checks the range of every number of material, load, supports, dynamics and errors.
pub(super) fn check_physics(spec: &PairSpec, refusals: &mut Refusals) {
    let MaterialSpec { youngs_modulus_pa, poisson_ratio, density_kg_per_m3 } = spec.material;
    refusals.check(within("material.youngs_modulus_pa", youngs_modulus_pa, 1e6, 1e13));
    refusals.check(within("material.poisson_ratio", poisson_ratio, 0.0, 0.499));
    refusals.check(within("material.density_kg_per_m3", density_kg_per_m3, 1.0, 1e5));
    refusals.check(positive("operation.torque_nm", spec.operation.torque_nm, 1e9));
    if let Some(torque) = spec.operation.output_torque_nm {
        refusals.check(positive("operation.output_torque_nm", torque, 1e9));
    }
    refusals.check(positive("operation.shaft_speed_hz", spec.operation.shaft_speed_hz, 1e4));
    if let Some(stiffness) = spec.supports.stiffness_n_per_m {
        refusals.check(positive("supports.stiffness_n_per_m", stiffness, 1e13));
    }
    if let Some(damping) = spec.supports.damping_n_s_per_m {
        refusals.check(within("supports.damping_n_s_per_m", damping, 0.0, 1e10));
    }
    refusals.check(positive("dynamics.mesh_damping_ratio", spec.dynamics.mesh_damping_ratio, 2.0));
    refusals.check(positive("dynamics.contact_threshold_rad", spec.dynamics.contact_threshold_rad, 0.1));
    for i in 0..2 {
        if let Some(masses) = spec.dynamics.mass_kg {
            refusals.check(positive("dynamics.mass_kg", masses[i], 1e8));
        }
        if let Some(inertias) = spec.dynamics.inertia_kg_m2 {
            refusals.check(positive("dynamics.inertia_kg_m2", inertias[i], 1e10));
        }
    }
    let ErrorSpec {
        long_period_um,
        short_period_um,
        short_period_phase,
        random_um,
        random_clock_hz,
        seed: _,
    } = spec.errors;
    for (field, error_um) in [
        ("errors.long_period_um", long_period_um),
        ("errors.short_period_um", short_period_um),
        ("errors.random_um", random_um),
    ] {
        if let Some(error_um) = error_um {
            refusals.check(within(field, error_um, 0.0, 1e4));
        }
    }
    refusals.check(within("errors.short_period_phase", short_period_phase, -1.0, 1.0));
    refusals.check(within("errors.random_clock_hz", random_clock_hz, 1.0, 1e7));
    refusals.check(positive("wear.coefficient", spec.wear.coefficient, 1.0));
    for hardness in spec.wear.hardness_pa {
        refusals.check(within("wear.hardness_pa", hardness, 1e6, 1e12));
    }
    refusals.check(within("wear.pressure_exponent", spec.wear.pressure_exponent, 0.3, 3.0));
    refusals.check(check_shape(&spec.wear));
}

/// Rejects invalid parameters of a shape, whatever its depth.
fn check_shape(spec: &WearSpec) -> Result<(), GearError> {
    match spec.shape {
        WearShape::Parabolic => check_parabola(spec),
        WearShape::Table => wear_table::from_points(&spec.table, 1.0).map(drop),
        WearShape::Floor | WearShape::Archard => Ok(()),
    }
}

fn check_parabola(spec: &WearSpec) -> Result<(), GearError> {
    within("wear.floor", spec.floor, 0.0, 1.0)?;
    within("wear.tip_ratio", spec.tip_ratio, 0.0, 1.0)?;
    if !(spec.exponent > 1.0 && spec.exponent <= 20.0) {
        let expected = "above 1, so that the slope is continuous, and at most 20";
        return Err(GearError::field("wear.exponent", spec.exponent, expected));
    }
    Ok(())
}

/// Checks both torques against the teeth: the force along the line of action on a piece of rack one module
/// high and as wide as the teeth.
pub(super) fn check_load(spec: &PairSpec, base: [f64; 2]) -> Result<(), GearError> {
    let torques = [
        ("operation.torque_nm", Some(spec.operation.torque_nm)),
        ("operation.output_torque_nm", spec.operation.output_torque_nm),
    ];
    for ((field, torque_nm), base_mm) in torques.into_iter().zip(base) {
        let max_nm = max_torque_nm(spec, base_mm);
        if let Some(torque_nm) = torque_nm.filter(|torque| *torque > max_nm) {
            let expected = format!(
                "at most {max_nm:.4}: teeth of this width and material would bend by a quarter of the module"
            );
            return Err(GearError::field(field, torque_nm, expected));
        }
    }
    Ok(())
}

/// Returns the largest torque in N·m that teeth of this width and material withstand on a gear of this base
/// radius.
pub(super) fn max_torque_nm(spec: &PairSpec, base_mm: f64) -> f64 {
    let basic = &spec.geometry;
    MAX_LOAD * spec.material.youngs_modulus_pa * basic.face_width_mm * basic.module_mm * 1e-6 * base_mm * 1e-3
}

/// Checks the centre distance against the base radii and against `min_mm`, that of zero backlash.
pub(super) fn check_centre(
    basic: &GeometrySpec,
    centre_mm: f64,
    base: [f64; 2],
    min_mm: f64,
) -> Result<(), GearError> {
    let field = "geometry.centre_distance_mm";
    if centre_mm <= base[0] + base[1] {
        let expected = format!("more than {:.4}, the sum of the base radii", base[0] + base[1]);
        return Err(GearError::field(field, centre_mm, expected));
    }
    if centre_mm < min_mm - CENTRE_ROUNDING_MODULES * basic.module_mm {
        let expected = format!("at least {min_mm:.4}, as below it the teeth jam");
        return Err(GearError::field(field, centre_mm, expected));
    }
    Ok(())
}

/// Checks that the tip circles intersect, so that the teeth can touch.
pub(super) fn check_reach(centre_mm: f64, tip: [f64; 2]) -> Result<(), GearError> {
    if centre_mm >= tip[0] + tip[1] {
        let expected = format!(
            "less than {:.4}, the sum of the tip radii: beyond it no teeth are in contact",
            tip[0] + tip[1]
        );
        return Err(GearError::field("geometry.centre_distance_mm", centre_mm, expected));
    }
    Ok(())
}

/// Checks undercut, tooth height and bore of gear `i` with its `[base, tip, root]` radii.
pub(super) fn check_tooth(
    basic: &GeometrySpec,
    i: usize,
    [base, tip, root, bore]: [f64; 4],
    alpha0: f64,
    refusals: &mut Refusals,
) {
    let number = i + 1;
    if tip <= base || tip <= root {
        let expected = format!(
            "a larger value: the tip radius {tip:.4} mm of gear {number} is not above its base and root circles"
        );
        refusals.add(GearError::field("geometry.addendum", basic.addendum[i], expected));
        return;
    }
    refusals.check(check_rack(basic, i, alpha0));
    if root <= 0.0 {
        let expected = format!("a smaller value: the root radius {root:.4} of gear {number} is not above 0");
        refusals.add(GearError::field("geometry.dedendum", basic.dedendum[i], expected));
    } else if bore * MIN_ROOT_TO_BORE > root {
        let expected = format!(
            "at most {:.4}: the root radius {root:.4} of gear {number} over {MIN_ROOT_TO_BORE}",
            root / MIN_ROOT_TO_BORE
        );
        refusals.add(GearError::field("geometry.bore_radius_mm", bore, expected));
    }
    let min_shift = min_profile_shift(basic, i, alpha0);
    let accepted_shift = min_shift - HARMLESS_UNDERCUT_MODULES;
    if basic.profile_shift[i] < accepted_shift {
        let depth = rack_depth(basic, i) - basic.profile_shift[i] - HARMLESS_UNDERCUT_MODULES;
        let min_teeth = (2.0 * depth / alpha0.sin().powi(2)).ceil();
        // Rounded up, so that the value stated is accepted.
        let stated_shift = (1e4 * accepted_shift).ceil() / 1e4;
        let expected = format!(
            "at least {min_teeth} teeth on gear {number} or a profile shift of at least {stated_shift}, as the teeth are undercut by \
             more than {HARMLESS_UNDERCUT_MODULES} modules"
        );
        refusals.add(GearError::field("geometry.teeth", basic.teeth[i], expected));
    }
}

/// Returns the profile shift of gear `i` in modules below which its teeth are undercut.
pub(super) fn min_profile_shift(basic: &GeometrySpec, i: usize, alpha0: f64) -> f64 {
    rack_depth(basic, i) - f64::from(basic.teeth[i]) * alpha0.sin().powi(2) / 2.0
}

/// Returns the length in mm on the line of action from gear `i`'s base circle to the end of its involute.
pub(super) fn form_length_mm(basic: &GeometrySpec, i: usize, alpha0: f64) -> f64 {
    let reference = basic.module_mm * f64::from(basic.teeth[i]) / 2.0;
    (reference * alpha0.sin()
        - (rack_depth(basic, i) - basic.profile_shift[i]) * basic.module_mm / alpha0.sin())
    .max(0.0)
}

/// Checks that the tooth of the rack that cuts gear `i` is not pointed: half its thickness is π/4 modules on
/// the rolling line.
fn check_rack(basic: &GeometrySpec, i: usize, alpha0: f64) -> Result<(), GearError> {
    let max = FRAC_PI_4 / alpha0.tan();
    if basic.dedendum[i] >= max {
        let expected = format!("less than {max:.4}, where the rack that cuts gear {} is pointed", i + 1);
        return Err(GearError::field("geometry.dedendum", basic.dedendum[i], expected));
    }
    Ok(())
}

/// Returns the depth in modules of the straight part of the rack that cuts gear `i`.
fn rack_depth(basic: &GeometrySpec, i: usize) -> f64 {
    basic.dedendum[i] - (basic.dedendum[i] - basic.addendum[1 - i]).clamp(0.0, RACK_CLEARANCE_MODULES)
}

/// Checks that the mating tip meets gear `i` on its involute, at or above the form circle where the fillet
/// ends.
pub(super) fn check_active_profile(
    basic: &GeometrySpec,
    i: usize,
    sap_length_mm: f64,
    alpha0: f64,
) -> Result<(), GearError> {
    let form_length_mm = form_length_mm(basic, i, alpha0);
    if sap_length_mm < form_length_mm - 1e-6 * basic.module_mm {
        let expected = format!(
            "a smaller value: the tip of gear {} meets gear {} {:.4} mm (along the line of action) below the end of its involute",
            2 - i,
            i + 1,
            form_length_mm - sap_length_mm
        );
        return Err(GearError::field("geometry.addendum", basic.addendum[1 - i], expected));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::testing::shen2022_spec;
    use crate::{GearError, PairSpec, WearShape};

    #[test]
    fn invalid_values_are_rejected_with_the_field() {
        type Change = fn(&mut PairSpec);
        let cases: [(&str, Change); 36] = [
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
            ("geometry.dedendum", |s| s.geometry.dedendum[1] = 2.2),
            ("wear.floor", |s| s.wear.floor = f64::NAN),
            ("wear.tip_ratio", |s| s.wear.tip_ratio = 1.5),
            ("wear.exponent", |s| s.wear.exponent = 1.0),
            ("wear.table", |s| s.wear.shape = WearShape::Table),
            ("geometry.profile_shift", |s| s.geometry.profile_shift[0] = f64::NAN),
            ("geometry.bore_radius_mm", |s| s.geometry.bore_radius_mm = Some([64.5, 20.0])),
            ("geometry.bore_radius_mm", |s| s.geometry.bore_radius_mm = Some([20.0, 0.0])),
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
            ("supports.stiffness_n_per_m", |s| s.supports.stiffness_n_per_m = Some(0.0)),
            ("supports.damping_n_s_per_m", |s| s.supports.damping_n_s_per_m = Some(-1.0)),
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

    /// A hundred times what the paper's pair carries is too much for its teeth, and for ones of plastic what
    /// it carries.
    #[test]
    fn the_torque_is_limited_by_the_teeth() {
        let refusal = |change: fn(&mut PairSpec)| {
            let mut spec = shen2022_spec();
            change(&mut spec);
            spec.resolve().unwrap_err().to_string()
        };
        let steel = refusal(|s| s.operation.torque_nm = 130_000.0);
        assert!(steel.starts_with("operation.torque_nm is 130000, expected at most 83219."), "{steel}");
        let plastic = refusal(|s| s.material.youngs_modulus_pa = 2.8e9);
        assert!(plastic.starts_with("operation.torque_nm is 1300, expected at most 1136."), "{plastic}");
        let output = refusal(|s| s.operation.output_torque_nm = Some(1e9));
        assert!(output.starts_with("operation.output_torque_nm is 1000000000"), "{output}");
    }

    #[test]
    fn errors_describe_the_problem_of_the_teeth() {
        let refusal = |change: fn(&mut PairSpec)| {
            let mut spec = shen2022_spec();
            spec.geometry.centre_distance_mm = None;
            change(&mut spec);
            spec.resolve().unwrap_err().to_string()
        };
        assert!(refusal(|s| s.geometry.teeth = [12, 26]).contains("at least 17 teeth on gear 1"));
        let pointed = refusal(|s| {
            s.geometry.teeth = [16, 60];
            s.geometry.profile_shift = [1.2, 0.0];
            s.geometry.addendum = [1.0, 0.6];
        });
        assert!(pointed.contains("pointed"), "{pointed}");
        let short = refusal(|s| s.geometry.addendum = [0.4, 0.4]);
        assert!(short.contains("contact ratio"), "{short}");
    }
}
