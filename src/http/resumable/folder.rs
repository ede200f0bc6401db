//! Uploads of one machine: a file that grows and a description beside it, so that one is resumed, and read, after a restart too.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::body::Body;
use axum::http::StatusCode;
use jiff::Timestamp;
use tokio::task::spawn_blocking;

use super::files::UploadFiles;
use super::incoming::Incoming;
use super::reading::read;
use super::{KEPT, LOOKED_EVERY, ResumableUpload, UploadState, in_use, too_many, unknown};
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::service::ServiceError;

/// Uploads in a folder.
#[derive(Debug)]
pub(in crate::http) struct FolderUploads {
    files: UploadFiles,
    most_bytes: u64,
    held: Mutex<BTreeMap<String, Held>>,
}

/// An upload; locked as long as it is written to.
type Held = Arc<tokio::sync::Mutex<ResumableUpload>>;

impl FolderUploads {
    /// Takes up what is in the folder.
    pub(super) fn open(folder: PathBuf, most_bytes: u64, now: Timestamp) -> io::Result<Self> {
        let files = UploadFiles::open(folder)?;
        let mut held = BTreeMap::new();
        for mut upload in files.take_up()? {
            if upload.is_unread() {
                // Nobody could read it while no service ran.
                upload.expires_at = upload.expires_at.max(now + KEPT);
            }
            held.insert(upload.id.clone(), Arc::new(tokio::sync::Mutex::new(upload)));
        }
        Ok(Self {
            files,
            most_bytes,
            held: Mutex::new(held),
        })
    }

    pub(super) fn most_bytes(&self) -> u64 {
        self.most_bytes
    }

