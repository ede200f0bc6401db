//! Errors of `flankwatch convert`.

use std::path::PathBuf;

use thiserror::Error;

use crate::asset::AssetError;
use crate::cli::CliError;
use crate::recording::RecordingError;

/// Errors of a conversion. An existing OUT is unchanged.
#[derive(Debug, Error)]
pub enum ConvertError {
    /// An argument is invalid.
    #[error("{argument} is {value}, expected {expected}")]
    Argument {
        /// Name of the argument.
        argument: &'static str,
        /// Value of the argument.
        value: String,
        /// Description of a valid value.
        expected: String,
    },
    /// A name, a pattern or an option that other commands have too is invalid.
    #[error(transparent)]
    Files(#[from] Box<CliError>),
    /// The asset identifier is invalid.
    #[error("--asset: {0}")]
    Asset(#[from] AssetError),
    /// The file to write exists.
    #[error("{0:?} exists, expected a new file (or --force to replace it)")]
    Exists(PathBuf),
    /// The input cannot be read, or its samples are not a valid record.
    #[error("{path:?}: {source}")]
    Input {
        /// The input file.
        path: PathBuf,
        /// The underlying error.
        source: RecordingError,
    },
    /// The output cannot be written.
    #[error("{path:?}: {source}")]
    Output {
        /// The output file.
        path: PathBuf,
        /// The underlying error.
        source: RecordingError,
    },
}

/// Creates the error for an invalid argument.
pub(super) fn argument(
    argument: &'static str,
    value: impl ToString,
    expected: impl Into<String>,
) -> ConvertError {
    ConvertError::Argument { argument, value: value.to_string(), expected: expected.into() }
}
