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
    if problem.names_a_field() {
        return match name_of_field(&message).zip(path) {
            Some((name, path)) => problem.of_field(within(&path, name)),
            None => problem,
        };
    }
    match path {
        Some(path) => {
            // The parser's words for a list that is too long.
            let cause = message.replace("trailing characters", "too many elements, expected fewer");
            Problem::new(status, format!("invalid body: {path}: {cause}")).of_field(path)
        }
        None => problem,
    }
}

/// The name of a missing or unknown field in the parser's message.
fn name_of_field(message: &str) -> Option<&str> {
    let is_about_a_field =
        ["missing field `", "unknown field `"].iter().any(|start| message.starts_with(start));
    message.split('`').nth(1).filter(|_| is_about_a_field)
}

/// The path of a field of an object; that of an unknown field may end with its name already.
fn within(path: &str, name: &str) -> String {
    match path == name || path.ends_with(&format!(".{name}")) {
        true => path.to_owned(),
        false => format!("{path}.{name}"),
    }
}

/// The path of the value that does not match; none at the root.
fn path_of<T: DeserializeOwned>(bytes: &[u8]) -> Option<String> {
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let error = serde_path_to_error::deserialize::<_, T>(&mut reader).err()?;
    let path = error.path().to_string();
    (path != "." && !path.contains('?')).then_some(path)
}
