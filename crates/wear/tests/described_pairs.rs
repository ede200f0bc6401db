//! Tests that each pair file in `fixtures/pairs` is valid and has a library over its own range of wear.

use std::fs;
use std::path::Path;

use flankwatch_gear::PairSpec;
use flankwatch_wear::library::{BuildControl, GridSettings, build};

#[test]
fn each_example_has_a_library_of_its_size() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/pairs");
    let mut examples = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "toml") {
            continue;
        }
        let spec = PairSpec::from_toml(&fs::read_to_string(&path).unwrap()).unwrap();
        spec.check().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let grid = GridSettings { states: 3, seconds: 0.5, ..GridSettings::default() };
        let library = build(&spec, &grid.for_pair(&spec), &BuildControl::silent()).unwrap();
        assert!((library.max_wear_um() / spec.geometry.module_mm - 245.0 / 6.0).abs() < 1e-9);
        assert!(library.feature_curves().contains_key("ln_mesh_1"), "{}", path.display());
        examples += 1;
    }
    assert_eq!(examples, 4);
}
