//! Where tests find recordings and what else they need.

use std::path::{Path, PathBuf};

/// The folder `fixtures` of the repository.
#[must_use]
pub fn fixtures() -> PathBuf {
    root().join("fixtures")
}

/// A folder of real recordings. `FLANKWATCH_DATA` says where to look.
///
/// # Panics
/// Where it is absent: tests that need it are `#[ignore]`d, and whoever asks for them has it.
#[must_use]
pub fn recordings(folder: &str) -> PathBuf {
    let given = std::env::var_os("FLANKWATCH_DATA").map(PathBuf::from);
    let path = given.unwrap_or_else(|| root().join("../shared/data")).join(folder);
    needed(path.is_dir().then_some(path), &format!("the folder {folder} of real recordings"))
}

/// Something that an ignored test needs.
///
/// # Panics
/// Where it is absent.
#[track_caller]
pub fn needed<T>(found: Option<T>, what: &str) -> T {
    found.unwrap_or_else(|| panic!("{what} is missing"))
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}
