//! Resumable uploads: where they are kept while they come, and their reading when they are whole.
//!
//! One machine keeps a file that grows. Where processes share a store, what has come is in the store, so that any of them goes on with it.

mod folder;
mod shared;

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use axum::body::Body;
use axum::http::StatusCode;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use super::body::SpooledBody;
use super::problem::Problem;
use super::router::App;
use super::uploads::{self, UploadAnswer};
use crate::asset::AssetId;
use folder::FolderUploads;
use shared::SharedUploads;

/// How long an upload that does not go on is kept.
const KEPT: SignedDuration = SignedDuration::from_hours(24);

/// Waits before an upload is read again that could not be read now.
const READ_AGAIN: Duration = Duration::from_secs(1);

/// What an upload is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
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
#[derive(Debug, Clone, Serialize, Deserialize, utoipa::ToSchema)]
pub(in crate::http) struct ResumableUpload {
    /// Identifier.
    pub(in crate::http) id: String,
    /// The asset whose records it holds.
    asset: AssetId,
    /// Its length in bytes.
    pub(in crate::http) length: u64,
    /// Bytes that are there.
    pub(in crate::http) offset: u64,
    /// What it is doing.
    state: UploadState,
    /// When it goes if nothing more comes.
    pub(in crate::http) expires_at: Timestamp,
    /// What became of its records, once it is finished.
    #[schema(value_type = Option<Object>)]
    result: Option<serde_json::Value>,
    /// Why it failed.
    error: Option<String>,
}

/// All resumable uploads.
#[derive(Debug)]
pub(super) enum ResumableUploads {
    /// Of one machine.
    Folder(FolderUploads),
    /// Of all processes on a store.
    Shared(SharedUploads),
}

impl ResumableUploads {
    /// Those of one machine; takes up what is in the folder.
    pub(super) fn open(folder: PathBuf, most_bytes: u64) -> io::Result<Self> {
        Ok(Self::Folder(FolderUploads::open(folder, most_bytes)?))
    }

    /// Those of all processes on a store.
    pub(super) fn shared(most_bytes: u64) -> Self {
        Self::Shared(SharedUploads::new(most_bytes))
    }

    /// Goes on with what other processes have left, in the background.
    pub(super) fn watch(app: &App) {
        if let Self::Shared(_) = &*app.resumable {
            tokio::spawn(shared::watch(app.clone()));
        }
    }

    /// The longest that is taken.
    pub(super) fn most_bytes(&self) -> u64 {
        match self {
            Self::Folder(uploads) => uploads.most_bytes(),
            Self::Shared(uploads) => uploads.most_bytes(),
        }
    }

    /// Begins an upload for an asset that is there.
    pub(super) async fn begin(&self, app: &App, asset: AssetId, length: u64) -> Result<ResumableUpload, Problem> {
        let mut random = [0; 12];
        getrandom::fill(&mut random).map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
        let upload = ResumableUpload {
            id: random.iter().map(|byte| format!("{byte:02x}")).collect(),
            asset,
            length,
            offset: 0,
            state: UploadState::Receiving,
            expires_at: app.ingest.now() + KEPT,
            result: None,
            error: None,
        };
        match self {
            Self::Folder(uploads) => uploads.begin(app, upload),
            Self::Shared(uploads) => uploads.begin(app, upload).await,
        }
    }

    /// An upload as it is.
    pub(super) async fn find(&self, app: &App, id: &str) -> Result<ResumableUpload, Problem> {
        match self {
            Self::Folder(uploads) => Ok(uploads.find(id)?.lock().await.clone()),
            Self::Shared(uploads) => uploads.find(app, id).await,
        }
    }

    /// Takes the bytes behind the first `at`, and has the upload read when it is whole.
    pub(super) async fn go_on(&self, app: &App, id: &str, at: u64, body: Body) -> Result<ResumableUpload, Problem> {
        match self {
            Self::Folder(uploads) => uploads.go_on(app, id, at, body).await,
            Self::Shared(uploads) => uploads.go_on(app, id, at, body).await,
        }
    }

    /// Removes an upload.
    pub(super) async fn give_up(&self, app: &App, id: &str) -> Result<(), Problem> {
        match self {
            Self::Folder(uploads) => uploads.give_up(id),
            Self::Shared(uploads) => uploads.give_up(app, id).await,
        }
    }
}

fn unknown(id: &str) -> Problem {
    Problem::not_found(format!("there is no upload {id:?}"))
}

fn in_use() -> Problem {
    Problem::new(StatusCode::CONFLICT, "the upload is being written to or read")
}

impl ResumableUpload {
    /// Refuses bytes for another place than the one that comes next.
    fn check_offset(&self, at: u64) -> Result<(), Problem> {
        if self.state == UploadState::Receiving && self.offset == at {
            return Ok(());
        }
        let detail = format!("upload-offset is {at}, expected {} of {}", self.offset, self.length);
        Err(Problem::new(StatusCode::CONFLICT, detail))
    }

    /// Notes what became of its reading.
    fn end(&mut self, taken: Result<UploadAnswer, Problem>) {
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

/// Reads an upload that is whole, waiting for its turn; what may pass is waited for, as long as the upload is kept. `path` is where it is, or where
/// it is put together.
async fn read(app: &App, upload: &ResumableUpload, path: &Path) -> Result<UploadAnswer, Problem> {
    loop {
        let taken = match app.ingest.workers().admit() {
            Err(busy) => Err(busy.into()),
            Ok(ticket) => match spool(app, upload, path).await {
                Ok(spooled) => uploads::take_recording(app, &upload.asset, spooled, ticket).await,
                Err(problem) => Err(problem),
            },
        };
        match taken {
            Err(problem) if problem.may_pass() && app.ingest.now() < upload.expires_at => {
                tracing::debug!(upload = upload.id, problem = problem.detail(), "read again later");
                tokio::time::sleep(READ_AGAIN).await;
            }
            taken => return taken,
        }
    }
}

/// An upload as one file.
async fn spool(app: &App, upload: &ResumableUpload, path: &Path) -> Result<SpooledBody, Problem> {
    match &*app.resumable {
        // It is read again where it could not be read now.
        ResumableUploads::Folder(_) => Ok(SpooledBody::kept_at(path.to_path_buf())),
        ResumableUploads::Shared(_) => shared::compose(app, upload, path).await,
    }
}
