//! For any pair file, the model returns plausible numbers or an error.

use proptest::prelude::*;

use super::testing::shen2022_spec;
use super::{ContactRule, FlankWear, GearError, MeshCycle, PairSpec, WearPoint, WearShape};

prop_compose! {
    /// Geometries of which about half are gears.
    fn pairs()(
        teeth in prop::array::uniform2(12_u32..160),
        module_mm in 0.3..20.0_f64,
        pressure_angle_deg in prop_oneof![Just(20.0), 14.0..30.0],
        addendum in prop::array::uniform2(0.7..1.3_f64),
        clearance in prop::array::uniform2(0.05..0.5_f64),
        profile_shift in prop_oneof![Just([0.0, 0.0]), prop::array::uniform2(-0.6..0.9)],
        bore in prop::array::uniform2(0.05..0.75_f64),
        apart in prop::option::of(-0.02..1.0_f64),
        torque in -3.0..3.0_f64,
    ) -> PairSpec {
        let mut spec = shen2022_spec();
        let reference = teeth.map(|z| module_mm * f64::from(z) / 2.0);
        let basic = &mut spec.geometry;
        (basic.teeth, basic.module_mm, basic.pressure_angle_deg) = (teeth, module_mm, pressure_angle_deg);
        (basic.addendum, basic.profile_shift) = (addendum, profile_shift);
        basic.dedendum = [addendum[1] + clearance[0], addendum[0] + clearance[1]];
        basic.face_width_mm = 8.0 * module_mm;
        basic.bore_radius_mm = Some([bore[0] * reference[0], bore[1] * reference[1]]);
        basic.centre_distance_mm = apart.map(|modules| reference[0] + reference[1] + modules * module_mm);
        // From a thousandth to a thousand times the load of the typical pair on its teeth's cross-section.
        spec.operation.torque_nm = 1300.0 * (module_mm / 6.0).powi(3) * f64::from(teeth[0]) / 24.0 * 10.0_f64.powf(torque);
        spec.operation.output_torque_nm = None;
        spec
    }
}

prop_compose! {
    /// Pairs with wear of any shape, and its greatest depth in mm.
    fn worn_pairs()(
        mut spec in pairs(),
        shape in prop_oneof![Just(WearShape::Parabolic), Just(WearShape::Floor), Just(WearShape::Table), Just(WearShape::Archard)],
        (floor, tip_ratio, exponent) in (0.0..1.0_f64, 0.0..1.0_f64, 1.01..20.0_f64),
        table in prop::collection::vec((1_u32..3, -1.2..1.2_f64, 0.0..100.0_f64), 1..12),
        contact in prop_oneof![Just(ContactRule::Threshold), Just(ContactRule::Loaded)],
        depth_modules in prop_oneof![Just(0.0), (-4.0..-0.5_f64).prop_map(|power| 10.0_f64.powf(power))],
    ) -> (PairSpec, f64) {
        (spec.wear.shape, spec.wear.floor, spec.wear.tip_ratio, spec.wear.exponent) = (shape, floor, tip_ratio, exponent);
        spec.dynamics.contact = contact;
        let module_mm = spec.geometry.module_mm;
        let radius = |gear: u32| module_mm * f64::from(spec.geometry.teeth[gear as usize - 1]) / 2.0;
        spec.wear.table = table
            .iter()
            .map(|(gear, place, depth_um)| WearPoint { gear: *gear, radius_mm: radius(*gear) + place * module_mm, depth_um: *depth_um })
            .collect();
        // A wear history is computed in steps.
        let most = if shape == WearShape::Archard { 0.01 } else { f64::INFINITY };
        let depth_mm = (depth_modules * module_mm).min(most);
        (spec, depth_mm)
    }
}

fn cycle(spec: &PairSpec, depth_mm: f64) -> Result<(f64, MeshCycle), GearError> {
    let pair = spec.resolve()?;
    let wear = FlankWear::from_shape(&pair, depth_mm)?;
    Ok((pair.gears[1].base_radius_mm, MeshCycle::compute(&pair, &wear, 16)?))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_cycle_is_valid_or_rejected((spec, depth_mm) in worn_pairs()) {
        // It is read as it is written.
        prop_assert_eq!(&PairSpec::from_toml(&toml::to_string(&spec).unwrap()).unwrap(), &spec);
        match cycle(&spec, depth_mm) {
            Ok((base_mm, cycle)) => {
                // A pair of steel teeth has about 14 N/(mm µm), a twelfth of E or less; soft are thin rings
                // and light loads.
                let scale = spec.geometry.face_width_mm * 1e-3 * spec.material.youngs_modulus_pa;
                prop_assert!(cycle.stiffness_n_per_m.iter().all(|k| *k > 2e-3 * scale && *k < 0.5 * scale), "{:?}", cycle.stiffness_n_per_m);
                let most_mm = 3.0 * depth_mm + 1e-4;
                prop_assert!(cycle.uste_rad.iter().all(|lag| (-1e-3..=most_mm).contains(&(lag * base_mm))), "{:?}", cycle.uste_rad);
                prop_assert!(cycle.pairs_in_contact.iter().all(|pairs| (1..=30).contains(pairs)));
            }
            Err(refusal) => prop_assert!(matches!(refusal, GearError::Field { .. } | GearError::NoContact { .. }), "{}", refusal),
        }
    }

    #[test]
    fn no_text_makes_the_reader_panic(text in "\\PC{0,200}", key in "(geometry|operation|wear|dynamics|supports)\\.[a-z_]{1,12}", value in "\\PC{0,20}") {
        let _ = PairSpec::from_toml(&text);
        let _ = PairSpec::from_toml(&format!("{key} = {value}"));
    }
}
