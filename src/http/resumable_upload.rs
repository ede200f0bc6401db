//! A resumable upload as clients see it.

use axum::http::StatusCode;
use jiff::Timestamp;
use serde::Serialize;

use super::problem::Problem;
use crate::asset::AssetId;
use crate::store::{StoredUpload, UploadProgress};

/// What an upload is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum UploadState {
    /// Bytes are missing.
    Receiving,
    /// All bytes are there and are being read.
    Reading,
    /// Its records are stored.
    Finished,
    /// It could not be read.
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
    /// Bytes that are there.
    pub(super) offset: u64,
    /// What it is doing.
    pub(super) state: UploadState,
    /// When it goes if nothing more comes.
    pub(super) expires_at: Timestamp,
    /// Why it cannot be read now and is read again later: its turn has not come, or the disk is full. In a
    /// cluster only the node that reads it says so.
    pub(super) waits_for: Option<String>,
    /// What became of its records, once it is finished.
    #[schema(value_type = Option<Object>)]
    pub(super) result: Option<serde_json::Value>,
    /// Why it failed.
    pub(super) error: Option<String>,
}

impl ResumableUpload {
    /// One as it is stored; `waits_for` is what its reading waits for in this process.
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

    /// Refuses bytes for another place than the one that comes next.
    pub(super) fn check_offset(&self, at: u64) -> Result<(), Problem> {
        if self.state == UploadState::Receiving && self.offset == at {
            return Ok(());
        }
        let detail = format!("upload-offset is {at}, expected {} of {}", self.offset, self.length);
        Err(Problem::new(StatusCode::CONFLICT, detail))
    }
}
