//! What not every machine has. A test that needs it says so and is left out, or fails where nothing may be left out.

use std::path::{Path, PathBuf};

/// Something that is there, or a line that says what the test was left out for.
pub(crate) fn unless_absent<T>(found: Option<T>, what: &str) -> Option<T> {
    if found.is_none() {
        assert!(std::env::var_os("FLANKWATCH_LEAVE_NOTHING_OUT").is_none(), "{what} is missing");
        eprintln!("left out: {what} is missing");
    }
    found
}

/// A folder of real recordings.
pub(crate) fn recordings(folder: &str) -> Option<PathBuf> {
    let given = std::env::var_os("FLANKWATCH_DATA").map(PathBuf::from);
    let base = given.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"));
    let path = base.join(folder);
    unless_absent(path.is_dir().then_some(path), &format!("the folder {folder} of real recordings"))
}
