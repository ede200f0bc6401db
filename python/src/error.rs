//! Conversion of errors of the Rust crates to Python exceptions.

use std::fmt::Display;

use flankwatch_signal::NotComputed;
use flankwatch_wear::library::LibraryError;
use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};

/// Returns a `ValueError` with the error's message.
pub(crate) fn value_error(error: impl Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Returns a `ValueError` that names the argument, its value and what was expected.
pub(crate) fn argument_error(argument: &str, value: impl Display, expected: &str) -> PyErr {
    PyValueError::new_err(format!("{argument} is {value}, expected {expected}"))
}

/// Returns an `OSError` for file system errors, a `RuntimeError` for a cancelled build, else a `ValueError`.
pub(crate) fn library_error(error: LibraryError) -> PyErr {
    match error {
        LibraryError::Io { .. } => PyOSError::new_err(error.to_string()),
        LibraryError::Cancelled => PyRuntimeError::new_err(error.to_string()),
        error => value_error(error),
    }
}

/// Returns a `ValueError` with the reason why a quantity cannot be computed.
pub(crate) fn not_computed_error(quantity: &str, reason: NotComputed) -> PyErr {
    let message = match reason {
        NotComputed::NoSpeed => "the shaft speed is neither given nor found in the spectrum",
        NotComputed::TooShort => "the record is too short",
        NotComputed::Constant => "the samples do not vary",
        NotComputed::AboveNyquist => "the frequency lies above half the sampling rate",
        NotComputed::TooFewTurns => "the record has fewer than 4 whole turns of the shaft",
        NotComputed::SpeedVaries => "the shaft speed varies too much",
        NotComputed::Clipped => "samples are at the converter's limit",
        NotComputed::Gaps => "samples are missing",
        NotComputed::NoSignal => "the denominator is zero",
        NotComputed::NotAcceleration => "the unit is neither one of acceleration nor one of velocity",
        NotComputed::AboveEnvelope => "the frequency lies above the range of the band's envelope",
        NotComputed::OtherMesh => "the line coincides with one of another mesh",
        NotComputed::OtherLine => {
            "the record does not separate the line from one of a shaft or of another part of a bearing"
        }
    };
    PyValueError::new_err(format!("no {quantity}: {message}"))
}
