//! Uploads of all processes on a store: any of them goes on with what another began, and reads what another left unread.
//!
//! A piece is kept before it counts, so that a process that is killed leaves nothing that is said to be there and is not. Two that bring the bytes
//! of one place at the same time: the second finds that the upload has gone on.

use std::path::Path;
use std::time::Duration;

use axum::body::Body;
use axum::http::StatusCode;
use tokio::io::AsyncWriteExt;

use super::incoming::Incoming;
use super::reading::read;
use super::{KEPT, LOOKED_EVERY, ResumableUpload, UploadState, in_use, too_many, unknown};
use crate::http::app::App;
use crate::http::body::SpooledBody;
use crate::http::problem::Problem;
use crate::service::{ServiceError, blocking};
use crate::store::{NewUpload, StoredUpload, UploadPiece, UploadProgress};

/// Bytes of one piece; what a process that is killed may lose of an upload.
const PIECE_BYTES: usize = 4 << 20;

/// Uploads taken on after one look.
const TAKEN_ON: u32 = 4;

/// How often a process that reads an upload says that it is alive.
const SAID_EVERY: Duration = Duration::from_secs(5);

/// Uploads in a shared store.
#[derive(Debug)]
pub(in crate::http) struct SharedUploads {
    most_bytes: u64,
}

impl SharedUploads {
    pub(super) fn new(most_bytes: u64) -> Self {
        Self { most_bytes }
    }

    pub(super) fn most_bytes(&self) -> u64 {
        self.most_bytes
    }

    pub(super) async fn begin(&self, app: &App, upload: ResumableUpload) -> Result<ResumableUpload, Problem> {
        app.service.uploads.expire().await?;
        let new = NewUpload {
            id: upload.id.clone(),
            asset: upload.asset.clone(),
            length: upload.length,
            expires_at: upload.expires_at,
        };
        if app.service.store.begin_resumable(&new, app.limits.uploads_at_once).await? {
            Ok(upload)
        } else {
            Err(too_many())
        }
    }

    pub(super) async fn find(&self, app: &App, id: &str) -> Result<ResumableUpload, Problem> {
        let found = app.service.store.resumable(id, app.service.now()).await?;
        found.map(ResumableUpload::from).ok_or_else(|| unknown(id))
    }

    pub(super) async fn go_on(&self, app: &App, id: &str, at: u64, body: Body) -> Result<ResumableUpload, Problem> {
        let upload = self.find(app, id).await?;
        upload.check_offset(at)?;
        let mut ticket = app.service.workers.admit()?;
        ticket.grow(usize::try_from(upload.length - at).map_or(PIECE_BYTES, |missing| missing.min(PIECE_BYTES)))?;
        receive(app, upload, body).await
    }

    pub(super) async fn give_up(&self, app: &App, id: &str) -> Result<(), Problem> {
        self.find(app, id).await?;
        if !app.service.store.give_up_resumable(id, app.service.now()).await? {
            return Err(in_use());
        }
        Ok(app.service.uploads.remove(vec![id.to_owned()]).await?)
    }
}

/// Takes what comes, piece by piece.
async fn receive(app: &App, mut upload: ResumableUpload, body: Body) -> Result<ResumableUpload, Problem> {
    let mut incoming = Incoming::new(app, &upload, body);
    let mut piece = Vec::new();
    let received = loop {
        let bytes = match incoming.next().await {
            Ok(Some(bytes)) => bytes,
            Ok(None) => break Ok(()),
            Err(problem) => break Err(problem),
        };
        piece.extend_from_slice(&bytes);
        if piece.len() >= PIECE_BYTES {
            keep(app, &mut upload, std::mem::take(&mut piece)).await?;
        }
    };
    // What has come is kept, also where the rest did not.
    if !piece.is_empty() {
        keep(app, &mut upload, piece).await?;
    }
    received?;
    if upload.offset == upload.length {
        take_on(app, &upload.id).await?;
    }
    Ok(upload)
}

