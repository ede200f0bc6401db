//! Whole recordings: the hand-made hostile ones in `fixtures/recordings`, round trips, and the real ones of
//! the data folder.

mod csv_columns;
mod fixtures;
mod flac;
mod matlab;
mod memory;
mod numpy;
mod real_data;
mod round_trip;
mod tachometers;

use std::path::{Path, PathBuf};

use super::*;
use flankwatch_signal::Record;
use flankwatch_test_support::{fixtures, recordings};

fn fixture(name: &str) -> PathBuf {
    fixtures().join("recordings").join(name)
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
