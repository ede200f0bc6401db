//! Errors as RFC 9457 problem details.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use crate::asset::AssetError;
use crate::estimate::AlarmError;
use crate::recording::RecordingError;
use crate::service::ServiceError;
use crate::store::{FoundDamage, StoreError};

/// The media type of problem details.
const MEDIA_TYPE: &str = "application/problem+json";

/// Maximum number of digits of a number in a message that are written out.
const MAX_DIGITS: usize = 24;

/// A problem with a request.
#[derive(Debug, Clone)]
pub(crate) struct Problem(Box<Details>);

/// A problem with a request (RFC 9457).
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
#[schema(as = Problem)]
pub(crate) struct Details {
    /// Kind of problem: `about:blank`, which refers to the status.
    #[serde(rename = "type")]
    kind: &'static str,
    /// The status as text.
    title: &'static str,
    /// The HTTP status.
    #[serde(serialize_with = "as_number")]
    #[schema(value_type = u16, example = 422)]
    status: StatusCode,
    /// What is wrong, with the value and what was expected.
    #[schema(example = "sample_rate_hz is -1, expected a number above 0")]
    detail: String,
    /// The parameter or field at fault.
    #[serde(skip_serializing_if = "Option::is_none")]
    field: Option<String>,
    /// Its value.
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<String>,
    /// What was expected.
    #[serde(skip_serializing_if = "Option::is_none")]
    expected: Option<String>,
    #[serde(skip)]
    retry_after_s: Option<u32>,
    #[serde(skip)]
    damage: Option<FoundDamage>,
    /// Whether the disk failed, and not the request.
    #[serde(skip)]
    is_of_disk: bool,
}

/// Marks a response that reports damage to the database file.
#[derive(Debug, Clone)]
pub(crate) struct DamageFound(pub(super) FoundDamage);

fn as_number<S: serde::Serializer>(status: &StatusCode, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_u16(status.as_u16())
}

/// Retry delay when the disk is full, which has to be resolved manually.
const NO_ROOM_RETRY_S: u32 = 60;

impl Problem {
    pub(crate) fn new(status: StatusCode, detail: impl Into<String>) -> Self {
        Self(Box::new(Details {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or("Problem"),
            status,
            detail: detail.into(),
            field: None,
            value: None,
            expected: None,
            retry_after_s: None,
            damage: None,
            is_of_disk: false,
        }))
    }

    pub(crate) fn not_found(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, detail)
    }

    /// A query parameter with an invalid value.
    pub(crate) fn query(field: &str, value: impl ToString, expected: &str) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "").with_field(field, value, expected)
    }

    /// A body field with an invalid value.
    pub(crate) fn content(field: &str, value: impl ToString, expected: &str) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, "").with_field(field, value, expected)
    }

    pub(crate) fn too_large(limit: u64) -> Self {
        Self::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            format!("the body is too large, expected at most {limit} bytes"),
        )
    }

    pub(crate) fn busy(detail: impl Into<String>, retry_after_s: u32) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, detail).retry_after(retry_after_s)
    }

    /// The body of the response.
    pub(crate) fn body(&self) -> Vec<u8> {
        serde_json::to_vec(&self.0).unwrap_or_default()
    }

    /// The description of the problem.
    pub(crate) fn detail(&self) -> &str {
        &self.0.detail
    }

    /// Whether the same request can succeed later.
    pub(crate) fn may_pass(&self) -> bool {
        self.is_busy() || self.is_no_room() || self.0.is_of_disk
    }

    /// Whether the same request can succeed in a moment.
    pub(crate) fn is_busy(&self) -> bool {
        self.0.status == StatusCode::SERVICE_UNAVAILABLE
    }

    /// Whether the disk is full.
    pub(crate) fn is_no_room(&self) -> bool {
        self.0.status == StatusCode::INSUFFICIENT_STORAGE
    }

    /// Sets the time after which the same request can succeed.
    pub(crate) fn retry_after(mut self, seconds: u32) -> Self {
        self.0.retry_after_s = Some(seconds);
        self
    }

    /// Whether it names a field.
    pub(crate) fn names_a_field(&self) -> bool {
        self.0.field.is_some()
    }

    /// Sets the field at fault.
    pub(crate) fn of_field(mut self, field: String) -> Self {
        self.0.field = Some(field);
        self
    }

    fn with_field(mut self, field: &str, value: impl ToString, expected: &str) -> Self {
        let value = shortened(&value.to_string());
        if self.0.detail.is_empty() {
            self.0.detail = format!("{field} is {value}, expected {expected}");
        }
        self.0.field = Some(field.to_string());
        self.0.value = Some(value);
        self.0.expected = Some(expected.to_string());
        self
    }

    /// Adds the field that a decoder's message names in backticks, or a field with its value and what was
    /// expected.
    pub(crate) fn naming_field_in(mut self, message: &str) -> Self {
        if let Some((field, rest)) = message.split_once(" is ")
            && field.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '.' | '_'))
            && let Some((value, expected)) = rest.split_once(", expected ")
        {
            // The position follows the expectation
            let expected = expected.split(" at line ").next().unwrap_or(expected);
            return self.with_field(field, value, expected);
        }
        if let Some(field) = name_of_field(message) {
            self.0.field = Some(field.to_string());
        }
        self
    }

    /// Names the field by its path, where the decoder's message has its name alone or none.
    pub(crate) fn at_path(self, message: &str, path: Option<String>) -> Self {
        let Some(path) = path else { return self };
        match name_of_field(message) {
            Some(name) => self.of_field(within(&path, name)),
            None if self.names_a_field() => self,
            None => self.of_field(path),
        }
    }

    /// A recording that cannot be read.
    fn of_record(error: &RecordingError) -> Self {
        let problem = Self::new(StatusCode::UNPROCESSABLE_ENTITY, shortened(&error.to_string()));
        if let Some((field, value, expected)) = error.invalid_field() {
            return problem.with_field(field, value, &expected);
        }
        match error {
            RecordingError::Record(_) => problem.of_field("samples".to_owned()),
            RecordingError::Json { path, source, .. } => {
                let cause = source.to_string();
                problem.naming_field_in(&cause).at_path(&cause, path.clone())
            }
            _ => problem,
        }
    }

    /// An error of the disk, which may be gone later.
    fn of_disk(error: &dyn std::error::Error) -> Self {
        let mut problem = Self::internal(error);
        problem.0.is_of_disk = true;
        problem
    }

    /// An internal error: details, such as paths and SQL, go to the log under a reference, not to the client.
    fn internal(error: &dyn std::error::Error) -> Self {
        let reference = format!("{:08x}", getrandom::u32().unwrap_or_default());
        tracing::error!(reference, error = %error, "request failed");
        let detail = format!("internal error; the log has the cause under reference {reference}");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, detail)
    }
}

