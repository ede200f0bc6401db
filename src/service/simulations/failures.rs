//! Reasons why libraries could not be simulated, stored beside them, so that a restart does not repeat a
//! simulation that would fail again.

use std::fs;
use std::io;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// A failure is valid only for this version: another one may be able to simulate the library.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The failures in a folder, a file for each library.
#[derive(Debug, Clone)]
pub(super) struct Failures {
    folder: PathBuf,
}

#[derive(Debug, Serialize, Deserialize)]
struct Failure {
    version: String,
    reason: String,
}

impl Failures {
    /// The failures in a folder, which is created with the first failure.
    pub(super) fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Why this version of the program could not simulate a library; `None` if it has not tried, or if the
    /// file cannot be read.
    pub(super) fn reason(&self, library: &str) -> Option<String> {
        let bytes = fs::read(self.path(library)).ok()?;
        let failure: Failure = serde_json::from_slice(&bytes).ok()?;
        (failure.version == VERSION).then_some(failure.reason)
    }

    /// Stores a failure. If that fails, the next start simulates the library again.
    pub(super) fn store(&self, library: &str, reason: &str) {
        let failure = Failure { version: VERSION.to_owned(), reason: reason.to_owned() };
        let written = serde_json::to_vec(&failure).map_err(io::Error::from).and_then(|bytes| {
            fs::create_dir_all(&self.folder)?;
            fs::write(self.path(library), bytes)
        });
        if let Err(error) = written {
            tracing::warn!(library, %error, "failed to store the failure of a simulation; the next start repeats the simulation");
        }
    }

    /// Removes the failure of a library, so that it is simulated again.
    pub(super) fn remove(&self, library: &str) {
        match fs::remove_file(self.path(library)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::warn!(library, %error, "failed to remove the failure of a simulation; the simulation is not repeated");
            }
            _ => {}
        }
    }

    fn path(&self, library: &str) -> PathBuf {
        self.folder.join(library).with_extension("json")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_is_valid_for_its_version_only() {
        let folder = tempfile::tempdir().unwrap();
        let failures = Failures::new(folder.path().join("failures"));
        assert_eq!(failures.reason("a1"), None);
        failures.store("a1", "no candidate");
        assert_eq!(failures.reason("a1").as_deref(), Some("no candidate"));
        let path = failures.path("a1");
        let other = fs::read_to_string(&path).unwrap().replace(VERSION, "0.0.0-other");
        fs::write(&path, other).unwrap();
        assert_eq!(failures.reason("a1"), None);
        fs::write(&path, "{\"version").unwrap();
        assert_eq!(failures.reason("a1"), None);
        failures.remove("a1");
        failures.remove("a1");
        assert!(!path.exists());
    }
}
