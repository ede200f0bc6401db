//! What can go wrong in a command.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a command failed; the message names the file, address or field.
#[derive(Debug, Error)]
pub enum CliError {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// An argument cannot be used.
    #[error("{0}")]
    Argument(String),
    /// A pair file or wear table cannot be used.
    #[error("{path}: {source}")]
    Pair {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: crate::gear::GearError,
    },
    /// An asset file cannot be used.
    #[error("{path}: {source}")]
    Asset {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: crate::asset::AssetError,
    },
    /// A recording cannot be read or written.
    #[error("{path}: {source}")]
    Recording {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: crate::recording::RecordingError,
    },
    /// Some of several files could not be analysed; each was reported when it happened.
    #[error("{failed} of {all} files could not be read to their end")]
    SomeFailed {
        /// How many failed.
        failed: usize,
        /// How many there were.
        all: usize,
    },
    /// The gear model refused.
    #[error(transparent)]
    Gear(#[from] crate::gear::GearError),
    /// A library could not be built or read.
    #[error(transparent)]
    Library(#[from] crate::library::LibraryError),
    /// The figures could not be made.
    #[error(transparent)]
    Figures(#[from] crate::figures::FiguresError),
    /// A recording could not be converted.
    #[error(transparent)]
    Convert(#[from] super::convert::ConvertError),
    /// A run could not be simulated.
    #[error(transparent)]
    Simulation(#[from] crate::simulation::SimulationError),
    /// The service could not start or go on.
    #[error(transparent)]
    Serve(#[from] super::serve::ServeError),
    /// The demonstration's service could not start or go on.
    #[error(transparent)]
    Service(#[from] crate::http::StartError),
    /// The demonstration's records could not be taken.
    #[error(transparent)]
    Ingest(#[from] crate::service::ServiceError),
    /// Tokens could not be read or kept.
    #[error(transparent)]
    Tokens(#[from] crate::http::TokenError),
    /// A store could not be opened, read or copied.
    #[error(transparent)]
    Store(#[from] crate::store::StoreError),
    /// Something is not as it should be; each was told when it was found.
    #[error("{0} things are not as they should be")]
    Findings(u64),
    /// A server could not be reached or refused.
    #[error("{url}: {reason}")]
    Server {
        /// The address.
        url: String,
        /// What happened.
        reason: String,
    },
}

impl CliError {
    /// For `map_err` on file operations.
    pub(super) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }

    /// For `map_err` on pair files and wear tables.
    pub(super) fn pair(path: &Path) -> impl FnOnce(crate::gear::GearError) -> Self {
        let path = path.to_owned();
        move |source| Self::Pair { path, source }
    }

    /// For `map_err` on recordings.
    pub(super) fn recording(path: &Path) -> impl FnOnce(crate::recording::RecordingError) -> Self {
        let path = path.to_owned();
        move |source| Self::Recording { path, source }
    }
}
