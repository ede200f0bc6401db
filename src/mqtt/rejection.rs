//! The rejection of a message, published as JSON: problem details (RFC 9457) with a reference to the message.

use axum::http::StatusCode;
use jiff::Timestamp;
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::recording::RecordingError;
use crate::service::{FailureCause, ServiceError};
use crate::store::StoreError;

/// Media type of a rejection.
pub(super) const MEDIA_TYPE: &str = "application/problem+json";

/// Maximum length of a value quoted in a rejection, in characters.
const MAX_VALUE: usize = 256;

/// Why a message cannot be used. Its status is that of an upload of the same record.
#[derive(Debug, Clone)]
pub(super) struct Rejection(Box<Details>);

#[derive(Debug, Clone, Serialize)]
struct Details {
    #[serde(rename = "type")]
    kind: &'static str,
    title: &'static str,
    status: u16,
    detail: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    field: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    expected: Option<String>,
}

/// A rejection with a reference to its message.
#[derive(Serialize)]
struct RejectedMessage<'a> {
    #[serde(flatten)]
    details: &'a Details,
    topic: &'a str,
    received_at: Timestamp,
    payload_bytes: usize,
    payload_sha256: String,
}

impl Rejection {
    pub(super) fn new(status: u16, detail: impl Into<String>) -> Self {
        let title = StatusCode::from_u16(status).ok().and_then(|status| status.canonical_reason());
        Self(Box::new(Details {
            kind: "about:blank",
            title: title.unwrap_or("Internal Server Error"),
            status,
            detail: detail.into(),
            field: None,
            value: None,
            expected: None,
        }))
    }

    /// Returns the rejection of a field's value.
    pub(super) fn field(status: u16, field: &str, value: &str, expected: &str) -> Self {
        let value: String = value.chars().take(MAX_VALUE).collect();
        Self::new(status, format!("{field} is {value}, expected {expected}"))
            .of_field(field, &value, expected)
    }

    /// Names the field, its value and what was expected.
    fn of_field(mut self, field: &str, value: &str, expected: &str) -> Self {
        self.0.field = Some(field.to_owned());
        self.0.value = Some(value.chars().take(MAX_VALUE).collect());
        self.0.expected = Some(expected.to_owned());
        self
    }

    /// Returns the rejection of a message that cannot be decoded.
    pub(super) fn of_record(error: &RecordingError) -> Self {
        let rejection = Self::new(422, error.to_string());
        match error.invalid_field() {
            Some((field, value, expected)) => rejection.of_field(field, &value, &expected),
            None => rejection,
        }
    }

    /// Returns the reason in words.
    pub(super) fn detail(&self) -> &str {
        &self.0.detail
    }

    /// Returns the payload for the sender, as JSON.
    pub(super) fn to_json(&self, topic: &str, received_at: Timestamp, payload: &[u8]) -> Vec<u8> {
        let sha256 = Sha256::digest(payload);
        let message = RejectedMessage {
            details: &self.0,
            topic,
            received_at,
            payload_bytes: payload.len(),
            payload_sha256: hex::encode(sha256),
        };
        serde_json::to_vec(&message).expect("strings and numbers serialise")
    }
}

/// What to do with a message after an error of the service.
#[derive(Debug)]
pub(super) enum FailureAction {
    /// Reject the message: it can never be used.
    Reject(Rejection),
    /// Retry a few times, then reject: an internal error, which this message may cause.
    RetryThenReject(Rejection),
    /// Retry the message until it succeeds.
    Retry(String),
}

