//! Uploads of one machine: a file that grows and a description beside it, so that one is resumed after a restart too.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Body;
use axum::http::StatusCode;
use jiff::Timestamp;

use super::{KEPT, ResumableUpload, UploadState, in_use, read, unknown};
use crate::http::body::{Pieces, SpooledBody};
use crate::http::problem::Problem;
use crate::http::router::App;
use crate::ingest::IngestError;

/// Uploads at once.
const MOST_UPLOADS: usize = 64;

/// Uploads in a folder.
#[derive(Debug)]
pub(in crate::http) struct FolderUploads {
    folder: PathBuf,
    most_bytes: u64,
    held: Mutex<BTreeMap<String, Held>>,
}

type Held = Arc<tokio::sync::Mutex<ResumableUpload>>;

impl FolderUploads {
    /// Takes up what is in the folder.
    pub(super) fn open(folder: PathBuf, most_bytes: u64) -> io::Result<Self> {
        fs::create_dir_all(&folder)?;
        let mut held = BTreeMap::new();
        for entry in fs::read_dir(&folder)?.flatten() {
            let path = entry.path();
            if path.extension().is_none_or(|extension| extension != "json") {
                continue;
            }
            let read = fs::read(&path)
                .ok()
                .and_then(|text| serde_json::from_slice::<ResumableUpload>(&text).ok());
            let Some(mut upload) = read else {
                tracing::warn!(file = %path.display(), "description of an upload cannot be read");
                continue;
            };
            match upload.state {
                // What the file holds counts: the description may be older.
                UploadState::Receiving => {
                    upload.offset = fs::metadata(path.with_extension("part")).map_or(0, |file| file.len().min(upload.length))
                }
                UploadState::Reading => {
                    upload.state = UploadState::Failed;
                    upload.error = Some("the service stopped while it was read: upload it again, what is stored stays".into());
                }
                UploadState::Finished | UploadState::Failed => {}
            }
            held.insert(upload.id.clone(), Arc::new(tokio::sync::Mutex::new(upload)));
        }
        Ok(Self {
            folder,
            most_bytes,
            held: Mutex::new(held),
        })
    }

    fn path(&self, id: &str) -> PathBuf {
        self.folder.join(id).with_extension("part")
    }

    fn keep(&self, upload: &ResumableUpload) -> Result<(), Problem> {
        let path = self.folder.join(&upload.id).with_extension("json");
        let next = path.with_extension("new");
        let text = serde_json::to_vec(upload).unwrap_or_default();
        let written = fs::write(&next, text).and_then(|()| fs::rename(&next, &path));
        written.map_err(|source| file_problem(&path, source))
    }

    pub(super) fn most_bytes(&self) -> u64 {
        self.most_bytes
    }

    pub(super) fn find(&self, id: &str) -> Result<Held, Problem> {
        let held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        held.get(id).cloned().ok_or_else(|| unknown(id))
    }

    fn forget(&self, id: &str) {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).remove(id);
        for extension in ["part", "json"] {
            // The part may have become the recording already.
            let _ = fs::remove_file(self.folder.join(id).with_extension(extension));
        }
    }

    /// Removes uploads that nobody went on with.
    fn sweep(&self, now: Timestamp) {
        let all: Vec<(String, Held)> = {
            let held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
            held.iter().map(|(id, upload)| (id.clone(), Arc::clone(upload))).collect()
        };
        for (id, upload) in all {
            // One that is being written to or read is not stale.
            let is_over = upload
                .try_lock()
                .is_ok_and(|upload| upload.expires_at < now && upload.state != UploadState::Reading);
            if is_over {
                self.forget(&id);
            }
        }
    }

    pub(super) fn begin(&self, app: &App, upload: ResumableUpload) -> Result<ResumableUpload, Problem> {
        self.sweep(app.ingest.now());
        fs::File::create(self.path(&upload.id)).map_err(|source| file_problem(&self.folder, source))?;
        self.keep(&upload)?;
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if held.len() >= MOST_UPLOADS {
            drop(held);
            self.forget(&upload.id);
            return Err(Problem::busy("too many uploads are under way", 60));
        }
        held.insert(upload.id.clone(), Arc::new(tokio::sync::Mutex::new(upload.clone())));
        Ok(upload)
    }

    pub(super) async fn go_on(&self, app: &App, id: &str, at: u64, body: Body) -> Result<ResumableUpload, Problem> {
        let held = self.find(id)?;
        // Two at once would write over each other.
        let Ok(mut upload) = Arc::clone(&held).try_lock_owned() else {
            return Err(Problem::new(StatusCode::CONFLICT, "the upload is being written to"));
        };
        upload.check_offset(at)?;
        let path = self.path(id);
        let opened = fs::OpenOptions::new().write(true).open(&path);
        let mut file = opened.map_err(|source| file_problem(&path, source))?;
        file.seek(SeekFrom::Start(at)).map_err(|source| file_problem(&path, source))?;
        let mut pieces = Pieces::Body(body);
        let deadline = tokio::time::Instant::now() + app.limits.body_timeout;
        let received = loop {
            let piece = match tokio::time::timeout_at(deadline, pieces.next()).await {
                Err(_) => break Err(Problem::new(StatusCode::REQUEST_TIMEOUT, "the body took too long")),
                Ok(Err(problem)) => break Err(problem),
                Ok(Ok(None)) => break Ok(()),
                Ok(Ok(Some(piece))) => piece,
            };
            if upload.offset + piece.len() as u64 > upload.length {
                break Err(Problem::too_large(upload.length - at));
            }
            // To the page cache: short enough for this thread.
            if let Err(source) = file.write_all(&piece) {
                break Err(file_problem(&path, source));
            }
            upload.offset += piece.len() as u64;
        };
        // What has come is kept, also where the rest did not.
        let synced = tokio::task::spawn_blocking(move || file.sync_data()).await;
        if let Ok(Err(source)) = synced {
            return Err(file_problem(&path, source));
        }
        upload.expires_at = app.ingest.now() + KEPT;
        self.keep(&upload)?;
        received?;
        let answer = upload.clone();
        if upload.offset == upload.length {
            upload.state = UploadState::Reading;
            self.keep(&upload)?;
            drop(upload);
            tokio::spawn(read_file(app.clone(), held));
        }
        Ok(answer)
    }

    pub(super) fn give_up(&self, id: &str) -> Result<(), Problem> {
        let held = self.find(id)?;
        match held.try_lock() {
            Ok(upload) if upload.state != UploadState::Reading => {}
            _ => return Err(in_use()),
        }
        self.forget(id);
        Ok(())
    }
}

/// Reads an upload that is whole.
async fn read_file(app: App, held: Held) {
    let super::ResumableUploads::Folder(uploads) = &*app.resumable else {
        return;
    };
    let upload = held.lock().await.clone();
    let path = uploads.path(&upload.id);
    let taken = read(&app, &upload, &path).await;
    let mut upload = held.lock().await;
    upload.end(taken);
    if let Err(problem) = uploads.keep(&upload) {
        tracing::warn!(upload = upload.id, problem = problem.detail(), "end of an upload not kept");
    }
    drop(SpooledBody::at(path));
}

fn file_problem(path: &Path, source: io::Error) -> Problem {
    IngestError::File {
        action: "write",
        path: path.to_path_buf(),
        source,
    }
    .into()
}
