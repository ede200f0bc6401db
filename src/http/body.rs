//! Reading bodies: bytes are counted as they come, and no more are taken than allowed.

use std::future::poll_fn;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody};
use axum::http::{HeaderMap, StatusCode, header};
use bytes::Bytes;
use futures_util::FutureExt;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use tokio::io::AsyncWriteExt;

use super::content_encoding::{ContentEncoding, STEP};
use super::limits::HttpLimits;
use super::problem::Problem;
use crate::recording::Format;
use crate::service::ServiceError;

/// The media type of a body without its parameters, in lower case; none where the client does not say.
pub(super) fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

/// The problem of a body that is of none of the `expected` media types, or of a coding of its content.
pub(super) fn unsupported(found: Option<&str>, expected: &str) -> Problem {
    let found = found.unwrap_or("missing");
    Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, format!("content-type is {found}, expected {expected}"))
}

/// Longer than any stream.
const ENDLESS: Duration = Duration::from_secs(100 * 365 * 24 * 3600);

/// The bytes of a request's body as they come: no more than allowed, none after the time that a body may
/// take, and none that come too slowly, since a body holds a place in the queue.
pub(super) struct BodySource {
    body: Body,
    began: Instant,
    deadline: Instant,
    idle: Duration,
    bytes_per_s: u64,
    bytes: u64,
    max: u64,
}

impl BodySource {
    /// At most `max` bytes of a body.
    pub(super) fn new(body: Body, max: u64, limits: &HttpLimits) -> Self {
        let began = Instant::now();
        Self {
            body,
            began,
            deadline: began + limits.body_timeout,
            idle: limits.body_idle,
            bytes_per_s: limits.body_bytes_per_s,
            bytes: 0,
            max,
        }
    }

    /// A body without an end: it may take as long as something comes.
    pub(super) fn endless(body: Body, limits: &HttpLimits) -> Self {
        let source = Self::new(body, u64::MAX, limits);
        Self { deadline: source.began + ENDLESS, bytes_per_s: 0, ..source }
    }

    /// Bytes that have come already; none where there are none now.
    pub(super) async fn next_now(&mut self) -> Result<Option<Bytes>, Problem> {
        next_piece(&mut self.body).now_or_never().unwrap_or(Ok(None))
    }

    /// The next bytes; none at the end.
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        let slow = |what: String| Problem::new(StatusCode::REQUEST_TIMEOUT, what);
        let until = self.deadline.min(Instant::now() + self.idle);
        let Ok(next) = tokio::time::timeout_at(until.into(), next_piece(&mut self.body)).await else {
            return Err(slow(if until == self.deadline {
                format!("the body took longer than {} s", (self.deadline - self.began).as_secs())
            } else {
                format!("nothing of the body came for {} s", self.idle.as_secs())
            }));
        };
        let Some(piece) = next? else { return Ok(None) };
        self.bytes += piece.len() as u64;
        if self.bytes > self.max {
            return Err(Problem::too_large(self.max));
        }
        let elapsed = self.began.elapsed();
        if elapsed > self.idle && self.bytes < elapsed.as_secs() * self.bytes_per_s {
            return Err(slow(format!("the body came with less than {} bytes a second", self.bytes_per_s)));
        }
        Ok(Some(piece))
    }
}

/// A body without its content encoding; what comes out is counted too.
struct DecodedBody {
    source: BodySource,
    /// None once the body is over.
    encoding: Option<ContentEncoding>,
    /// What came and is not decoded yet.
    piece: Bytes,
    bytes: u64,
    max: u64,
}

impl DecodedBody {
    /// At most `max` decoded bytes.
    fn new(headers: &HeaderMap, body: Body, max: u64, limits: &HttpLimits) -> Result<Self, Problem> {
        if announced(headers).is_some_and(|length| length > max) {
            return Err(Problem::too_large(max));
        }
        Ok(Self {
            source: BodySource::new(body, u64::MAX, limits),
            encoding: Some(ContentEncoding::of(headers)?),
            piece: Bytes::new(),
            bytes: 0,
            max,
        })
    }

    /// The next decoded bytes, which may be none yet; nothing at the end.
    async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        let Some(encoding) = &mut self.encoding else {
            return Ok(None);
        };
        if self.piece.is_empty()
            && let Some(piece) = self.source.next().await?
        {
            self.piece = piece;
        }
        let mut decoded = Vec::new();
        let bytes = if self.piece.is_empty() {
            if let Some(encoding) = self.encoding.take() {
                encoding.finish(&mut decoded)?;
            }
            Bytes::from(decoded)
        } else if encoding.is_identity() {
            std::mem::take(&mut self.piece)
        } else {
            let step = self.piece.split_to(self.piece.len().min(STEP));
            encoding.decode(&step, &mut decoded)?;
            Bytes::from(decoded)
        };
        self.bytes += bytes.len() as u64;
        if self.bytes > self.max {
            return Err(Problem::too_large(self.max));
        }
        Ok(Some(bytes))
    }
}

