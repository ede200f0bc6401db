//! Resumable uploads: pieces in the object store and a row that counts them, so that any process of a store
//! goes on with what another began, and reads what another left unread.
//!
//! A piece is stored before it counts, so that a process that is killed leaves nothing that is said to be
//! there and is not. Two that bring the bytes of one place at the same time: the second finds that the upload
//! has gone on.

use std::time::Duration;

use axum::body::Body;
use axum::http::StatusCode;
use jiff::{SignedDuration, Timestamp};

use super::app::App;
use super::body::BodySource;
use super::piece_reader::PieceReader;
use super::problem::Problem;
use super::resumable_upload::ResumableUpload;
use super::shares::Client;
use super::uploads::{self, UploadAnswer};
use crate::asset::AssetId;
use crate::service::{ServiceError, blocking, detached};
use crate::store::{NewUpload, UploadPiece};

/// How long an upload that does not go on is kept, and how long it is known what became of one.
const KEPT: SignedDuration = SignedDuration::from_hours(24);

/// Bytes of one piece; what a process that is killed may lose of an upload.
const PIECE_BYTES: usize = 4 << 20;

/// How often uploads are looked for that are whole and that nobody reads, or that nobody went on with.
const LOOK_INTERVAL: Duration = Duration::from_secs(5);

/// Uploads taken on after one look.
const MAX_TAKEN_ON: u32 = 4;

/// How often a process that reads an upload says that it is alive.
const ALIVE_INTERVAL: Duration = Duration::from_secs(5);

/// Wait before an upload is read again that could not be read now.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// Where the disk is full, each wait is twice the one before, up to this: the recording is read from its
/// beginning each time.
const MAX_WAIT: Duration = Duration::from_secs(60);

/// Goes on with what an earlier process has left, and looks after uploads in the background.
pub(super) async fn start(app: &App) -> Result<(), ServiceError> {
    if app.service.store.damage().is_some() {
        return Ok(());
    }
    if !app.service.store.is_shared() {
        app.service.store.resume_resumable(kept_until(app).await?).await?;
        app.service.uploads.remove_forgotten().await?;
    }
    tokio::spawn(watch(app.clone()));
    Ok(())
}

/// When an upload goes that does not go on from now, by the clock of the store.
async fn kept_until(app: &App) -> Result<Timestamp, ServiceError> {
    Ok(app.service.store.now(app.service.now()).await? + KEPT)
}

/// Begins an upload for an asset that is there.
pub(super) async fn begin(
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
        expires_at: kept_until(app).await?,
    };
    // One client leaves a quarter to the others.
    let most = app.limits.uploads_at_once;
    if app.service.store.begin_resumable(&new, most, most - most / 4).await? {
        find(app, &new.id).await
    } else {
        Err(Problem::busy("too many uploads are under way, of this client or of all together", 60))
    }
}

/// An upload as it is.
pub(super) async fn find(app: &App, id: &str) -> Result<ResumableUpload, Problem> {
    let found = app.service.store.resumable(id, app.service.now()).await?;
    let stored = found.ok_or_else(|| unknown(id))?;
    Ok(ResumableUpload::new(stored, app.reading_waits.get(id)))
}

/// Takes the bytes behind the first `at`, and has the upload read when it is whole.
pub(super) async fn go_on(app: &App, id: &str, at: u64, body: Body) -> Result<ResumableUpload, Problem> {
    // Where the client goes away, what it has sent is still kept.
    let (app, id) = (app.clone(), id.to_owned());
    let receive = async move {
        let upload = find(&app, &id).await?;
        upload.check_offset(at)?;
        let mut ticket = app.service.workers.admit()?;
        ticket.grow(
            usize::try_from(upload.length - at).map_or(PIECE_BYTES, |missing| missing.min(PIECE_BYTES)),
        )?;
        receive(&app, upload, body).await
    };
    detached("store an upload", receive).await?
}

/// Removes an upload. One that waits to be read may go: it may be what fills the disk.
pub(super) async fn give_up(app: &App, id: &str) -> Result<(), Problem> {
    find(app, id).await?;
    let waits = app.reading_waits.give_up(id);
    match app.service.store.give_up_resumable(id, waits, app.service.now()).await {
        Ok(true) => {}
        Ok(false) => {
            return Err(Problem::new(StatusCode::CONFLICT, "the upload is being written to or read"));
        }
        Err(error) if error.is_full() => {
            // There is room once its pieces are gone.
            app.service.uploads.remove(vec![id.to_owned()]).await?;
            app.service.store.give_up_resumable(id, waits, app.service.now()).await?;
        }
        Err(error) => return Err(error.into()),
    }
    Ok(app.service.uploads.remove(vec![id.to_owned()]).await?)
}

/// Takes on what other processes, or an earlier one, have left unread, and removes what nobody went on with,
/// until the store is closed.
async fn watch(app: App) {
    while !app.service.store.is_closed() {
        let look = async {
            app.service.uploads.expire().await?;
            for id in app.service.store.unread_uploads(app.service.now(), MAX_TAKEN_ON).await? {
                take_on(&app, &id).await?;
            }
            Ok::<_, Problem>(())
        };
        if let Err(problem) = look.await {
            tracing::debug!(
                problem = problem.detail(),
                "failed to look for unread uploads: trying again later"
            );
        }
        tokio::time::sleep(LOOK_INTERVAL).await;
    }
}

