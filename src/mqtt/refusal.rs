//! Why a message can never be used, as the JSON that its sender gets: problem details after RFC 9457, with
//! what names the message.

use jiff::Timestamp;
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::service::ServiceError;
use crate::store::StoreError;

/// The media type of a refusal.
pub(super) const MEDIA_TYPE: &str = "application/problem+json";

/// Longest value of a field that is repeated, in characters.
const MAX_VALUE: usize = 256;

/// Why a message cannot be used. The statuses are those that an upload of the same record would be answered
/// with.
#[derive(Debug, Clone)]
pub(super) struct Refusal(Box<Details>);

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

/// A refusal together with the message that it is of.
#[derive(Serialize)]
struct Letter<'a> {
    #[serde(flatten)]
    refusal: &'a Details,
    topic: &'a str,
    received_at: Timestamp,
    payload_bytes: usize,
    payload_sha256: String,
}

impl Refusal {
    pub(super) fn new(status: u16, detail: impl Into<String>) -> Self {
        Self(Box::new(Details {
            kind: "about:blank",
            title: match status {
                400 => "Bad Request",
                404 => "Not Found",
                409 => "Conflict",
                410 => "Gone",
                413 => "Payload Too Large",
                415 => "Unsupported Media Type",
                422 => "Unprocessable Entity",
                _ => "Internal Server Error",
            },
            status,
            detail: detail.into(),
            field: None,
            value: None,
            expected: None,
        }))
    }

    /// A field whose value cannot be used.
    pub(super) fn field(status: u16, field: &str, value: &str, expected: &str) -> Self {
        let value: String = value.chars().take(MAX_VALUE).collect();
        let mut refusal = Self::new(status, format!("{field} is {value}, expected {expected}"));
        refusal.0.field = Some(field.to_owned());
        refusal.0.value = Some(value);
        refusal.0.expected = Some(expected.to_owned());
        refusal
    }

    /// What is wrong, in words.
    pub(super) fn detail(&self) -> &str {
        &self.0.detail
    }

    /// The whole text for the sender.
    pub(super) fn letter(&self, topic: &str, received_at: Timestamp, payload: &[u8]) -> Vec<u8> {
        let sha256 = Sha256::digest(payload);
        let letter = Letter {
            refusal: &self.0,
            topic,
            received_at,
            payload_bytes: payload.len(),
            payload_sha256: hex::encode(sha256),
        };
        // Strings and numbers of this struct always serialise into memory.
        serde_json::to_vec(&letter).expect("plain fields are JSON")
    }
}

/// What follows from an error of the path that records take.
#[derive(Debug)]
pub(super) enum Verdict {
    /// The message can never be used.
    Never(Refusal),
    /// A fault of the program: perhaps of this message, perhaps not.
    Fault(Refusal),
    /// The same message can be taken later.
    Later(String),
}

impl Verdict {
    fn of_store(error: &StoreError) -> Self {
        match error {
            StoreError::AssetUnknown(_) => Self::Never(Refusal::new(404, error.to_string())),
            StoreError::Time(_) => Self::Never(Refusal::new(422, error.to_string())),
            error if error.is_damage() => Self::Later(error.to_string()),
            error if error.may_be_caused_by_record() => Self::Fault(Refusal::new(500, error.to_string())),
            error => Self::Later(error.to_string()),
        }
    }
}

impl From<ServiceError> for Verdict {
    fn from(error: ServiceError) -> Self {
        match error {
            ServiceError::Recording(ref source) if source.is_full() => Self::Later(error.to_string()),
            ServiceError::Recording(_) => Self::Never(Refusal::new(422, error.to_string())),
            ServiceError::Field { field, value, expected } => {
                Self::Never(Refusal::field(422, field, &value, expected))
            }
            // Full, busy or away: what is wrong concerns every message.
            ServiceError::Busy { .. } | ServiceError::DescriptionChanged(_) | ServiceError::File { .. } => {
                Self::Later(error.to_string())
            }
            ServiceError::Store(source) => Self::of_store(&source),
            ServiceError::SensorOfOther { .. } | ServiceError::SensorShared { .. } => {
                Self::Never(Refusal::new(409, error.to_string()))
            }
            ServiceError::RawDeleted(_) => Self::Never(Refusal::new(410, error.to_string())),
            // None of these is of a record that comes, but for a fault of the program.
            ServiceError::WorkerLost(_)
            | ServiceError::QueuedRecordMismatch { .. }
            | ServiceError::Precondition(_)
            | ServiceError::ReplayFile { .. }
            | ServiceError::ReplayUnknown(_)
            | ServiceError::StreamUnknown { .. }
            | ServiceError::StreamFormat { .. }
            | ServiceError::StreamTaken
            | ServiceError::StreamsShared
            | ServiceError::AlarmUnknown(_)
            | ServiceError::Alarm(_)
            | ServiceError::MaintenanceUnknown(_) => Self::Fault(Refusal::new(500, error.to_string())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::AssetId;

    #[test]
    fn a_letter_has_the_reason_and_names_the_message() {
        let refusal = Refusal::field(422, "sample_rate_hz", "-1", "a number above 0");
        let time = "2026-01-01T00:00:00Z".parse().unwrap();
        let letter: serde_json::Value =
            serde_json::from_slice(&refusal.letter("flankwatch/p/1/waveform", time, b"abc")).unwrap();
        let expected = serde_json::json!({
            "type": "about:blank", "title": "Unprocessable Entity", "status": 422,
            "detail": "sample_rate_hz is -1, expected a number above 0",
            "field": "sample_rate_hz", "value": "-1", "expected": "a number above 0",
            "topic": "flankwatch/p/1/waveform", "received_at": "2026-01-01T00:00:00Z", "payload_bytes": 3,
            "payload_sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad",
        });
        assert_eq!(letter, expected);
    }

    #[test]
    fn a_long_value_is_cut() {
        let refusal = Refusal::field(400, "topic", &"ä".repeat(300), "a short one");
        assert_eq!(refusal.0.value.map(|value| value.chars().count()), Some(256));
    }

    #[test]
    fn what_passes_is_not_refused() {
        let busy = ServiceError::Busy { what: "the queue of records is full", retry_after_s: 1 };
        assert!(matches!(Verdict::from(busy), Verdict::Later(reason) if reason.contains("queue")));
        assert!(matches!(Verdict::from(ServiceError::WorkerLost("decode")), Verdict::Fault(_)));
        let away = StoreError::Database(sqlx::Error::PoolTimedOut);
        assert!(matches!(Verdict::from(ServiceError::Store(away)), Verdict::Later(_)));
    }

    #[test]
    fn what_stays_wrong_is_refused() {
        let (asset, of) = (AssetId::new("pinion").unwrap(), AssetId::new("wheel").unwrap());
        let verdict = Verdict::from(ServiceError::SensorOfOther { asset, of });
        assert!(matches!(&verdict, Verdict::Never(refusal) if refusal.0.status == 409), "{verdict:?}");
        let missing = StoreError::ObjectMissing("ab".to_owned());
        assert!(matches!(Verdict::from(ServiceError::Store(missing)), Verdict::Fault(_)));
    }
}