/// The whole of a body, decoded, at most `max` bytes; `take` is told of all bytes before they are held.
pub(super) async fn read(
    headers: &HeaderMap,
    body: Body,
    max: usize,
    limits: &HttpLimits,
    mut take: impl FnMut(usize) -> Result<(), Problem>,
) -> Result<Bytes, Problem> {
    let mut body = DecodedBody::new(headers, body, max as u64, limits)?;
    let expected = usize::try_from(announced(headers).unwrap_or(0)).unwrap_or(0);
    let mut all = Vec::with_capacity(expected.min(1 << 20));
    while let Some(bytes) = body.next().await? {
        take(bytes.len())?;
        all.extend_from_slice(&bytes);
    }
    Ok(Bytes::from(all))
}

/// The body of a description (JSON or TOML), at most as long as such a body may be.
pub(super) async fn read_description(
    headers: &HeaderMap,
    body: Body,
    limits: &HttpLimits,
) -> Result<Bytes, Problem> {
    read(headers, body, limits.description_bytes, limits, |_| Ok(())).await
}

/// What a JSON body describes, read whole within the limit on descriptions.
pub(super) async fn described<T: DeserializeOwned>(
    limits: &HttpLimits,
    headers: &HeaderMap,
    body: Body,
) -> Result<T, Problem> {
    let media_type = media_type(headers);
    if media_type.as_deref() != Some("application/json") {
        return Err(unsupported(media_type.as_deref(), "application/json"));
    }
    from_json(&read_description(headers, body, limits).await?)
}

/// Bytes that say what a recording is.
const BEGINNING: usize = 16;

fn check_mcap(beginning: &[u8]) -> Result<(), Problem> {
    match Format::detect(beginning).map_err(ServiceError::from)? {
        Format::Mcap => Ok(()),
        other => {
            let detail = format!("the recording is {}, expected MCAP as content-type says", other.name());
            Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail))
        }
    }
}

/// A body in a file, removed when dropped.
pub(super) struct SpooledBody {
    path: PathBuf,
    sha256: Vec<u8>,
}

impl SpooledBody {
    /// Writes the whole of a body that is to be MCAP, decoded, to a file in `folder`.
    pub(super) async fn receive(
        headers: &HeaderMap,
        body: Body,
        folder: &Path,
        limits: &HttpLimits,
    ) -> Result<Self, Problem> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let mut body = DecodedBody::new(headers, body, limits.recording_bytes, limits)?;
        let mut spooled = Self::at(folder.join(COUNTER.fetch_add(1, Ordering::Relaxed).to_string()));
        let failed = |source| {
            Problem::from(ServiceError::File { action: "write", path: folder.to_path_buf(), source })
        };
        let file = tokio::fs::File::create(&spooled.path).await.map_err(failed)?;
        let mut file = tokio::io::BufWriter::with_capacity(1 << 20, file);
        let mut hash = Sha256::new();
        let mut beginning = Some(Vec::new());
        while let Some(bytes) = body.next().await? {
            // A small body that says to be another one must not become gigabytes before that is seen.
            if let Some(first) = beginning.as_mut() {
                first.extend_from_slice(&bytes[..bytes.len().min(BEGINNING)]);
                if first.len() >= BEGINNING {
                    check_mcap(first)?;
                    beginning = None;
                }
            }
            hash.update(&bytes);
            file.write_all(&bytes).await.map_err(failed)?;
        }
        if let Some(whole) = beginning {
            check_mcap(&whole)?;
        }
        file.flush().await.map_err(failed)?;
        spooled.sha256 = hash.finalize().to_vec();
        Ok(spooled)
    }

    /// A file that is there already.
    pub(super) fn at(path: PathBuf) -> Self {
        Self { path, sha256: Vec::new() }
    }

    /// SHA-256 of what was received.
    pub(super) fn sha256(&self) -> &[u8] {
        &self.sha256
    }

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for SpooledBody {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_file(&self.path) {
            tracing::debug!(file = %self.path.display(), %error, "failed to remove the file of a body");
        }
    }
}

/// What JSON bytes say: 400 where they are not JSON, 422 where they are but do not fit.
pub(super) fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    serde_json::from_slice(bytes).map_err(|error| {
        let message = error.to_string();
        let status = match error.classify() {
            serde_json::error::Category::Data => StatusCode::UNPROCESSABLE_ENTITY,
            _ => StatusCode::BAD_REQUEST,
        };
        Problem::new(status, format!("the body cannot be used: {message}")).naming_field_in(&message)
    })
}

/// The length that a body says it has.
fn announced(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

async fn next_piece(body: &mut Body) -> Result<Option<Bytes>, Problem> {
    loop {
        let frame = poll_fn(|context| Pin::new(&mut *body).poll_frame(context)).await;
        match frame {
            None => return Ok(None),
            Some(Ok(frame)) => {
                // Trailers carry nothing that is asked for.
                if let Ok(piece) = frame.into_data() {
                    return Ok(Some(piece));
                }
            }
            Some(Err(error)) => {
                return Err(Problem::new(
                    StatusCode::BAD_REQUEST,
                    format!("the body ended before it was complete: {error}"),
                ));
            }
        }
    }
}
