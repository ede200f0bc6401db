//! Errors of JSON bodies, which name the field at fault.

use axum::http::StatusCode;
use jiff::Timestamp;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde_json::Value;

use super::query::TIME;
use crate::http::problem::Problem;
use crate::recording::json_error_words;

/// The problem of a body that does not match the type `T`: 400 if it is not JSON at all, otherwise 422.
pub(crate) fn problem<T: DeserializeOwned>(bytes: &[u8], error: &serde_json::Error) -> Problem {
    let message = json_error_words(error);
    if serde_json::from_slice::<IgnoredAny>(bytes).is_err() {
        return Problem::new(StatusCode::BAD_REQUEST, format!("invalid body: {message}"));
    }
    let status = StatusCode::UNPROCESSABLE_ENTITY;
    let problem = Problem::new(status, format!("invalid body: {message}")).naming_field_in(&message);
    let path = path_of::<T>(bytes);
    if let Some(path) = &path
        && let Some(text) = time_at::<T>(bytes, path, &message)
    {
        return Problem::content(path, format!("{text:?}"), TIME);
    }
    match path {
        Some(path) if !problem.names_a_field() => {
            // The parser's words for a list that is too long.
            let cause = message.replace("trailing characters", "too many elements, expected fewer");
            Problem::new(status, format!("invalid body: {path}: {cause}")).of_field(path)
        }
        path => problem.at_path(&message, path),
    }
}

/// The text at a path such as `alarms[0].time`, if the message is about a text that is no time where one
/// belongs.
fn time_at<T: DeserializeOwned>(bytes: &[u8], path: &str, message: &str) -> Option<String> {
    let mut body: Value = serde_json::from_slice(bytes).ok()?;
    let mut steps = path.split(['.', '[', ']']).filter(|step| !step.is_empty());
    let value = steps.try_fold(&mut body, |at, step| match at {
        Value::Array(items) => items.get_mut(step.parse::<usize>().ok()?),
        _ => at.get_mut(step),
    })?;
    let text = value.as_str()?.to_owned();
    let error = text.parse::<Timestamp>().err()?;
    // A time belongs there if one is accepted; dates have the same messages.
    *value = Value::from(Timestamp::UNIX_EPOCH.to_string());
    let with_time = serde_json::to_vec(&body).ok()?;
    let is_time =
        message.starts_with(&error.to_string()) && path_of::<T>(&with_time).as_deref() != Some(path);
    is_time.then_some(text)
}

/// The path of the value that does not match; none at the root.
fn path_of<T: DeserializeOwned>(bytes: &[u8]) -> Option<String> {
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let error = serde_path_to_error::deserialize::<_, T>(&mut reader).err()?;
    let path = error.path().to_string();
    (path != "." && !path.contains('?')).then_some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_that_cannot_be_parsed_is_named() {
        #[derive(Debug, serde::Deserialize)]
        struct Event {
            #[serde(rename = "time")]
            _time: Timestamp,
        }
        for value in ["tomorrow", "2026-01-01", "x", ""] {
            let body = format!(r#"[{{"time":"2026-01-01T00:00:00Z"}},{{"time":"{value}"}}]"#);
            let error = serde_json::from_str::<Vec<Event>>(&body).unwrap_err();
            let problem = problem::<Vec<Event>>(body.as_bytes(), &error);
            assert_eq!(problem.detail(), format!("[1].time is {value:?}, expected {TIME}"));
        }
    }
}