/// Keeps a piece, and says that it is there.
async fn keep(app: &App, upload: &mut ResumableUpload, bytes: Vec<u8>) -> Result<(), Problem> {
    let (store, id, count) = (app.service.store.clone(), upload.id.clone(), bytes.len() as u64);
    let object = blocking("keep an upload", move || store.objects().put_piece(&id, bytes.into())).await??;
    let (store, now) = (&app.service.store, app.service.now());
    let piece = UploadPiece { bytes: count, object };
    if store.add_piece(&upload.id, upload.offset, &piece, now + KEPT).await? {
        upload.offset += count;
        upload.expires_at = now + KEPT;
        return Ok(());
    }
    if store.resumable(&upload.id, now).await?.is_none() {
        // It was given up meanwhile, and nobody else removes what came after that.
        app.service.uploads.remove(vec![upload.id.clone()]).await?;
        return Err(unknown(&upload.id));
    }
    Err(Problem::new(StatusCode::CONFLICT, "the upload was gone on with by another request"))
}

/// Reads an upload that is whole in the background, where nobody else does.
async fn take_on(app: &App, id: &str) -> Result<(), Problem> {
    let (store, now) = (&app.service.store, app.service.now());
    if store.begin_reading(id, now).await?
        && let Some(upload) = store.resumable(id, now).await?
    {
        tokio::spawn(read_pieces(app.clone(), upload.into()));
    }
    Ok(())
}

/// Takes on what other processes have left unread, until the store is closed.
pub(super) async fn watch(app: App) {
    while !app.service.store.is_closed() {
        let looked = async {
            for id in app.service.store.unread_uploads(app.service.now(), TAKEN_ON).await? {
                take_on(&app, &id).await?;
            }
            Ok::<_, Problem>(())
        };
        if let Err(problem) = looked.await {
            tracing::debug!(problem = problem.detail(), "unread uploads are looked for again later");
        }
        tokio::time::sleep(LOOKED_EVERY).await;
    }
}

/// Reads an upload that is whole, and says from time to time that it is being read.
async fn read_pieces(app: App, upload: ResumableUpload) {
    let alive = async {
        loop {
            tokio::time::sleep(SAID_EVERY).await;
            if let Err(error) = app.service.store.go_on_reading(&upload.id, app.service.now()).await {
                tracing::debug!(upload = upload.id, %error, "not said that it is being read");
            }
        }
    };
    let path = app.uploads.join(format!("{}.part", upload.id));
    let read_and_end = async {
        let Some(taken) = read(&app, &upload, &path).await else {
            return;
        };
        let mut ended = upload.clone();
        ended.end(taken, app.service.now());
        while let Err(problem) = end(&app, &ended).await {
            tracing::warn!(upload = ended.id, problem = problem.detail(), "end of an upload not kept yet");
            if app.service.store.is_closed() || !problem.may_pass() {
                break;
            }
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    };
    tokio::select! {
        () = read_and_end => {}
        () = alive => {}
    }
}

/// Keeps what became of an upload; its pieces go.
async fn end(app: &App, upload: &ResumableUpload) -> Result<(), Problem> {
    let text = upload.result.as_ref().map(ToString::to_string);
    let result = match (&text, &upload.error) {
        (Some(text), None) => Ok(text.as_str()),
        (_, error) => Err(error.as_deref().unwrap_or("its result cannot be written down")),
    };
    let store = &app.service.store;
    store.finish_reading(&upload.id, result, upload.expires_at).await?;
    Ok(app.service.uploads.remove(vec![upload.id.clone()]).await?)
}

/// The pieces of an upload as one file.
pub(super) async fn compose(app: &App, upload: &ResumableUpload, path: &Path) -> Result<SpooledBody, Problem> {
    let failed = |source| {
        Problem::from(ServiceError::File {
            action: "write",
            path: path.to_path_buf(),
            source,
        })
    };
    let spooled = SpooledBody::at(path.to_path_buf());
    let mut file = tokio::fs::File::create(path).await.map_err(failed)?;
    let mut written = 0;
    for piece in app.service.store.upload_pieces(&upload.id).await? {
        let (store, id) = (app.service.store.clone(), upload.id.clone());
        let bytes = blocking("read an upload", move || store.objects().piece(&id, &piece.object)).await??;
        file.write_all(&bytes).await.map_err(failed)?;
        written += bytes.len() as u64;
    }
    file.flush().await.map_err(failed)?;
    if written == upload.length {
        return Ok(spooled);
    }
    let detail = format!("{written} bytes of the upload are kept, expected {}", upload.length);
    Err(Problem::new(StatusCode::INTERNAL_SERVER_ERROR, detail))
}

impl From<StoredUpload> for ResumableUpload {
    fn from(stored: StoredUpload) -> Self {
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
            waits_for: None,
            result: stored.result.and_then(|text| serde_json::from_str(&text).ok()),
            error: stored.error,
        }
    }
}