fn unknown(id: &str) -> Problem {
    Problem::not_found(format!("there is no upload {id:?}"))
}

/// Takes what comes, piece by piece.
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
    // What has come is kept, also where the rest did not.
    if !piece.is_empty() {
        store_piece(app, &mut upload, piece).await?;
    }
    if upload.offset == upload.length {
        take_on(app, &upload.id).await?;
    }
    received?;
    Ok(upload)
}

/// Stores a piece, and counts it.
async fn store_piece(app: &App, upload: &mut ResumableUpload, bytes: Vec<u8>) -> Result<(), Problem> {
    let (store, id, count) = (app.service.store.clone(), upload.id.clone(), bytes.len() as u64);
    let object = blocking("store an upload", move || store.objects().put_piece(&id, bytes.into())).await??;
    let (store, expires_at) = (&app.service.store, kept_until(app).await?);
    let piece = UploadPiece { bytes: count, object };
    if store.add_piece(&upload.id, upload.offset, &piece, expires_at).await? {
        upload.offset += count;
        upload.expires_at = expires_at;
        return Ok(());
    }
    if store.resumable(&upload.id, app.service.now()).await?.is_none() {
        // It was given up meanwhile, and nobody else removes what came after that.
        app.service.uploads.remove(vec![upload.id.clone()]).await?;
        return Err(unknown(&upload.id));
    }
    Err(Problem::new(StatusCode::CONFLICT, "the upload was gone on with by another request"))
}

/// Reads an upload that is whole in the background, where nobody else does.
async fn take_on(app: &App, id: &str) -> Result<(), Problem> {
    if app.service.store.begin_reading(id, app.service.now()).await? {
        app.reading_waits.begin(id);
        let upload = find(app, id).await?;
        tokio::spawn(read_and_end(app.clone(), upload));
    }
    Ok(())
}

/// Reads an upload that is whole, and says from time to time that it is being read.
async fn read_and_end(app: App, upload: ResumableUpload) {
    let alive = async {
        loop {
            tokio::time::sleep(ALIVE_INTERVAL).await;
            if let Err(error) = app.service.store.renew_reading(&upload.id, app.service.now()).await {
                tracing::debug!(upload = upload.id, %error, "failed to say that an upload is being read");
            }
        }
    };
    let work = async {
        let Some(taken) = read(&app, &upload).await else {
            return;
        };
        while let Err(problem) = end(&app, &upload, &taken).await {
            tracing::warn!(
                upload = upload.id,
                problem = problem.detail(),
                "failed to store the end of an upload: trying again"
            );
            if app.service.store.is_closed() || !problem.may_pass() {
                break;
            }
            tokio::time::sleep(RETRY_AFTER).await;
        }
    };
    tokio::select! {
        () = work => {}
        () = alive => {}
    }
    app.reading_waits.end(&upload.id);
}

/// Reads an upload that is whole, waiting for its turn; what may pass is waited for, as long as the upload is
/// kept. None where it was given up while it waited, or where the store is closed: then it is read by whoever
/// opens the store next.
async fn read(app: &App, upload: &ResumableUpload) -> Option<Result<UploadAnswer, Problem>> {
    let mut wait = RETRY_AFTER;
    while app.reading_waits.set(&upload.id, None) {
        let taken = read_once(app, upload).await;
        if app.service.store.is_closed() {
            return None;
        }
        match taken {
            Err(problem) if problem.may_pass() && is_kept(app, upload).await => {
                tracing::debug!(
                    upload = upload.id,
                    problem = problem.detail(),
                    "failed to read an upload: trying again later"
                );
                app.reading_waits.set(&upload.id, Some(problem.detail()));
                wait = if problem.is_no_room() { wait } else { RETRY_AFTER };
                tokio::time::sleep(wait).await;
                wait = (2 * wait).min(MAX_WAIT);
            }
            taken => return Some(taken),
        }
    }
    None
}

/// Whether an upload is still kept; while nobody can say, it is.
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
    uploads::take_recording(app, &upload.asset, move || Ok(reader)).await
}

/// Stores what became of an upload; its pieces go.
async fn end(
    app: &App,
    upload: &ResumableUpload,
    taken: &Result<UploadAnswer, Problem>,
) -> Result<(), Problem> {
    let text = taken.as_ref().map(serde_json::to_string);
    let result = match &text {
        Ok(Ok(text)) => Ok(text.as_str()),
        Ok(Err(_)) => Err("its result cannot be written down"),
        Err(problem) => Err(problem.detail()),
    };
    let expires_at = kept_until(app).await?;
    match app.service.store.finish_reading(&upload.id, result, expires_at).await {
        Err(error) if error.is_full() => {
            // There is room once its pieces are gone: all of it is read.
            app.service.uploads.remove(vec![upload.id.clone()]).await?;
            app.service.store.finish_reading(&upload.id, result, expires_at).await?;
        }
        done => done?,
    }
    Ok(app.service.uploads.remove(vec![upload.id.clone()]).await?)
}
