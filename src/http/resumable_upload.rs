//! A resumable upload as returned by the API.

use axum::http::StatusCode;
use jiff::Timestamp;
use serde::Serialize;

use super::problem::Problem;
use crate::asset::AssetId;
use crate::store::{StoredUpload, UploadProgress};

/// The state of an upload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum UploadState {
    /// Bytes are missing.
    Receiving,
    /// All bytes have arrived and are being processed.
    Reading,
    /// Its records are stored.
    Finished,
    /// It could not be processed.
    Failed,
}

/// A resumable upload.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub(super) struct ResumableUpload {
    /// Identifier.
    pub(super) id: String,
    /// The asset whose records it holds.
    pub(super) asset: AssetId,
    /// Its length in bytes.
    pub(super) length: u64,
    /// Bytes received.
    pub(super) offset: u64,
    /// Its state.
    pub(super) state: UploadState,
    /// When it expires without further bytes.
    pub(super) expires_at: Timestamp,
    /// Why processing is delayed: waiting for its turn, or the disk is full. In a cluster, only the node that
    /// processes the upload reports it.
    pub(super) waits_for: Option<String>,
    /// The result of its records, once finished.
    #[schema(value_type = Option<Object>)]
    pub(super) result: Option<serde_json::Value>,
    /// Why it failed.
    pub(super) error: Option<String>,
}

impl ResumableUpload {
    /// Converts a stored upload; `waits_for` is what its processing in this process waits for.
    pub(super) fn new(stored: StoredUpload, waits_for: Option<String>) -> Self {
        Self {
            id: stored.id,
            asset: stored.asset,
            length: stored.length,
            offset: stored.received,
            state: match stored.progress {
                UploadProgress::Receiving => UploadState::Receiving,
                UploadProgress::Reading => UploadState::Reading,
                UploadProgress::Finished => UploadState::Finished,
                UploadProgress::Failed => UploadState::Failed,
            },
            expires_at: stored.expires_at,
            waits_for,
            result: stored.result.and_then(|text| serde_json::from_str(&text).ok()),
            error: stored.error,
        }
    }

    /// Rejects bytes at any offset but the next one.
    pub(super) fn check_offset(&self, at: u64) -> Result<(), Problem> {
        if self.state == UploadState::Receiving && self.offset == at {
            return Ok(());
        }
        let detail = format!("upload-offset is {at}, expected {} of {}", self.offset, self.length);
        Err(Problem::new(StatusCode::CONFLICT, detail))
    }
}
