//! Conversion of Python arguments, and of results to Python.

use jiff::Timestamp;
use numpy::{PyArrayDyn, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::{argument_error, value_error};

/// Samples of one channel in single precision: those of a NumPy array, or a copy of samples of another type.
pub(crate) enum Samples<'py> {
    Borrowed(PyReadonlyArray1<'py, f32>),
    Copied(Vec<f32>),
}

impl<'py> Samples<'py> {
    /// Accepts anything that NumPy converts to an array of real numbers.
    pub(crate) fn new(x: &Bound<'py, PyAny>) -> PyResult<Self> {
        if let Ok(array) = x.extract::<PyReadonlyArray1<'_, f32>>() {
            if array.as_slice().is_ok() {
                return Ok(Self::Borrowed(array));
            }
            return Ok(Self::Copied(array.as_array().iter().copied().collect()));
        }
        let real = real_array(x, "x", 1)?;
        let real = real.readonly();
        Ok(Self::Copied(real.as_array().iter().map(|&sample| sample as f32).collect()))
    }

    pub(crate) fn as_slice(&self) -> PyResult<&[f32]> {
        match self {
            Self::Borrowed(array) => array.as_slice().map_err(value_error),
            Self::Copied(samples) => Ok(samples),
        }
    }
}

/// Returns an array of real numbers in double precision with this number of dimensions.
pub(crate) fn real_array<'py>(
    x: &Bound<'py, PyAny>,
    name: &str,
    dimensions: usize,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let array = x.py().import("numpy")?.call_method1("asarray", (x,))?;
    let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    let found: usize = array.getattr("ndim")?.extract()?;
    if found != dimensions || !["f", "i", "u"].contains(&kind.as_str()) {
        let (shape, dtype) = (array.getattr("shape")?, array.getattr("dtype")?);
        return Err(PyValueError::new_err(format!(
            "{name} has shape {shape} and type {dtype}, expected real numbers in {dimensions} dimension{}",
            if dimensions == 1 { "" } else { "s" }
        )));
    }
    Ok(array.call_method1("astype", ("float64",))?.cast_into::<PyArrayDyn<f64>>()?)
}

/// Returns a time from RFC 3339 text, a `datetime` (UTC if it has no zone), a `numpy.datetime64` (UTC), or
/// seconds since 1970.
pub(crate) fn time(value: &Bound<'_, PyAny>) -> PyResult<Timestamp> {
    let expected = "an RFC 3339 time, a datetime, a numpy.datetime64 or seconds since 1970";
    let refuse = || {
        argument_error(
            "time",
            value.repr().map_or_else(|_| "?".to_owned(), |text| text.to_string()),
            expected,
        )
    };
    if let Ok(seconds) = value.extract::<i64>() {
        return Timestamp::from_second(seconds).map_err(|_| refuse());
    }
    let text = if let Ok(text) = value.extract::<String>() {
        text
    } else if value.hasattr("isoformat")? {
        let text: String = value.call_method0("isoformat")?.extract()?;
        let zoned = value.getattr("tzinfo").is_ok_and(|zone| !zone.is_none());
        if zoned { text } else { text + "Z" }
    } else if value.hasattr("dtype")? && value.getattr("dtype")?.getattr("kind")?.extract::<String>()? == "M"
    {
        let numpy = value.py().import("numpy")?;
        numpy.call_method1("datetime_as_string", (value,))?.extract::<String>()? + "Z"
    } else {
        let seconds: f64 = value.extract().map_err(|_| refuse())?;
        let nanoseconds = (seconds * 1e9).round();
        return Timestamp::from_nanosecond(nanoseconds as i128)
            .ok()
            .filter(|_| seconds.is_finite())
            .ok_or_else(refuse);
    };
    text.parse().map_err(|_| refuse())
}

/// Converts a value to Python dicts, lists, numbers and strings.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(value_error)?;
    py.import("json")?.call_method1("loads", (text,))
}

/// Converts Python dicts, lists, numbers and strings to a value.
pub(crate) fn from_python<T: DeserializeOwned>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<T> {
    let text: String = value.py().import("json")?.call_method1("dumps", (value,))?.extract()?;
    serde_json::from_str(&text).map_err(|error| PyValueError::new_err(format!("{name}: {error}")))
}
