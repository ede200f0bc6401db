//! Errors of libraries.

use flankwatch_gear::GearError;
use flankwatch_signal::RecordError;
use thiserror::Error;

/// Why a library could not be built, read or written.
#[derive(Debug, Error)]
pub enum LibraryError {
    /// A setting of the grid is invalid.
    #[error("library {field} is {value}, expected {expected}")]
    Grid {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: String,
        /// The expected value.
        expected: &'static str,
    },
    /// The gear model rejected the pair.
    #[error("the gear pair cannot be simulated: {0}")]
    Gear(#[source] GearError),
    /// The model's response is not a valid record.
    #[error("the simulated response of wear state {index} is not usable: {source}")]
    Response {
        /// Index of the wear state.
        index: usize,
        /// The cause.
        source: RecordError,
    },
    /// The build was cancelled.
    #[error("stopped before the library was complete")]
    Cancelled,
    /// The file is not a library, or it was changed after it was written.
    #[error("damaged library file: {0}")]
    Damaged(String),
    /// The file has another format version.
    #[error("library format version {found}, expected {expected}")]
    Version {
        /// The version found.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// The file system returned an error.
    #[cfg(feature = "files")]
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: std::path::PathBuf,
        /// The cause.
        source: std::io::Error,
    },
}

impl From<GearError> for LibraryError {
    fn from(error: GearError) -> Self {
        match error {
            GearError::Stopped => Self::Cancelled,
            error => Self::Gear(error),
        }
    }
}
