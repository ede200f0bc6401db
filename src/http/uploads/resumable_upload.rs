//! A resumable upload as returned by the API.

use axum::http::StatusCode;
use jiff::Timestamp;
use serde::Serialize;

use crate::asset::AssetId;
use crate::http::problem::Problem;
use crate::store::{StoredUpload, UploadState};

/// A resumable upload.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub(crate) struct ResumableUpload {
    /// Identifier.
    pub(crate) id: String,
    /// The asset whose records it holds.
    pub(crate) asset: AssetId,
    /// Its length in bytes.
    pub(crate) length: u64,
    /// Bytes received.
    pub(crate) offset: u64,
    /// Its state.
    pub(crate) state: UploadState,
    /// When it expires without further bytes.
    pub(crate) expires_at: Timestamp,
    /// Why processing is delayed: waiting for its turn, or the disk is full. In a cluster, only the node that
    /// processes the upload reports it.
    pub(crate) waits_for: Option<String>,
    /// The result of its records, once finished.
    #[schema(value_type = Option<Object>)]
    pub(crate) result: Option<serde_json::Value>,
    /// Why it failed.
    pub(crate) error: Option<String>,
}

impl ResumableUpload {
    /// Converts a stored upload; `waits_for` is what its processing in this process waits for.
    pub(crate) fn new(stored: StoredUpload, waits_for: Option<String>) -> Self {
        Self {
            id: stored.id,
            asset: stored.asset,
            length: stored.length,
            offset: stored.received,
            state: stored.state,
            expires_at: stored.expires_at,
            waits_for,
            result: stored.result.and_then(|text| serde_json::from_str(&text).ok()),
            error: stored.error,
        }
    }

    /// Rejects bytes at any offset but the next one.
    pub(crate) fn check_offset(&self, at: u64) -> Result<(), Problem> {
        if self.state == UploadState::Receiving && self.offset == at {
            return Ok(());
        }
        let detail = match self.state {
            UploadState::Receiving => {
                format!("upload-offset is {at}, expected {} of {}", self.offset, self.length)
            }
            _ => "the upload is complete: GET returns its result".to_owned(),
        };
        Err(Problem::new(StatusCode::CONFLICT, detail))
    }
}
