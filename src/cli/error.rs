//! Errors of the commands.

use std::error::Error;
use std::fmt::Display;
use std::path::{Path, PathBuf};

use crate::gear::GearError;
use crate::recording::RecordingError;

/// Why a command failed; the message names the file, address or field.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// A file or folder could not be read or written, or what it contains is invalid.
    #[error("{path}: {source}")]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What failed, or is wrong with it.
        source: Box<dyn Error + Send + Sync>,
    },
    /// An argument is invalid.
    #[error("{0}")]
    Argument(String),
    /// A setting or an option cannot be used.
    #[error(transparent)]
    Setting(#[from] crate::settings::SettingError),
    /// Some files could not be analysed or sent; each error was printed when it occurred.
    #[error("{failed} of {all} files could not be {action}")]
    SomeFailed {
        /// What was not done, as a participle.
        action: &'static str,
        /// Number of files that failed.
        failed: usize,
        /// Number of files given.
        all: usize,
    },
    /// The gear model rejected its input.
    #[error(transparent)]
    Gear(#[from] GearError),
    /// A library could not be built or read.
    #[error(transparent)]
    Library(#[from] crate::library::LibraryError),
    /// The figures could not be made.
    #[error(transparent)]
    Figures(#[from] crate::figures::FiguresError),
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
        /// The connection error, or the server's response.
        reason: String,
    },
}

impl CliError {
    /// Returns a closure for `map_err` on what is done with a file or folder.
    pub(super) fn file<E: Into<Box<dyn Error + Send + Sync>>>(path: impl AsRef<Path>) -> impl Fn(E) -> Self {
        let path = path.as_ref().to_owned();
        move |source| Self::File { path: path.clone(), source: source.into() }
    }

    /// Returns a closure for `map_err` on reading a recording; the message names the option for what it
    /// lacks.
    pub(super) fn recording(path: &Path) -> impl Fn(RecordingError) -> Self {
        let failed = Self::file::<Box<dyn Error + Send + Sync>>(path);
        move |error| {
            let option = match &error {
                // The path is named already.
                RecordingError::Open { source, .. } => return failed(source.to_string().into()),
                RecordingError::Wav { field: "sample rate", .. } => "--rate",
                RecordingError::Field { field: "the sampling rate" | "sample rate", .. } => "--rate",
                RecordingError::Field { field: "the cut", .. } => "--record-seconds",
                _ => return failed(error.into()),
            };
            failed(format!("{error} (see {option})").into())
        }
    }

    /// Creates the error for the option that sets a field.
    pub(super) fn option(field: &str, value: impl Display, expected: impl Display) -> Self {
        let option = match field {
            "sample_rate_hz" => "rate".to_owned(),
            "interval_s" => "interval".to_owned(),
            "seconds × sample_rate_hz" => "seconds × --rate".to_owned(),
            field => field.replace('_', "-"),
        };
        Self::argument(&format!("--{option}"), value, expected)
    }

    /// Creates the error for a wear depth that the gear model refuses, which an option gave in another unit.
    pub(super) fn wear(option: &str, value: impl Display, error: GearError) -> Self {
        match error {
            GearError::Field { field: "wear depth in mm", value: depth_mm, expected } => {
                Self::argument(option, value, format!("{expected} (the depth is {depth_mm} mm)"))
            }
            GearError::Field { field: "turns", expected, .. } => Self::argument(option, value, expected),
            error => error.into(),
        }
    }

    /// Creates the error for a data folder that does not exist.
    pub(super) fn no_data_folder(folder: &Path) -> Self {
        Self::argument("--data-dir", folder.display(), "an existing data folder")
    }

    /// Creates the error for an invalid argument.
    pub(super) fn argument(name: &str, value: impl Display, expected: impl Display) -> Self {
        Self::Argument(format!("{name} is {value}, expected {expected}"))
    }
}
