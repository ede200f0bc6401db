//! Every pair file of `fixtures/pairs/bad` is rejected with the field, its value and the limit.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use super::{ContactRule, FlankWear, GearError, MeshCycle, PairSpec};

/// Default greatest wear of a library, in mm.
const LIBRARY_WEAR_MM: f64 = 0.245;

/// File, field, value, and the part of the expectation that names the limit.
const REFUSALS: [(&str, &str, &str, &str); 17] = [
    ("undercut", "geometry.teeth", "12", "at least 17 teeth on gear 1"),
    ("pointed-rack", "geometry.dedendum", "2.2", "less than 2.1579"),
    ("pointed-tip", "geometry.addendum", "1", "below 0.1 it is pointed"),
    ("no-contact", "geometry.centre_distance_mm", "163", "less than 162.0000"),
    (
        "contact-ratio-below-1",
        "geometry.addendum",
        "[0.4, 0.4]",
        "at least 1 is needed for continuous contact",
    ),
    ("jammed", "geometry.centre_distance_mm", "149", "at least 150.0000"),
    ("wear-deeper-than-tooth", "wear depth in mm", "0.245", "half of the tooth is"),
    ("zero-torque", "operation.torque_nm", "0", "above 0"),
    ("nan-torque", "operation.torque_nm", "NaN", "above 0"),
    ("infinite-speed", "operation.shaft_speed_hz", "inf", "at most 10000"),
    ("nan-module", "geometry.module_mm", "NaN", "at most 200"),
    ("nan-bore", "geometry.bore_radius_mm", "NaN", "above 0"),
    ("nan-wear", "wear.floor", "NaN", "from 0 to 1"),
    ("negative-wear-coefficient", "wear.coefficient", "-0.000001", "above 0"),
    ("wear-pressure-exponent", "wear.pressure_exponent", "9", "from 0.3 to 3"),
    ("nan-hardness", "wear.hardness_pa", "NaN", "from 1000000 to 1000000000000"),
    ("wear-table-without-depth", "wear.table", "1 points", "at least one depth above 0"),
];

/// The file whose wear separates rigid teeth.
const OUT_OF_CONTACT: &str = "worn-out-of-contact";

#[test]
fn bad_pair_files_are_rejected_with_field_value_and_limit() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/pairs/bad");
    for (name, wanted_field, wanted_value, limit) in REFUSALS {
        let text = fs::read_to_string(folder.join(name).with_extension("toml")).unwrap();
        let refusal = PairSpec::from_toml(&text)
            .unwrap()
            .resolve()
            .and_then(|pair| FlankWear::from_shape(&pair, LIBRARY_WEAR_MM))
            .unwrap_err();
        let GearError::Field { field, value, expected } = &refusal else {
            panic!("{name}: {refusal}");
        };
        assert_eq!((*field, value.as_str()), (wanted_field, wanted_value), "{name}: {refusal}");
        assert!(expected.contains(limit), "{name}: {refusal}");
    }
    let names = REFUSALS.iter().map(|(name, ..)| *name).chain([OUT_OF_CONTACT]);
    let listed: BTreeSet<String> = names.map(|name| format!("{name}.toml")).collect();
    let present =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(present.collect::<BTreeSet<_>>(), listed);
}

/// Under the threshold rule a part of the period has no contact; under loaded contact the tip edges bridge
/// it.
#[test]
fn wear_that_separates_rigid_teeth_is_rejected() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/pairs/bad").join(OUT_OF_CONTACT);
    let mut spec = PairSpec::from_toml(&fs::read_to_string(path.with_extension("toml")).unwrap()).unwrap();
    let cycle = |spec: &PairSpec| {
        let pair = spec.resolve()?;
        MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, LIBRARY_WEAR_MM)?, 64)
    };
    let refusal = cycle(&spec).unwrap_err();
    assert!(
        matches!(refusal, GearError::NoContact { phi1_rad } if (-0.28..0.0).contains(&phi1_rad)),
        "{refusal}"
    );
    assert!(refusal.to_string().contains("expected less wear"), "{refusal}");
    spec.dynamics.contact = ContactRule::Loaded;
    assert!(cycle(&spec).unwrap().pairs_in_contact.iter().all(|pairs| *pairs > 0));
}
