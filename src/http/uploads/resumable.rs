//! Resumable uploads: pieces in the object store and a row that counts them, so that any process with the
//! same store can continue an upload that another started, and process one that another left behind.
//!
//! A piece is stored before it is counted, so that a killed process never leaves a piece that is counted but
//! missing. If two requests send the bytes of the same offset, the second finds that the upload has advanced.

use std::sync::PoisonError;
use std::time::Duration;

use axum::body::Body;
use axum::http::StatusCode;
use jiff::{SignedDuration, Timestamp};

use super::UploadAnswer;
use super::piece_reader::PieceReader;
use super::resumable_upload::ResumableUpload;
use crate::asset::AssetId;
use crate::http::access::client::Client;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::body::BodySource;
use crate::http::uploads;
use crate::service::{ChannelNames, ServiceError, blocking, while_leased};
use crate::store::{NewUpload, ReadLease, UploadPiece};

/// How long an inactive upload is kept, and how long the result of a finished one.
const RETENTION: SignedDuration = SignedDuration::from_hours(24);

/// Bytes per piece; the most that a killed process can lose of an upload.
const PIECE_BYTES: usize = 4 << 20;

/// Interval of the search for complete unprocessed uploads and for expired ones.
const POLL_INTERVAL: Duration = Duration::from_secs(5);

/// Maximum number of uploads taken over per search.
const MAX_TAKEN_OVER: u32 = 4;

/// Interval of the heartbeat of a process that processes an upload.
const ALIVE_INTERVAL: Duration = Duration::from_secs(5);

/// Delay before retrying an upload that could not be processed.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// While the disk is full or fails, the delay doubles up to this limit: each retry reads the recording from
/// the beginning.
const MAX_WAIT: Duration = Duration::from_secs(60);

/// Continues uploads that an earlier process left behind, and looks after uploads in the background.
pub(crate) async fn start(app: &App) -> Result<(), ServiceError> {
    if app.service.store.damage().is_some() {
        return Ok(());
    }
    if !app.service.store.is_shared() {
        app.service.store.resume_resumable(expiry(app).await?).await?;
        app.service.uploads.remove_forgotten().await?;
    }
    tokio::spawn(watch(app.clone()));
    Ok(())
}

/// When an upload that stays inactive from now on expires, by the clock of the store.
async fn expiry(app: &App) -> Result<Timestamp, ServiceError> {
    Ok(app.service.store.now(app.service.now()).await? + RETENTION)
}

/// Starts an upload for an existing asset.
pub(crate) async fn begin(
    app: &App,
    client: &Client,
    asset: AssetId,
    length: u64,
) -> Result<ResumableUpload, Problem> {
    app.service.uploads.expire().await?;
    let mut random = [0; 12];
    getrandom::fill(&mut random)
        .map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    let new = NewUpload {
        id: format!("{}{}", client.mark(), hex::encode(random)),
        asset,
        length,
        expires_at: expiry(app).await?,
    };
    // A single client leaves a quarter to the others
    let max = app.limits.uploads_at_once;
    if app.service.store.begin_resumable(&new, max, max - max / 4).await? {
        find(app, &new.id).await
    } else {
        Err(Problem::busy("too many uploads in progress, of this client or in total", 60))
    }
}

/// The current state of an upload.
pub(crate) async fn find(app: &App, id: &str) -> Result<ResumableUpload, Problem> {
    let found = app.service.store.resumable(id, app.service.now()).await?;
    let stored = found.ok_or_else(|| unknown(id))?;
    Ok(ResumableUpload::new(stored, app.upload_waits.get(id)))
}

/// Appends bytes at offset `at`, and starts processing when the upload is complete.
pub(crate) async fn append(app: &App, id: &str, at: u64, body: Body) -> Result<ResumableUpload, Problem> {
    let upload = find(app, id).await?;
    upload.check_offset(at)?;
    let mut ticket = app.service.workers.admit()?;
    ticket
        .grow(usize::try_from(upload.length - at).map_or(PIECE_BYTES, |missing| missing.min(PIECE_BYTES)))?;
    receive(app, upload, body).await
}

