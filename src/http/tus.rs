//! Resumable uploads after tus 1.0 (<https://tus.io/protocols/resumable-upload>): core, creation, termination, expiration.
//!
//! An upload is a file that grows and a description beside it, so that it is resumed after a restart too. When the last byte is
//! there the recording is read in the background like any other; `GET` says what became of it.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use super::body::{self, Pieces, SpooledBody};
use super::problem::{Details, Problem};
use super::query::NameInPath;
use super::router::App;
use super::uploads;
use crate::asset::AssetId;
use crate::ingest::IngestError;

const VERSION: &str = "1.0.0";
const OFFSET_TYPE: &str = "application/offset+octet-stream";
const RESUMABLE: HeaderName = HeaderName::from_static("tus-resumable");
const LENGTH: HeaderName = HeaderName::from_static("upload-length");
const OFFSET: HeaderName = HeaderName::from_static("upload-offset");
const METADATA: HeaderName = HeaderName::from_static("upload-metadata");
const EXPIRES: HeaderName = HeaderName::from_static("upload-expires");

/// How long an upload that does not go on is kept.
const KEPT: SignedDuration = SignedDuration::from_hours(24);

/// Uploads at once.
const MOST_UPLOADS: usize = 64;

/// What an upload is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum UploadState {
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
pub(super) struct ResumableUpload {
    /// Identifier.
    id: String,
    /// The asset whose records it holds.
    asset: AssetId,
    /// Its length in bytes.
    length: u64,
    /// Bytes that are there.
    offset: u64,
    /// What it is doing.
    state: UploadState,
    /// When it goes if nothing more comes.
    expires_at: Timestamp,
    /// What became of its records, once it is finished.
    #[schema(value_type = Option<Object>)]
    result: Option<serde_json::Value>,
    /// Why it failed.
    error: Option<String>,
}

/// All resumable uploads.
#[derive(Debug)]
pub(super) struct ResumableUploads {
    folder: PathBuf,
    most_bytes: u64,
    held: Mutex<BTreeMap<String, Arc<tokio::sync::Mutex<ResumableUpload>>>>,
}

type Held = Arc<tokio::sync::Mutex<ResumableUpload>>;

impl ResumableUploads {
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