/// The name of a missing, unknown or repeated field in a decoder's message.
fn name_of_field(message: &str) -> Option<&str> {
    let is_about_a_field = ["missing field `", "unknown field `", "duplicate field `"]
        .iter()
        .any(|start| message.starts_with(start));
    message.split('`').nth(1).filter(|_| is_about_a_field)
}

/// The path of a field of an object; that of an unknown field may end with its name already.
fn within(path: &str, name: &str) -> String {
    match path == name || path.ends_with(&format!(".{name}")) {
        true => path.to_owned(),
        false => format!("{path}.{name}"),
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let body = self.body();
        let damage = self.0.damage.clone().map(DamageFound);
        let mut response = (self.0.status, [(header::CONTENT_TYPE, MEDIA_TYPE)], body).into_response();
        let is_no_room = self.is_no_room();
        if let Some(seconds) = self.0.retry_after_s.or(is_no_room.then_some(NO_ROOM_RETRY_S)) {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if let Some(damage) = damage {
            response.extensions_mut().insert(damage);
        }
        response
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        let status = match &error {
            StoreError::AssetExists(_) => StatusCode::CONFLICT,
            StoreError::AssetUnknown(_) => StatusCode::NOT_FOUND,
            StoreError::Time(_) => StatusCode::UNPROCESSABLE_ENTITY,
            StoreError::DatabaseDamaged { .. } => StatusCode::SERVICE_UNAVAILABLE,
            error if error.is_damage() => {
                let mut problem = Self::internal(error);
                problem.0.detail = format!("the database is damaged: {error}");
                problem.0.damage = error.found_damage();
                return problem;
            }
            error if error.is_full() => {
                tracing::error!(%error, "disk full");
                StatusCode::INSUFFICIENT_STORAGE
            }
            error if error.is_unavailable() => {
                tracing::warn!(%error, "store unavailable");
                return Self::busy(error.to_string(), 5);
            }
            error if error.is_conflict() => return Self::busy(error.to_string(), 1),
            // These texts name an object or a row, and neither a path nor SQL.
            error if error.is_object_error() || matches!(error, StoreError::Damaged { .. }) => {
                tracing::error!(%error, "request failed");
                StatusCode::INTERNAL_SERVER_ERROR
            }
            error @ StoreError::File { .. } => return Self::of_disk(error),
            error => return Self::internal(error),
        };
        Self::new(status, error.to_string())
    }
}

impl From<ServiceError> for Problem {
    fn from(error: ServiceError) -> Self {
        match error {
            ServiceError::Store(error) => error.into(),
            ServiceError::Busy { retry_after_s, .. } => Self::busy(error.to_string(), retry_after_s),
            ServiceError::DescriptionChanged(_) | ServiceError::UnitChosen { .. } => {
                Self::busy(error.to_string(), 1)
            }
            ServiceError::Precondition(_) => Self::new(StatusCode::PRECONDITION_FAILED, error.to_string()),
            ServiceError::SensorOfOther { .. } | ServiceError::SensorShared { .. } => {
                Self::new(StatusCode::CONFLICT, error.to_string())
            }
            ServiceError::RawDeleted(_) => Self::new(StatusCode::GONE, error.to_string()),
            ServiceError::Recording(ref source) if source.is_full() => {
                Self::new(StatusCode::INSUFFICIENT_STORAGE, error.to_string())
            }
            ServiceError::Recording(RecordingError::McapWrite(_)) => Self::internal(&error),
            ServiceError::Recording(ref source) => Self::of_record(source),
            ServiceError::TooManyRecords(_) => Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string()),
            ServiceError::Field { field, value, expected } => Self::content(field, value, &expected),
            ServiceError::StoredWith { field, ref value, .. } => {
                let mut problem = Self::new(StatusCode::CONFLICT, error.to_string());
                problem.0.field = Some(field.to_string());
                problem.0.value = Some(value.clone());
                problem
            }
            ServiceError::ReplayFile { ref file, .. } => {
                let mut problem = Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string());
                problem.0.field = Some("file".to_string());
                problem.0.value = Some(file.clone());
                problem
            }
            ServiceError::Alarm(AlarmError::State { .. }) => {
                Self::new(StatusCode::CONFLICT, error.to_string())
            }
            ServiceError::Alarm(_) => Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string()),
            ServiceError::StreamFormat { field, ref value, .. } => {
                let mut problem = Self::new(StatusCode::CONFLICT, error.to_string());
                problem.0.field = Some(field.to_owned());
                problem.0.value = Some(value.to_string());
                problem
            }
            ServiceError::StreamRestarted { first, ref expected } => {
                Self::new(StatusCode::CONFLICT, "").with_field("first_index", first, expected)
            }
            ServiceError::StreamHeld { .. } | ServiceError::StreamTaken => {
                Self::new(StatusCode::CONFLICT, error.to_string())
            }
            ServiceError::StreamUnknown { .. }
            | ServiceError::AlarmUnknown(_)
            | ServiceError::MaintenanceUnknown(_)
            | ServiceError::ReplayUnknown(_) => Self::not_found(error.to_string()),
            ServiceError::File { ref source, .. } if source.kind() == std::io::ErrorKind::StorageFull => {
                Self::new(StatusCode::INSUFFICIENT_STORAGE, error.to_string())
            }
            ServiceError::File { .. } => Self::of_disk(&error),
            ServiceError::WorkerLost(_)
            | ServiceError::Threads { .. }
            | ServiceError::QueuedRecordMismatch { .. } => Self::internal(&error),
        }
    }
}