    fn held(&self) -> MutexGuard<'_, BTreeMap<String, Held>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn find(&self, id: &str) -> Result<Held, Problem> {
        self.held().get(id).cloned().ok_or_else(|| unknown(id))
    }

    fn all(&self) -> Vec<Held> {
        self.held().values().cloned().collect()
    }

    fn forget(&self, id: &str) {
        self.held().remove(id);
        self.files.remove(id);
    }

    /// Removes uploads that nobody went on with.
    fn sweep(&self, now: Timestamp) {
        for held in self.all() {
            // One that is being written to or read is not stale.
            if let Ok(upload) = held.try_lock()
                && upload.expires_at < now
                && upload.state != UploadState::Reading
            {
                self.forget(&upload.id);
            }
        }
    }

    pub(super) async fn begin(self: &Arc<Self>, app: &App, upload: ResumableUpload) -> Result<ResumableUpload, Problem> {
        let (uploads, now, most) = (Arc::clone(self), app.service.now(), app.limits.uploads_at_once);
        let begun = spawn_blocking(move || {
            uploads.sweep(now);
            uploads.add(upload, most as usize)
        });
        begun.await.map_err(|_| ServiceError::WorkerLost("begin an upload"))?
    }

    fn add(&self, upload: ResumableUpload, most: usize) -> Result<ResumableUpload, Problem> {
        {
            let mut held = self.held();
            // One that is locked is being written to.
            let is_open = |held: &&Held| held.try_lock().map_or(true, |upload| upload.state.is_open());
            if held.values().filter(is_open).count() >= most {
                return Err(too_many());
            }
            held.insert(upload.id.clone(), Arc::new(tokio::sync::Mutex::new(upload.clone())));
        }
        if let Err(error) = self.files.begin(&upload) {
            self.forget(&upload.id);
            return Err(error.into());
        }
        Ok(upload)
    }

    pub(super) async fn go_on(self: &Arc<Self>, app: &App, id: &str, at: u64, body: Body) -> Result<ResumableUpload, Problem> {
        // Two at once would write over each other.
        let Ok(mut upload) = self.find(id)?.try_lock_owned() else {
            return Err(Problem::new(StatusCode::CONFLICT, "the upload is being written to"));
        };
        // It may have been given up before it was locked.
        self.find(id)?;
        upload.check_offset(at)?;
        let mut file = self.files.append(id, at)?;
        let mut incoming = Incoming::new(app, &upload, body);
        let mut end = at;
        let received = loop {
            let bytes = match incoming.next().await {
                Ok(Some(bytes)) => bytes,
                Ok(None) => break Ok(()),
                Err(problem) => break Err(problem),
            };
            // To the page cache: short enough for this thread.
            if let Err(source) = file.write_all(&bytes) {
                let (action, path) = ("write", self.files.part(id));
                break Err(ServiceError::File { action, path, source }.into());
            }
            end += bytes.len() as u64;
        };
        // What has come is kept, also where the rest did not.
        let (files, expires_at) = (self.files.clone(), app.service.now() + KEPT);
        let kept = spawn_blocking(move || {
            files.sync(&upload.id, &file, at, end)?;
            upload.offset = end;
            let before = std::mem::replace(&mut upload.expires_at, expires_at);
            if let Err(error) = files.keep(&upload) {
                // The file says how far it is; the description that there was still holds.
                tracing::warn!(upload = upload.id, %error, "description of an upload not kept anew");
                upload.expires_at = before;
            }
            Ok::<_, ServiceError>(upload)
        });
        let mut upload = kept.await.map_err(|_| ServiceError::WorkerLost("keep an upload"))??;
        self.take_on(app, &mut upload);
        received?;
        Ok(upload.clone())
    }

    /// Reads an upload in the background where it is whole and nobody does.
    fn take_on(self: &Arc<Self>, app: &App, upload: &mut ResumableUpload) {
        if upload.is_unread() {
            upload.state = UploadState::Reading;
            tokio::spawn(Arc::clone(self).read_part(app.clone(), upload.clone()));
        }
    }

    async fn read_part(self: Arc<Self>, app: App, upload: ResumableUpload) {
        let Some(taken) = read(&app, &upload, &self.files.part(&upload.id)).await else {
            return;
        };
        let Ok(held) = self.find(&upload.id) else { return };
        let mut upload = held.lock_owned().await;
        upload.end(taken, app.service.now());
        let ended = spawn_blocking(move || {
            if let Err(error) = self.files.end(&upload) {
                tracing::warn!(upload = upload.id, %error, "end of an upload not kept");
            }
        });
        if ended.await.is_err() {
            tracing::warn!("end of an upload not kept");
        }
    }

    pub(super) async fn note_wait(&self, id: &str, what: Option<&str>) -> bool {
        let Ok(held) = self.find(id) else { return false };
        held.lock().await.waits_for = what.map(str::to_owned);
        true
    }

    pub(super) async fn give_up(self: &Arc<Self>, id: &str) -> Result<(), Problem> {
        let upload = self.find(id)?.try_lock_owned().map_err(|_| in_use())?;
        // One that waits to be read may go: it may be what fills the disk.
        if upload.state == UploadState::Reading && upload.waits_for.is_none() {
            return Err(in_use());
        }
        let uploads = Arc::clone(self);
        let given_up = spawn_blocking(move || uploads.forget(&upload.id));
        Ok(given_up.await.map_err(|_| ServiceError::WorkerLost("give up an upload"))?)
    }
}

/// Reads what an earlier process left unread, and removes what nobody went on with, until the store is closed.
pub(super) async fn watch(app: App, uploads: Arc<FolderUploads>) {
    while !app.service.store.is_closed() {
        for held in uploads.all() {
            if let Ok(mut upload) = held.try_lock() {
                uploads.take_on(&app, &mut upload);
            }
        }
        let (swept, now) = (Arc::clone(&uploads), app.service.now());
        if spawn_blocking(move || swept.sweep(now)).await.is_err() {
            tracing::warn!("uploads that nobody went on with are looked for again later");
        }
        tokio::time::sleep(LOOKED_EVERY).await;
    }
}
