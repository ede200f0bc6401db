//! An upload that comes in pieces, as clients see it.

use axum::http::StatusCode;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use crate::asset::AssetId;
use crate::http::problem::Problem;
use crate::http::uploads::UploadAnswer;

/// How long an upload that does not go on is kept, and how long it is known what became of one.
pub(super) const KEPT: SignedDuration = SignedDuration::from_hours(24);

/// What an upload is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::http) enum UploadState {
    /// Bytes are missing.
    Receiving,
    /// All bytes are there and are being read.
    Reading,
    /// Its records are stored.
    Finished,
    /// It could not be read.
    Failed,
}

impl UploadState {
    /// Whether it is under way, and so counts among the uploads at once.
    pub(super) fn is_open(self) -> bool {
        matches!(self, Self::Receiving | Self::Reading)
    }
}

/// A resumable upload.
#[derive(Debug, Clone, Serialize, Deserialize, utoipa::ToSchema)]
pub(in crate::http) struct ResumableUpload {
    /// Identifier.
    pub(in crate::http) id: String,
    /// The asset whose records it holds.
    pub(super) asset: AssetId,
    /// Its length in bytes.
    pub(in crate::http) length: u64,
    /// Bytes that are there.
    pub(in crate::http) offset: u64,
    /// What it is doing.
    pub(super) state: UploadState,
    /// When it goes if nothing more comes.
    pub(in crate::http) expires_at: Timestamp,
    /// Why it cannot be read now and is read again later: its turn has not come, or the disk is full. A cluster does not say it.
    pub(super) waits_for: Option<String>,
    /// What became of its records, once it is finished.
    #[schema(value_type = Option<Object>)]
    pub(super) result: Option<serde_json::Value>,
    /// Why it failed.
    pub(super) error: Option<String>,
}

impl ResumableUpload {
    /// One of which nothing has come.
    pub(super) fn new(id: String, asset: AssetId, length: u64, now: Timestamp) -> Self {
        Self {
            id,
            asset,
            length,
            offset: 0,
            state: UploadState::Receiving,
            expires_at: now + KEPT,
            waits_for: None,
            result: None,
            error: None,
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

    /// Whether all bytes are there and nobody reads it.
    pub(super) fn is_unread(&self) -> bool {
        self.state == UploadState::Receiving && self.offset == self.length
    }

    /// Notes what became of its reading, which is kept for those who ask.
    pub(super) fn end(&mut self, taken: Result<UploadAnswer, Problem>, now: Timestamp) {
        self.expires_at = now + KEPT;
        self.waits_for = None;
        match taken {
            Ok(taken) => {
                self.state = UploadState::Finished;
                self.result = serde_json::to_value(taken).ok();
            }
            Err(problem) => {
                self.state = UploadState::Failed;
                self.error = Some(problem.detail().to_string());
            }
        }
    }
}
