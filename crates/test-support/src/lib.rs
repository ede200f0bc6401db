//! Where tests find recordings, and what becomes of a test whose recordings or tools a machine does not have.

use std::path::{Path, PathBuf};

/// The folder `fixtures` of the repository.
#[must_use]
pub fn fixtures() -> PathBuf {
    root().join("fixtures")
}

/// A folder of real recordings, where it is there. `FLANKWATCH_DATA` says where to look.
///
/// # Panics
/// As [`unless_absent`].
#[must_use]
pub fn recordings(folder: &str) -> Option<PathBuf> {
    let given = std::env::var_os("FLANKWATCH_DATA").map(PathBuf::from);
    let path = given.unwrap_or_else(|| root().join("../shared/data")).join(folder);
    unless_absent(path.is_dir().then_some(path), &format!("the folder {folder} of real recordings"))
}

/// Something that is there; otherwise a line that says what the test is skipped for.
///
/// # Panics
/// Where it is absent and `FLANKWATCH_LEAVE_NOTHING_OUT` is set.
pub fn unless_absent<T>(found: Option<T>, what: &str) -> Option<T> {
    if found.is_none() {
        assert!(std::env::var_os("FLANKWATCH_LEAVE_NOTHING_OUT").is_none(), "{what} is missing");
        eprintln!("left out: {what} is missing");
    }
    found
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}
