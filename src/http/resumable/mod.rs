//! Resumable uploads: where they are kept while they come, and their reading when they are whole.
//!
//! One machine keeps a file that grows. Where processes share a store, what has come is in the store, so that any of them goes on with it.

mod files;
mod folder;
mod incoming;
mod reading;
mod shared;
mod upload;

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::http::StatusCode;
use jiff::Timestamp;

use super::app::App;
use super::problem::Problem;
use crate::asset::AssetId;
use crate::service::detached;
use folder::FolderUploads;
use shared::SharedUploads;
pub(in crate::http) use upload::ResumableUpload;
use upload::{KEPT, UploadState};

/// How often uploads are looked for that are whole and that nobody reads, or that nobody went on with.
const LOOKED_EVERY: Duration = Duration::from_secs(5);

/// All resumable uploads.
#[derive(Debug)]
pub(super) enum ResumableUploads {
    /// Of one machine.
    Folder(Arc<FolderUploads>),
    /// Of all processes on a store.
    Shared(SharedUploads),
}

impl ResumableUploads {
    /// Those of one machine; takes up what is in the folder.
    pub(super) fn open(folder: PathBuf, most_bytes: u64, now: Timestamp) -> io::Result<Self> {
        Ok(Self::Folder(Arc::new(FolderUploads::open(folder, most_bytes, now)?)))
    }

    /// Those of all processes on a store.
    pub(super) fn shared(most_bytes: u64) -> Self {
        Self::Shared(SharedUploads::new(most_bytes))
    }

    /// Goes on with what other processes, or an earlier one, have left, and removes what nobody went on with, in the background.
    pub(super) fn watch(app: &App) {
        match &*app.resumable {
            Self::Folder(uploads) => tokio::spawn(folder::watch(app.clone(), Arc::clone(uploads))),
            Self::Shared(_) => tokio::spawn(shared::watch(app.clone())),
        };
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
        let id = hex::encode(random);
        let upload = ResumableUpload::new(id, asset, length, app.service.now());
        match self {
            Self::Folder(uploads) => uploads.begin(app, upload).await,
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
    pub(super) async fn go_on(app: &App, id: &str, at: u64, body: Body) -> Result<ResumableUpload, Problem> {
        // Where the client goes away, what it has sent is still kept.
        let (app, id) = (app.clone(), id.to_owned());
        let go_on = async move {
            match &*app.resumable {
                Self::Folder(uploads) => uploads.go_on(&app, &id, at, body).await,
                Self::Shared(uploads) => uploads.go_on(&app, &id, at, body).await,
            }
        };
        detached("keep an upload", go_on).await?
    }

    /// Says what the reading of an upload waits for, or that it does not; false where the upload was given up.
    async fn note_wait(&self, id: &str, what: Option<&str>) -> bool {
        match self {
            Self::Folder(uploads) => uploads.note_wait(id, what).await,
            Self::Shared(_) => true,
        }
    }

    /// Removes an upload.
    pub(super) async fn give_up(&self, app: &App, id: &str) -> Result<(), Problem> {
        match self {
            Self::Folder(uploads) => uploads.give_up(id).await,
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

fn too_many() -> Problem {
    Problem::busy("too many uploads are under way", 60)
}
