//! Locations of recordings and other prerequisites of tests.

use std::path::{Path, PathBuf};

/// Returns the folder `fixtures` of the repository.
#[must_use]
pub fn fixtures() -> PathBuf {
    root().join("fixtures")
}

/// Returns a folder of real recordings, located by `FLANKWATCH_DATA`.
///
/// # Panics
/// If it is missing: tests that need it are `#[ignore]`d, and run only where it exists.
#[must_use]
pub fn recordings(folder: &str) -> PathBuf {
    let given = std::env::var_os("FLANKWATCH_DATA").map(PathBuf::from);
    let path = given.unwrap_or_else(|| root().join("../shared/data")).join(folder);
    needed(path.is_dir().then_some(path), &format!("the folder {folder} of real recordings"))
}

/// Returns a prerequisite of an ignored test.
///
/// # Panics
/// If it is missing.
#[track_caller]
pub fn needed<T>(found: Option<T>, what: &str) -> T {
    found.unwrap_or_else(|| panic!("{what} is missing"))
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}
