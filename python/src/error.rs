//! Errors of the computing packages as Python exceptions.

use std::fmt::Display;

use flankwatch_signal::NotComputed;
use flankwatch_wear::library::LibraryError;
use pyo3::PyErr;
use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};

/// A `ValueError` with the error's own words.
pub(crate) fn value_error(error: impl Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A `ValueError` that names the argument, its value and what was expected.
pub(crate) fn argument_error(argument: &str, value: impl Display, expected: &str) -> PyErr {
    PyValueError::new_err(format!("{argument} is {value}, expected {expected}"))
}

/// An `OSError` where the file system refused, a `RuntimeError` where a build was stopped, else a
/// `ValueError`.
pub(crate) fn library_error(error: LibraryError) -> PyErr {
    match error {
        LibraryError::Io { .. } => PyOSError::new_err(error.to_string()),
        LibraryError::Cancelled => PyRuntimeError::new_err(error.to_string()),
        error => value_error(error),
    }
}

/// A `ValueError` that says why a quantity cannot be computed.
pub(crate) fn absence_error(quantity: &str, absence: NotComputed) -> PyErr {
    let reason = match absence {
        NotComputed::NoSpeed => "the shaft speed is neither given nor found in the spectrum",
        NotComputed::TooShort => "the record is too short",
        NotComputed::Constant => "the samples do not vary",
        NotComputed::AboveNyquist => "the frequency lies above half the sampling rate",
        NotComputed::TooFewTurns => "the record has fewer than 4 whole turns of the shaft",
        NotComputed::SpeedVaries => "the shaft speed varies too much",
        NotComputed::Clipped => "samples stand at the converter's limit",
        NotComputed::Gaps => "samples are missing",
        NotComputed::NoSignal => "the signal to divide by is zero",
        NotComputed::NotAcceleration => "the unit is neither one of acceleration nor of velocity",
        NotComputed::AboveEnvelope => "the frequency lies above the width of the envelope's band",
        NotComputed::OtherMesh => "a line of another mesh lies there",
    };
    PyValueError::new_err(format!("no {quantity}: {reason}"))
}
