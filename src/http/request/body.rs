//! Reads request bodies: bytes are counted as they arrive and limited.

use std::future::poll_fn;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody};
use axum::extract::{FromRequest, Request};
use axum::http::{HeaderMap, StatusCode, header};
use bytes::Bytes;
use futures_util::FutureExt;
use serde::de::{DeserializeOwned, IgnoredAny};
use sha2::{Digest, Sha256};
use tokio::io::AsyncWriteExt;

use super::content_encoding::{ContentEncoding, STEP};
use super::json_error;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::server::limits::HttpLimits;
use crate::recording::Format;
use crate::service::ServiceError;

/// The media type of a body in lower case, without parameters; `None` if the client does not send one.
pub(crate) fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

/// The problem for a body with none of the `expected` media types, or with an unsupported content encoding.
pub(crate) fn unsupported(found: Option<&str>, expected: &str) -> Problem {
    let found = found.unwrap_or("missing");
    Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, format!("content-type is {found}, expected {expected}"))
}

/// Longer than any stream.
const ENDLESS: Duration = Duration::from_secs(100 * 365 * 24 * 3600);

/// The bytes of a request's body as they arrive. Size, total time and minimum rate are limited, because a
/// body occupies a place in the queue.
pub(crate) struct BodySource {
    body: Body,
    began: Instant,
    deadline: Instant,
    idle: Duration,
    bytes_per_s: u64,
    bytes: u64,
    max: u64,
}

impl BodySource {
    /// Reads at most `max` bytes of a body.
    pub(crate) fn new(body: Body, max: u64, limits: &HttpLimits) -> Self {
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

    /// Reads a body of unlimited length and duration, as long as bytes keep arriving.
    pub(crate) fn endless(body: Body, limits: &HttpLimits) -> Self {
        let source = Self::new(body, u64::MAX, limits);
        Self { deadline: source.began + ENDLESS, bytes_per_s: 0, ..source }
    }

    /// Returns bytes that have already arrived; `None` if there are none now.
    pub(crate) async fn next_now(&mut self) -> Result<Option<Bytes>, Problem> {
        next_piece(&mut self.body).now_or_never().unwrap_or(Ok(None))
    }

    /// Returns the next bytes; `None` at the end.
    pub(crate) async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        let slow = |what: String| Problem::new(StatusCode::REQUEST_TIMEOUT, what);
        let until = self.deadline.min(Instant::now() + self.idle);
        let Ok(next) = tokio::time::timeout_at(until.into(), next_piece(&mut self.body)).await else {
            return Err(slow(if until == self.deadline {
                format!("the body took longer than {} s", (self.deadline - self.began).as_secs())
            } else {
                format!("no bytes of the body arrived for {} s", self.idle.as_secs())
            }));
        };
        let Some(piece) = next? else { return Ok(None) };
        self.bytes += piece.len() as u64;
        if self.bytes > self.max {
            return Err(Problem::too_large(self.max));
        }
        let elapsed = self.began.elapsed();
        if elapsed > self.idle && self.bytes < elapsed.as_secs() * self.bytes_per_s {
            return Err(slow(format!(
                "the body arrived with less than {} bytes per second",
                self.bytes_per_s
            )));
        }
        Ok(Some(piece))
    }
}

/// A body without its content encoding; the decoded bytes are counted too.
struct DecodedBody {
    source: BodySource,
    /// `None` once the body has ended.
    encoding: Option<ContentEncoding>,
    /// Bytes received but not yet decoded.
    piece: Bytes,
    bytes: u64,
    max: u64,
}

impl DecodedBody {
    /// Decodes at most `max` bytes.
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

    /// Returns the next decoded bytes, possibly none yet; `None` at the end.
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

/// Reads a whole body, decoded, of at most `max` bytes; `take` reserves memory for the bytes before they are
/// buffered.
pub(crate) async fn read(
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

/// Reads the body of a description (JSON or TOML), limited to `description_bytes`.
pub(crate) async fn read_description(
    headers: &HeaderMap,
    body: Body,
    limits: &HttpLimits,
) -> Result<Bytes, Problem> {
    read(headers, body, limits.description_bytes, limits, |_| Ok(())).await
}

/// Reads and parses a JSON body within the limit for descriptions.
pub(crate) async fn json_body<T: DeserializeOwned>(
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

/// A JSON body within the limit for descriptions.
pub(crate) struct JsonBody<T>(pub(crate) T);

impl<T: DeserializeOwned> FromRequest<App> for JsonBody<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &App) -> Result<Self, Problem> {
        let (parts, body) = request.into_parts();
        json_body(&app.limits, &parts.headers, body).await.map(Self)
    }
}

/// Number of bytes that identify a recording's format.
const MAGIC_BYTES: usize = 16;

fn check_mcap(beginning: &[u8]) -> Result<(), Problem> {
    match Format::detect(beginning)? {
        Format::Mcap => Ok(()),
        other => {
            let detail =
                format!("the recording is {}, expected MCAP according to content-type", other.name());
            Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail))
        }
    }
}

/// A body in a temporary file, which is removed on drop.
pub(crate) struct SpooledBody {
    path: PathBuf,
    sha256: Vec<u8>,
}

impl SpooledBody {
    /// Writes a whole MCAP body, decoded, to a file in `folder`.
    pub(crate) async fn receive(
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
            // A small compressed body of another format must not grow to gigabytes before it is recognised.
            if let Some(first) = beginning.as_mut() {
                first.extend_from_slice(&bytes[..bytes.len().min(MAGIC_BYTES)]);
                if first.len() >= MAGIC_BYTES {
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

    /// Wraps an existing file.
    pub(crate) fn at(path: PathBuf) -> Self {
        Self { path, sha256: Vec::new() }
    }

    /// SHA-256 of the received bytes.
    pub(crate) fn sha256(&self) -> &[u8] {
        &self.sha256
    }

    /// The path of the file.
    pub(crate) fn path(&self) -> &Path {
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

/// Parses a JSON object: 400 if the bytes are not JSON, 422 if they do not match the type.
pub(crate) fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    // Types would take the elements of an array as their fields in order.
    if bytes.trim_ascii_start().starts_with(b"[") && serde_json::from_slice::<IgnoredAny>(bytes).is_ok() {
        let detail = "invalid body: an array, expected an object with named fields";
        return Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail));
    }
    serde_json::from_slice(bytes).map_err(|error| json_error::problem::<T>(bytes, &error))
}

/// The announced length of a body.
fn announced(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

async fn next_piece(body: &mut Body) -> Result<Option<Bytes>, Problem> {
    loop {
        let frame = poll_fn(|context| Pin::new(&mut *body).poll_frame(context)).await;
        match frame {
            None => return Ok(None),
            Some(Ok(frame)) => {
                // Trailers are not used
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_is_not_taken_for_an_object() {
        #[derive(Debug, serde::Deserialize)]
        struct Named {
            name: String,
        }
        let problem = from_json::<Named>(br#" ["x"]"#).unwrap_err();
        assert!(problem.detail().contains("an array, expected an object"), "{}", problem.detail());
        assert_eq!(from_json::<Named>(br#" {"name": "x"}"#).unwrap().name, "x");
    }
}