impl From<ServiceError> for FailureAction {
    fn from(error: ServiceError) -> Self {
        let is_damage = matches!(&error, ServiceError::Store(source) if source.is_damage());
        if is_damage || error.cause() == FailureCause::External {
            return Self::Retry(error.to_string());
        }
        let status = match &error {
            ServiceError::Field { field, value, expected } => {
                return Self::Reject(Rejection::field(422, field, value, expected));
            }
            ServiceError::Recording(source) => return Self::Reject(Rejection::of_record(source)),
            ServiceError::StoredWith { field, value, stored } => {
                return Self::Reject(Rejection::new(409, error.to_string()).of_field(field, value, stored));
            }
            ServiceError::StreamFormat { field, value, expected, .. } => {
                return Self::Reject(Rejection::new(409, error.to_string()).of_field(field, value, expected));
            }
            ServiceError::StreamRestarted { first, expected } => {
                let first = first.to_string();
                return Self::Reject(Rejection::field(409, "first_sample_index", &first, expected));
            }
            ServiceError::Store(StoreError::Time(_)) => 422,
            ServiceError::Store(StoreError::AssetUnknown(_)) => 404,
            ServiceError::SensorOfOther { .. } | ServiceError::SensorShared { .. } => 409,
            ServiceError::RawDeleted(_) => 410,
            // An incoming record causes no other errors, unless by an internal error.
            _ => return Self::RetryThenReject(Rejection::new(500, error.to_string())),
        };
        Self::Reject(Rejection::new(status, error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::AssetId;
    use crate::signal::RecordError;

    #[test]
    fn a_rejection_has_the_reason_and_references_the_message() {
        let rejection = Rejection::field(422, "sample_rate_hz", "-1", "a number above 0");
        let time = "2026-01-01T00:00:00Z".parse().unwrap();
        let json: serde_json::Value =
            serde_json::from_slice(&rejection.to_json("flankwatch/p/1/waveform", time, b"abc")).unwrap();
        let expected = serde_json::json!({
            "type": "about:blank", "title": "Unprocessable Entity", "status": 422,
            "detail": "sample_rate_hz is -1, expected a number above 0",
            "field": "sample_rate_hz", "value": "-1", "expected": "a number above 0",
            "topic": "flankwatch/p/1/waveform", "received_at": "2026-01-01T00:00:00Z", "payload_bytes": 3,
            "payload_sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad",
        });
        assert_eq!(json, expected);
    }

    #[test]
    fn a_record_that_cannot_be_used_names_its_field() {
        for (error, field, value) in [
            (RecordError::SampleRate(-8000.0).into(), "sample_rate_hz", "-8000"),
            (
                RecordingError::Field { field: "samples", value: "[]".into(), expected: "a sample".into() },
                "samples",
                "[]",
            ),
        ] {
            let FailureAction::Reject(rejection) = FailureAction::from(ServiceError::Recording(error)) else {
                panic!("{field}")
            };
            assert_eq!(
                (rejection.0.field.as_deref(), rejection.0.value.as_deref()),
                (Some(field), Some(value))
            );
            assert_eq!(rejection.0.status, 422);
        }
    }

    #[test]
    fn a_long_value_is_truncated() {
        let rejection = Rejection::field(400, "topic", &"ä".repeat(300), "a short one");
        assert_eq!(rejection.0.value.map(|value| value.chars().count()), Some(256));
    }

    #[test]
    fn temporary_errors_are_retried() {
        let busy = ServiceError::Busy { what: "the queue of records is full", retry_after_s: 1 };
        assert!(
            matches!(FailureAction::from(busy), FailureAction::Retry(reason) if reason.contains("queue"))
        );
        assert!(matches!(
            FailureAction::from(ServiceError::WorkerLost("decode")),
            FailureAction::RetryThenReject(_)
        ));
        let timeout = StoreError::Database(sqlx::Error::PoolTimedOut);
        assert!(matches!(FailureAction::from(ServiceError::Store(timeout)), FailureAction::Retry(_)));
    }

    #[test]
    fn permanent_errors_are_rejected() {
        let (asset, of) = (AssetId::new("pinion").unwrap(), AssetId::new("wheel").unwrap());
        let action = FailureAction::from(ServiceError::SensorOfOther { asset, of });
        assert!(
            matches!(&action, FailureAction::Reject(rejection) if rejection.0.status == 409),
            "{action:?}"
        );
        let missing = StoreError::ObjectMissing("ab".to_owned());
        assert!(matches!(
            FailureAction::from(ServiceError::Store(missing)),
            FailureAction::RetryThenReject(_)
        ));
    }
}