    fn find(&self, id: &str) -> Result<Held, Problem> {
        let held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        held.get(id)
            .cloned()
            .ok_or_else(|| Problem::not_found(format!("there is no upload {id:?}")))
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
}

fn file_problem(path: &Path, source: io::Error) -> Problem {
    IngestError::File {
        action: "write",
        path: path.to_path_buf(),
        source,
    }
    .into()
}

fn number(headers: &HeaderMap, name: &HeaderName) -> Result<u64, Problem> {
    let given = headers.get(name);
    given
        .and_then(|value| value.to_str().ok()?.parse().ok())
        .ok_or_else(|| Problem::query(name.as_str(), format!("{given:?}"), "a number of bytes"))
}

fn check_version(headers: &HeaderMap) -> Result<(), Problem> {
    match headers.get(RESUMABLE) {
        Some(version) if version == VERSION => Ok(()),
        version => {
            let detail = format!("tus-resumable is {version:?}, expected {VERSION}");
            Err(Problem::new(StatusCode::PRECONDITION_FAILED, detail))
        }
    }
}

/// The value of a key in `Upload-Metadata`.
fn metadata(headers: &HeaderMap, key: &str) -> Option<String> {
    let text = headers.get(METADATA)?.to_str().ok()?;
    let value = text.split(',').find_map(|pair| {
        let (name, value) = pair.trim().split_once(' ')?;
        (name == key).then_some(value.trim())
    })?;
    String::from_utf8(from_base64(value)?).ok()
}

fn from_base64(text: &str) -> Option<Vec<u8>> {
    let digits = text.trim_end_matches('=').bytes().map(|byte| match byte {
        b'A'..=b'Z' => Some(byte - b'A'),
        b'a'..=b'z' => Some(byte - b'a' + 26),
        b'0'..=b'9' => Some(byte - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    });
    let digits: Vec<u8> = digits.collect::<Option<_>>()?;
    let bytes = digits.chunks(4).flat_map(|chunk| {
        let word = (0..4).fold(0_u32, |word, n| word << 6 | u32::from(chunk.get(n).copied().unwrap_or(0)));
        word.to_be_bytes().into_iter().skip(1).take(chunk.len() * 6 / 8)
    });
    Some(bytes.collect())
}

fn answer(status: StatusCode, upload: &ResumableUpload, more: &[(HeaderName, String)]) -> Response {
    let mut response = status.into_response();
    // RFC 9110's date, as the protocol asks.
    let expires = upload.expires_at.strftime("%a, %d %b %Y %H:%M:%S GMT").to_string();
    let fields = [
        (RESUMABLE, VERSION.to_string()),
        (OFFSET, upload.offset.to_string()),
        (EXPIRES, expires),
    ];
    for (name, value) in fields.iter().chain(more) {
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    }
    response
}

/// Begin a resumable upload (tus 1.0)
///
/// `Upload-Metadata` names the `asset` in base64. The recording is MCAP. `OPTIONS` says what of tus is there.
#[utoipa::path(
    post,
    path = "/v1/uploads",
    tag = "resumable uploads",
    params(
        ("tus-resumable" = String, Header, description = "`1.0.0`"),
        ("upload-length" = u64, Header, description = "Length of the recording in bytes"),
        ("upload-metadata" = String, Header, description = "`asset` and its name in base64"),
    ),
    responses(
        (status = 201, description = "Begun", headers(("location" = String, description = "Its address"))),
        (status = 404, body = Details, content_type = "application/problem+json", description = "There is no such asset"),
        (status = 412, body = Details, content_type = "application/problem+json", description = "Another version of tus"),
        (status = 413, body = Details, content_type = "application/problem+json", description = "Longer than allowed"),
        (status = 507, body = Details, content_type = "application/problem+json", description = "There is no room"),
    ),
)]
pub(super) async fn create(State(app): State<App>, headers: HeaderMap) -> Result<Response, Problem> {
    check_version(&headers)?;
    let length = number(&headers, &LENGTH)?;
    let uploads = &app.resumable;
    if length > uploads.most_bytes {
        return Err(Problem::too_large(uploads.most_bytes));
    }
    let name = metadata(&headers, "asset");
    let asset = name.clone().and_then(|name| AssetId::new(name).ok());
    let asset = asset.ok_or_else(|| Problem::query("upload-metadata", format!("{name:?}"), "asset and its name in base64"))?;
    app.ingest.store().asset(&asset).await?;
    let now = app.ingest.now();
    uploads.sweep(now);
    let mut random = [0; 12];
    getrandom::fill(&mut random).map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    let upload = ResumableUpload {
        id: random.iter().map(|byte| format!("{byte:02x}")).collect(),
        asset,
        length,
        offset: 0,
        state: UploadState::Receiving,
        expires_at: now + KEPT,
        result: None,
        error: None,
    };
    fs::File::create(uploads.path(&upload.id)).map_err(|source| file_problem(&uploads.folder, source))?;
    uploads.keep(&upload)?;
    let location = format!("/v1/uploads/{}", upload.id);
    let response = answer(StatusCode::CREATED, &upload, &[(header::LOCATION, location)]);
    let mut held = uploads.held.lock().unwrap_or_else(PoisonError::into_inner);
    if held.len() >= MOST_UPLOADS {
        drop(held);
        uploads.forget(&upload.id);
        return Err(Problem::busy("too many uploads are under way", 60));
    }
    held.insert(upload.id.clone(), Arc::new(tokio::sync::Mutex::new(upload)));
    Ok(response)
}

/// What of tus is there
#[utoipa::path(options, path = "/v1/uploads", tag = "resumable uploads", responses((status = 204, description = "Its header fields say")))]
pub(super) async fn options(State(app): State<App>) -> Response {
    let fields = [
        (RESUMABLE, VERSION.to_string()),
        (HeaderName::from_static("tus-version"), VERSION.to_string()),
        (
            HeaderName::from_static("tus-extension"),
            "creation,termination,expiration".to_string(),
        ),
        (HeaderName::from_static("tus-max-size"), app.resumable.most_bytes.to_string()),
    ];
    (StatusCode::NO_CONTENT, fields.map(|(name, value)| (name, value))).into_response()
}

/// How far a resumable upload is
#[utoipa::path(
    head,
    path = "/v1/uploads/{upload}",
    tag = "resumable uploads",
    params(("upload" = String, Path, description = "The upload")),
    responses((status = 200, description = "`upload-offset` says how many bytes are there")),
)]
pub(super) async fn offset(State(app): State<App>, NameInPath(id): NameInPath) -> Result<Response, Problem> {
    let upload = app.resumable.find(&id)?;
    let upload = upload.lock().await;
    let more = [(LENGTH, upload.length.to_string()), (header::CACHE_CONTROL, "no-store".to_string())];
    Ok(answer(StatusCode::OK, &upload, &more))
}

/// What became of a resumable upload
#[utoipa::path(
    get,
    path = "/v1/uploads/{upload}",
    tag = "resumable uploads",
    params(("upload" = String, Path, description = "The upload")),
    responses((status = 200, body = ResumableUpload)),
)]
pub(super) async fn show(State(app): State<App>, NameInPath(id): NameInPath) -> Result<Json<ResumableUpload>, Problem> {
    let upload = app.resumable.find(&id)?;
    let upload = upload.lock().await;
    Ok(Json(upload.clone()))
}