/// Removes an upload. One that waits to be processed may be removed, as it may be what fills the disk.
pub(crate) async fn cancel(app: &App, id: &str) -> Result<(), Problem> {
    find(app, id).await?;
    let waits = app.upload_waits.cancel(id);
    match app.service.store.cancel_resumable(id, waits, app.service.now()).await {
        Ok(true) => {}
        Ok(false) => {
            return Err(Problem::new(StatusCode::CONFLICT, "the upload is being written or processed"));
        }
        Err(error) if error.is_full() => {
            // Its pieces free disk space
            app.service.uploads.remove(vec![id.to_owned()]).await?;
            app.service.store.cancel_resumable(id, waits, app.service.now()).await?;
        }
        Err(error) => return Err(error.into()),
    }
    Ok(app.service.uploads.remove(vec![id.to_owned()]).await?)
}

/// Takes over unprocessed uploads of other processes or an earlier one, and removes expired ones, until the
/// store is closed.
async fn watch(app: App) {
    while !app.service.store.is_closed() {
        let look = async {
            app.service.uploads.expire().await?;
            for id in app.service.store.unread_uploads(app.service.now(), MAX_TAKEN_OVER).await? {
                take_over(&app, &id).await?;
            }
            Ok::<_, Problem>(())
        };
        if let Err(problem) = look.await {
            tracing::debug!(
                problem = problem.detail(),
                "failed to look for unprocessed uploads; retrying later"
            );
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
}

fn unknown(id: &str) -> Problem {
    Problem::not_found(format!("upload {id:?} not found"))
}

/// Receives a body piece by piece.
async fn receive(app: &App, mut upload: ResumableUpload, body: Body) -> Result<ResumableUpload, Problem> {
    let mut source = BodySource::new(body, upload.length - upload.offset, &app.limits);
    let mut piece = Vec::new();
    let received = loop {
        match source.next().await {
            Ok(Some(bytes)) => piece.extend_from_slice(&bytes),
            Ok(None) => break Ok(()),
            Err(problem) => break Err(problem),
        }
        if piece.len() >= PIECE_BYTES {
            store_piece(app, &mut upload, std::mem::take(&mut piece)).await?;
        }
    };
    // The received part is kept even if the rest is lost
    if !piece.is_empty() {
        store_piece(app, &mut upload, piece).await?;
    }
    if upload.offset == upload.length {
        take_over(app, &upload.id).await?;
    }
    received?;
    Ok(upload)
}

/// Stores and counts a piece.
async fn store_piece(app: &App, upload: &mut ResumableUpload, bytes: Vec<u8>) -> Result<(), Problem> {
    let (store, id, count) = (app.service.store.clone(), upload.id.clone(), bytes.len() as u64);
    let object = blocking("store an upload", move || store.objects().put_piece(&id, bytes.into())).await??;
    let (store, expires_at) = (&app.service.store, expiry(app).await?);
    let piece = UploadPiece { bytes: count, object };
    if store.add_piece(&upload.id, upload.offset, &piece, expires_at).await? {
        upload.offset += count;
        upload.expires_at = expires_at;
        return Ok(());
    }
    if store.resumable(&upload.id, app.service.now()).await?.is_none() {
        // The upload was cancelled in the meantime, and nobody else removes pieces stored after that.
        app.service.uploads.remove(vec![upload.id.clone()]).await?;
        return Err(unknown(&upload.id));
    }
    Err(Problem::new(StatusCode::CONFLICT, "another request has continued the upload"))
}

/// Starts processing a complete upload in the background, unless another process does so.
async fn take_over(app: &App, id: &str) -> Result<(), Problem> {
    if let Some(lease) = app.service.store.acquire_read_lease(id, app.service.now()).await? {
        // If it cannot be read, another look takes it over once this one counts as ended.
        let upload = find(app, id).await?;
        app.upload_waits.begin(id);
        tokio::spawn(read_and_end(app.clone(), upload, lease));
    }
    Ok(())
}

/// Processes a complete upload with a heartbeat.
async fn read_and_end(app: App, upload: ResumableUpload, lease: ReadLease) {
    let renew = || async {
        if let Err(error) = app.service.store.renew_read_lease(&lease, app.service.now()).await {
            tracing::debug!(upload = upload.id, %error, "failed to write the heartbeat of an upload");
        }
    };
    let work = async {
        let Some(taken) = read(&app, &upload).await else {
            return;
        };
        while let Err(problem) = end(&app, &upload, &lease, &taken).await {
            tracing::warn!(
                upload = upload.id,
                problem = problem.detail(),
                "failed to store the result of an upload; retrying"
            );
            if app.service.store.is_closed() || !problem.may_pass() {
                break;
            }
            tokio::time::sleep(RETRY_AFTER).await;
        }
    };
    while_leased(ALIVE_INTERVAL, work, renew).await;
    app.upload_waits.end(&upload.id);
}

/// Processes a complete upload when its turn comes; transient errors are retried as long as the upload is
/// kept. `None` if it was cancelled while waiting, or if the store is closed: then the next process that
/// opens the store takes it over.
async fn read(app: &App, upload: &ResumableUpload) -> Option<Result<UploadAnswer, Problem>> {
    let mut wait = RETRY_AFTER;
    while app.upload_waits.set(&upload.id, None) {
        let taken = read_once(app, upload).await;
        if app.service.store.is_closed() {
            return None;
        }
        match taken {
            Err(problem) if problem.may_pass() && is_kept(app, upload).await => {
                tracing::debug!(
                    upload = upload.id,
                    problem = problem.detail(),
                    "failed to process an upload; retrying later"
                );
                app.upload_waits.set(&upload.id, Some(problem.detail()));
                wait = if problem.is_busy() { RETRY_AFTER } else { wait };
                tokio::time::sleep(wait).await;
                wait = (2 * wait).min(MAX_WAIT);
            }
            taken => return Some(taken),
        }
    }
    None
}

/// Whether an upload is still kept; assumed so if that cannot be determined.
async fn is_kept(app: &App, upload: &ResumableUpload) -> bool {
    let now = app.service.store.now(app.service.now()).await;
    now.map_or(true, |now| now < upload.expires_at)
}

async fn read_once(app: &App, upload: &ResumableUpload) -> Result<UploadAnswer, Problem> {
    let _ticket = app.service.workers.admit()?;
    let pieces = app.service.store.upload_pieces(&upload.id).await?;
    let bytes: u64 = pieces.iter().map(|piece| piece.bytes).sum();
    if bytes != upload.length {
        let detail = format!("{bytes} bytes of the upload are stored, expected {}", upload.length);
        return Err(Problem::new(StatusCode::INTERNAL_SERVER_ERROR, detail));
    }
    let reader = PieceReader::new(app.service.store.clone(), upload.id.clone(), pieces);
    let failure = reader.failure();
    let taken =
        uploads::take_recording(app, &upload.asset, ChannelNames::default(), move || Ok(reader)).await;
    let failure = failure.lock().unwrap_or_else(PoisonError::into_inner).take();
    failure.map_or(taken, |error| Err(error.into()))
}

/// Stores the result of an upload and removes its pieces.
async fn end(
    app: &App,
    upload: &ResumableUpload,
    lease: &ReadLease,
    taken: &Result<UploadAnswer, Problem>,
) -> Result<(), Problem> {
    let text = taken.as_ref().map(serde_json::to_string);
    let result = match &text {
        Ok(Ok(text)) => Ok(text.as_str()),
        Ok(Err(_)) => Err("its result cannot be serialised"),
        Err(problem) => Err(problem.detail()),
    };
    let expires_at = expiry(app).await?;
    let is_mine = match app.service.store.finish_reading(lease, result, expires_at).await {
        Err(error) if error.is_full() => {
            // The upload is complete, and removing its pieces frees space.
            app.service.uploads.remove(vec![upload.id.clone()]).await?;
            app.service.store.finish_reading(lease, result, expires_at).await?
        }
        done => done?,
    };
    if is_mine {
        app.service.uploads.remove(vec![upload.id.clone()]).await?;
    }
    Ok(())
}
