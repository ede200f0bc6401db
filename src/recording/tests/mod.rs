//! Whole recordings: the hand-made hostile ones in `fixtures/recordings`, round trips, and the real ones of the data folder.

mod fixtures;
mod memory;
mod real_data;
mod round_trip;
mod tachometers;

use std::path::{Path, PathBuf};

use super::*;
use crate::signal::Record;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/recordings").join(name)
}

/// A folder of real recordings; where it is absent says so, or fails if nothing may be left out.
pub(crate) fn data(folder: &str) -> Option<PathBuf> {
    let base =
        std::env::var_os("FLANKWATCH_DATA").map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let path = base.join(folder);
    if !path.is_dir() {
        assert!(
            std::env::var_os("FLANKWATCH_LEAVE_NOTHING_OUT").is_none(),
            "no real recordings in {}",
            path.display()
        );
        eprintln!("left out: no real recordings in {}", path.display());
        return None;
    }
    Some(path)
}

/// Records and errors of a file, in order.
fn read_all(path: &Path, cut: Option<Cut>) -> Vec<Result<Recorded, String>> {
    match RecordingFile::open(path, RecordDefaults::default(), cut) {
        Ok(file) => file.map(|item| item.map_err(|error| error.to_string())).collect(),
        Err(error) => vec![Err(error.to_string())],
    }
}

fn records(path: &Path) -> Vec<Record> {
    read_all(path, None).into_iter().map(|item| item.unwrap().record).collect()
}