/// Go on with a resumable upload
///
/// Bytes that come before the connection is lost are kept; `HEAD` says how many they are.
#[utoipa::path(
    patch,
    path = "/v1/uploads/{upload}",
    tag = "resumable uploads",
    params(
        ("upload" = String, Path, description = "The upload"),
        ("tus-resumable" = String, Header, description = "`1.0.0`"),
        ("upload-offset" = u64, Header, description = "Bytes that are there already"),
    ),
    request_body(content = Vec<u8>, content_type = "application/offset+octet-stream"),
    responses(
        (status = 204, description = "Kept; `upload-offset` says how many bytes are there"),
        (status = 409, body = Details, content_type = "application/problem+json", description = "Another offset, or nothing is missing"),
        (status = 412, body = Details, content_type = "application/problem+json", description = "Another version of tus"),
    ),
)]
pub(super) async fn go_on(State(app): State<App>, NameInPath(id): NameInPath, headers: HeaderMap, body: Body) -> Result<Response, Problem> {
    check_version(&headers)?;
    let media_type = body::media_type(&headers);
    if media_type.as_deref() != Some(OFFSET_TYPE) {
        return Err(body::unsupported(media_type.as_deref(), OFFSET_TYPE));
    }
    let uploads = &app.resumable;
    let held = uploads.find(&id)?;
    let at = number(&headers, &OFFSET)?;
    // Two at once would write over each other.
    let Ok(mut upload) = Arc::clone(&held).try_lock_owned() else {
        return Err(Problem::new(StatusCode::CONFLICT, "the upload is being written to"));
    };
    if upload.state != UploadState::Receiving || upload.offset != at {
        let detail = format!("upload-offset is {at}, expected {} of {}", upload.offset, upload.length);
        return Err(Problem::new(StatusCode::CONFLICT, detail));
    }
    let path = uploads.path(&id);
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
    uploads.keep(&upload)?;
    received?;
    let response = answer(StatusCode::NO_CONTENT, &upload, &[]);
    if upload.offset == upload.length {
        upload.state = UploadState::Reading;
        uploads.keep(&upload)?;
        drop(upload);
        tokio::spawn(read(app.clone(), held));
    }
    Ok(response)
}

/// Reads an upload that is whole, waiting for its turn.
async fn read(app: App, held: Held) {
    let (id, asset) = {
        let upload = held.lock().await;
        (upload.id.clone(), upload.asset.clone())
    };
    let path = app.resumable.path(&id);
    let taken = loop {
        let Ok(ticket) = app.ingest.workers().admit() else {
            tokio::time::sleep(std::time::Duration::from_secs(1)).await;
            continue;
        };
        break uploads::take_recording(&app, &asset, SpooledBody::at(path), ticket).await;
    };
    let mut upload = held.lock().await;
    match taken {
        Ok(taken) => {
            upload.state = UploadState::Finished;
            upload.result = serde_json::to_value(taken).ok();
        }
        Err(problem) => {
            upload.state = UploadState::Failed;
            upload.error = Some(problem.detail().to_string());
        }
    }
    if let Err(problem) = app.resumable.keep(&upload) {
        tracing::warn!(upload = id, problem = problem.detail(), "end of an upload not kept");
    }
}

/// Give a resumable upload up
#[utoipa::path(
    delete,
    path = "/v1/uploads/{upload}",
    tag = "resumable uploads",
    params(("upload" = String, Path, description = "The upload")),
    responses((status = 204, description = "Gone"), (status = 409, body = Details, content_type = "application/problem+json", description = "It is being written to or read")),
)]
pub(super) async fn give_up(State(app): State<App>, NameInPath(id): NameInPath) -> Result<Response, Problem> {
    let held = app.resumable.find(&id)?;
    match held.try_lock() {
        Ok(upload) if upload.state != UploadState::Reading => {}
        _ => return Err(Problem::new(StatusCode::CONFLICT, "the upload is being written to or read")),
    }
    app.resumable.forget(&id);
    Ok((StatusCode::NO_CONTENT, [(RESUMABLE, VERSION)]).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_is_read_from_base64() {
        let mut headers = HeaderMap::new();
        headers.insert(METADATA, HeaderValue::from_static("filename cnVuLm1jYXA=,asset cHVtcA=="));
        assert_eq!(metadata(&headers, "asset").as_deref(), Some("pump"));
        assert_eq!(metadata(&headers, "filename").as_deref(), Some("run.mcap"));
        assert!(metadata(&headers, "none").is_none());
        for (text, bytes) in [("", &b""[..]), ("AA==", b"\0"), ("/+8=", b"\xff\xef"), ("QUJD", b"ABC")] {
            assert_eq!(from_base64(text).as_deref(), Some(bytes), "{text}");
        }
        assert!(from_base64("a b").is_none());
    }
}
