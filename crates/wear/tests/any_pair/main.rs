//! Tests that any plausible pair either has a library and an ensemble, or is rejected at its description with
//! the field, the value and the bound.
//!
//! Draws 48 pairs by default; `FLANKWATCH_PAIRS=500` draws 500.

mod plausible;

use std::sync::Arc;
use std::time::{Duration, Instant};

use flankwatch_gear::{GearError, PairSpec};
use flankwatch_wear::library::{
    BuildControl, DEPTHS, Ensemble, EnsembleSettings, GridSettings, Library, LibraryError, MESH_LINES,
    VARIANTS, build,
};

/// Default number of pairs.
const PAIRS: u64 = 48;
/// Time limit of a build: a quick library takes a tenth of a second of processor time, but it shares its
/// threads with the other test.
const LONGEST: Duration = Duration::from_secs(120);

fn pairs() -> u64 {
    std::env::var("FLANKWATCH_PAIRS")
        .map_or(PAIRS, |pairs| pairs.parse().expect("FLANKWATCH_PAIRS is a number"))
}

/// A library of three wear states of a quarter of a second each, up to the default depth.
fn quick_library(spec: &PairSpec) -> Result<Library, LibraryError> {
    let grid = GridSettings { states: 3, seconds: 0.25, ..GridSettings::default() };
    build(spec, &grid.for_pair(spec), &BuildControl::silent())
}

fn described(number: u64) -> PairSpec {
    let spec = plausible::pair(number);
    let text = toml::to_string(&spec).expect("a pair can be written");
    let read = PairSpec::from_toml(&text).expect("what is written can be read");
    assert_eq!(read, spec, "pair {number} does not survive a round trip");
    spec
}

#[test]
fn each_pair_has_a_library_or_is_rejected_at_its_description() {
    // Sequentially, as a build uses every core.
    let refused: usize = (0..pairs())
        .map(|number| {
            let spec = described(number);
            match spec.check() {
                Ok(_) => {
                    let start = Instant::now();
                    let library = quick_library(&spec)
                        .unwrap_or_else(|error| panic!("pair {number} was accepted: {error}"));
                    assert!(start.elapsed() < LONGEST, "pair {number} took {:?}", start.elapsed());
                    assert_eq!(library.states().len(), 3);
                    0
                }
                Err(GearError::Field { field, value, expected }) => {
                    assert!(
                        field.contains('.') && !value.is_empty() && !expected.is_empty(),
                        "pair {number}"
                    );
                    1
                }
                Err(error) => panic!("pair {number} is rejected without a field: {error}"),
            }
        })
        .sum();
    println!("{refused} of {} pairs are rejected", pairs());
    assert!(refused as u64 * 10 < pairs(), "{refused} of {} plausible pairs are rejected", pairs());
}

/// Builds a group of members around each eighth pair; none of them is skipped.
#[test]
fn each_accepted_pair_has_members_around_it() {
    (0..pairs() / 8).for_each(|number| {
        let spec = described(number);
        if spec.check().is_ok() {
            let library = quick_library(&spec).unwrap();
            let settings = EnsembleSettings { members: VARIANTS };
            let start = Instant::now();
            let ensemble = Ensemble::build(Arc::new(library), &settings, &BuildControl::silent()).unwrap();
            assert_eq!(ensemble.members().len(), VARIANTS, "pair {number}");
            assert!(start.elapsed() < LONGEST, "the members of pair {number} took {:?}", start.elapsed());
            let is_known = |member| {
                let mut cells = (0..MESH_LINES).flat_map(|line| (0..DEPTHS).map(move |depth| (line, depth)));
                cells.all(|(line, depth)| ensemble.change(member, line, depth).is_finite())
            };
            assert!((0..VARIANTS).all(is_known), "pair {number}");
        }
    });
}
