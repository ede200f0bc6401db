//! Errors of the commands.

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
        /// The system's error.
        source: io::Error,
    },
    /// An argument is invalid.
    #[error("{0}")]
    Argument(String),
    /// A pair file or wear table is invalid.
    #[error("{path}: {source}")]
    Pair {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: crate::gear::GearError,
    },
    /// An asset file is invalid.
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
    /// Some files could not be analysed; each error was printed when it occurred.
    #[error("failed to read {failed} of {all} files completely")]
    SomeFailed {
        /// Number of files that failed.
        failed: usize,
        /// Number of files given.
        all: usize,
    },
    /// The gear model rejected its input.
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
    Convert(#[from] super::recordings::convert::ConvertError),
    /// A run could not be simulated.
    #[error(transparent)]
    Simulation(#[from] crate::simulation::SimulationError),
    /// The service could not start or stopped with an error.
    #[error(transparent)]
    Serve(#[from] super::service::serve_error::ServeError),
    /// The demonstration's service could not start or stopped with an error.
    #[error(transparent)]
    Service(#[from] crate::http::StartError),
    /// The demonstration's records could not be ingested.
    #[error(transparent)]
    Ingest(#[from] crate::service::ServiceError),
    /// Tokens could not be read or stored.
    #[error(transparent)]
    Tokens(#[from] crate::http::TokenError),
    /// A store could not be opened, read or copied.
    #[error(transparent)]
    Store(#[from] crate::store::StoreError),
    /// Problems were found; each was printed when it was found.
    #[error("{0} problem{ending} found", ending = if *.0 == 1 { "" } else { "s" })]
    Findings(u64),
    /// A sound card could not be opened or read.
    #[error("--alsa {device}: {reason}")]
    SoundCard {
        /// Its name.
        device: String,
        /// What failed.
        reason: String,
    },
    /// A server could not be reached or rejected the request.
    #[error("{url}: {reason}")]
    Server {
        /// The address.
        url: String,
        /// The connection error, or the server's answer.
        reason: String,
    },
}

impl CliError {
    /// Returns a closure for `map_err` on file operations.
    pub(super) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }

    /// Returns a closure for `map_err` on pair files and wear tables.
    pub(super) fn pair(path: &Path) -> impl FnOnce(crate::gear::GearError) -> Self {
        let path = path.to_owned();
        move |source| Self::Pair { path, source }
    }

    /// Returns a closure for `map_err` on recordings.
    pub(super) fn recording(path: &Path) -> impl FnOnce(crate::recording::RecordingError) -> Self {
        let path = path.to_owned();
        move |source| Self::Recording { path, source }
    }
}
