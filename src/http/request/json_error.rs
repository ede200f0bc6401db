//! Errors of JSON bodies, which name the field at fault.

use axum::http::StatusCode;
use serde::de::{DeserializeOwned, IgnoredAny};

use crate::http::problem::Problem;

/// The problem of a body that does not match the type `T`: 400 if it is not JSON at all, otherwise 422.
pub(crate) fn problem<T: DeserializeOwned>(bytes: &[u8], error: &serde_json::Error) -> Problem {
    let message = error.to_string();
    if serde_json::from_slice::<IgnoredAny>(bytes).is_err() {
        return Problem::new(StatusCode::BAD_REQUEST, format!("invalid body: {message}"));
    }
    let status = StatusCode::UNPROCESSABLE_ENTITY;
    let problem = Problem::new(status, format!("invalid body: {message}")).naming_field_in(&message);
    let path = path_of::<T>(bytes);
    match path {
        Some(path) if !problem.names_a_field() => {
            // The parser's words for a list that is too long.
            let cause = message.replace("trailing characters", "too many elements, expected fewer");
            Problem::new(status, format!("invalid body: {path}: {cause}")).of_field(path)
        }
        path => problem.at_path(&message, path),
    }
}

/// The path of the value that does not match; none at the root.
fn path_of<T: DeserializeOwned>(bytes: &[u8]) -> Option<String> {
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let error = serde_path_to_error::deserialize::<_, T>(&mut reader).err()?;
    let path = error.path().to_string();
    (path != "." && !path.contains('?')).then_some(path)
}