impl From<RecordingError> for Problem {
    fn from(error: RecordingError) -> Self {
        ServiceError::from(error).into()
    }
}

/// A value with its numbers in scientific notation where they have more digits than anyone reads.
pub(crate) fn shortened(value: &str) -> String {
    let word = |word: &str| {
        let digits = word.trim_end_matches([',', ':']);
        match digits.parse::<f64>() {
            Ok(number) if digits.len() > MAX_DIGITS => format!("{number:e}{}", &word[digits.len()..]),
            _ => word.to_owned(),
        }
    };
    value.split(' ').map(word).collect::<Vec<_>>().join(" ")
}

impl From<AssetError> for Problem {
    fn from(error: AssetError) -> Self {
        match &error {
            AssetError::Field { field, value, expected } => Self::content(field, value, expected),
            AssetError::Id(id) => Self::content(
                "id",
                id,
                "1 to 64 characters of a-z, 0-9, - and _, the first a letter or digit",
            ),
            AssetError::Pair(crate::gear::GearError::Field { field, value, expected }) => {
                Self::content(&format!("gear.pair.{field}"), value, expected)
            }
            AssetError::Toml { path, source } => {
                let path = path.clone().filter(|path| path != "." && !path.contains('?'));
                Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string())
                    .naming_field_in(source.message())
                    .at_path(source.message(), path)
            }
            AssetError::Pair(_) => Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_internal_error_shows_no_path_and_no_sql() {
        let file = |kind: std::io::ErrorKind| StoreError::File {
            action: "read",
            path: "/var/lib/flankwatch/raw/ab/ab".into(),
            source: kind.into(),
        };
        let disk = Problem::from(file(std::io::ErrorKind::Other));
        let column = StoreError::Database(sqlx::Error::ColumnIndexOutOfBounds { index: 1, len: 1 });
        let sql = Problem::from(column);
        for problem in [&disk, &sql] {
            assert_eq!(problem.0.status, StatusCode::INTERNAL_SERVER_ERROR);
            assert!(problem.detail().starts_with("internal error; "), "{}", problem.detail());
        }
        assert!(disk.may_pass() && !sql.may_pass());
        let missing = Problem::from(StoreError::ObjectMissing("ab".to_owned()));
        assert_eq!(missing.detail(), "raw object ab is missing");
    }

    #[test]
    fn long_numbers_are_shortened() {
        assert_eq!(shortened(&1e308.to_string()), "1e308");
        assert_eq!(shortened(&format!("1 to {}", 5e-324)), "1 to 5e-324");
        assert_eq!(shortened("12345.678 and a name"), "12345.678 and a name");
        assert_eq!(shortened(&format!("rate is {}, expected", 1e308)), "rate is 1e308, expected");
    }
}
