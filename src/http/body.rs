//! Reading bodies: bytes are counted as they come, and no more are taken than allowed.

use std::future::poll_fn;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use axum::body::{Body, HttpBody};
use axum::http::{HeaderMap, StatusCode, header};
use bytes::Bytes;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use tokio::io::AsyncWriteExt;

use super::coding::Coding;
use super::limits::HttpLimits;
use super::problem::Problem;

/// The media type of a body without its parameters, in lower case; none where the client does not say.
pub(super) fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

/// The problem of a body that is of none of the `expected` media types, or of a coding of its content.
pub(super) fn unsupported(found: Option<&str>, expected: &str) -> Problem {
    let found = found.unwrap_or("missing");
    Problem::new(
        StatusCode::UNSUPPORTED_MEDIA_TYPE,
        format!("content-type is {found}, expected {expected}"),
    )
}

/// Where the pieces of what is read come from.
pub(super) enum Pieces<'a> {
    /// A request's body.
    Body(Body),
    /// A part of a form.
    Role(Box<multer::Field<'a>>),
}

impl Pieces<'_> {
    /// The next piece; none at the end.
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        match self {
            Self::Body(body) => next_piece(body).await,
            Self::Role(part) => part.chunk().await.map_err(broken_form),
        }
    }
}

/// How fast a body comes.
pub(super) struct Arrival {
    began: Instant,
    bytes: u64,
}

impl Arrival {
    pub(super) fn begin() -> Self {
        Self {
            began: Instant::now(),
            bytes: 0,
        }
    }

    /// The next piece; a problem where nothing comes, or what comes is a trickle: it holds a place in the queue.
    pub(super) async fn next(&mut self, pieces: &mut Pieces<'_>, limits: &HttpLimits) -> Result<Option<Bytes>, Problem> {
        let slow = |what: String| Problem::new(StatusCode::REQUEST_TIMEOUT, what);
        let idle = limits.body_idle;
        let piece = tokio::time::timeout(idle, pieces.next()).await;
        let piece = piece.map_err(|_| slow(format!("nothing of the body came for {} s", idle.as_secs())))??;
        self.bytes += piece.as_ref().map_or(0, |piece| piece.len() as u64);
        let elapsed = self.began.elapsed();
        if piece.is_some() && elapsed > idle && self.bytes < elapsed.as_secs() * limits.body_bytes_per_s {
            let detail = format!("the body came with less than {} bytes a second", limits.body_bytes_per_s);
            return Err(slow(detail));
        }
        Ok(piece)
    }
}

/// The problem of a form that cannot be read.
pub(super) fn broken_form(error: multer::Error) -> Problem {
    if let multer::Error::StreamSizeExceeded { limit } = error {
        return Problem::too_large(limit);
    }
    Problem::new(StatusCode::BAD_REQUEST, format!("the form cannot be read: {error}"))
}

/// A text field of a form, at most `most` bytes.
pub(super) async fn text(mut part: multer::Field<'_>, most: usize) -> Result<String, Problem> {
    let mut text = Vec::new();
    while let Some(piece) = part.chunk().await.map_err(broken_form)? {
        if text.len() + piece.len() > most {
            return Err(Problem::too_large(most as u64));
        }
        text.extend_from_slice(&piece);
    }
    String::from_utf8(text).map_err(|error| Problem::new(StatusCode::BAD_REQUEST, format!("a field of the form is not UTF-8: {error}")))
}

/// The whole of what comes, decoded, at most `most` bytes; `take` is told of every piece as it is kept.
pub(super) async fn read(
    headers: &HeaderMap,
    mut pieces: Pieces<'_>,
    most: usize,
    limits: &HttpLimits,
    mut take: impl FnMut(usize) -> Result<(), Problem>,
) -> Result<Bytes, Problem> {
    let announced = announced(headers, most as u64)?;
    let mut coding = Coding::of(headers)?;
    let all = async {
        let mut all = Vec::with_capacity(usize::try_from(announced.unwrap_or(0)).unwrap_or(0).min(1 << 20));
        let mut kept = |all: &Vec<u8>, before: usize| {
            if all.len() > most {
                return Err(Problem::too_large(most as u64));
            }
            take(all.len() - before)
        };
        let mut arrival = Arrival::begin();
        while let Some(piece) = arrival.next(&mut pieces, limits).await? {
            for step in coding.steps(&piece) {
                let before = all.len();
                coding.decode(step, &mut all)?;
                kept(&all, before)?;
            }
        }
        let before = all.len();
        coding.finish(&mut all)?;
        kept(&all, before)?;
        Ok(Bytes::from(all))
    };
    within(limits, all).await
}

/// The body of a description (JSON or TOML), at most as long as such a body may be.
pub(super) async fn read_description(headers: &HeaderMap, body: Body, limits: &HttpLimits) -> Result<Bytes, Problem> {
    read(headers, Pieces::Body(body), limits.description_bytes, limits, |_| Ok(())).await
}

/// What a JSON body describes, read whole within the limit on descriptions.
pub(super) async fn described<T: DeserializeOwned>(limits: &HttpLimits, headers: &HeaderMap, body: Body) -> Result<T, Problem> {
    let media_type = media_type(headers);
    if media_type.as_deref() != Some("application/json") {
        return Err(unsupported(media_type.as_deref(), "application/json"));
    }
    from_json(&read_description(headers, body, limits).await?)
}

/// A body in a file, removed when dropped unless it is somebody else's.
pub(super) struct SpooledBody {
    path: PathBuf,
    sha256: Vec<u8>,
    is_kept: bool,
}

impl SpooledBody {
    /// Writes the whole of what comes, decoded, to a file in `folder`.
    pub(super) async fn receive(headers: &HeaderMap, mut pieces: Pieces<'_>, folder: &Path, limits: &HttpLimits) -> Result<Self, Problem> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let most = limits.recording_bytes;
        announced(headers, most)?;
        let mut coding = Coding::of(headers)?;
        let mut spooled = Self::at(folder.join(COUNTER.fetch_add(1, Ordering::Relaxed).to_string()));
        let failed = |source| {
            Problem::from(crate::service::ServiceError::File {
                action: "write",
                path: folder.to_path_buf(),
                source,
            })
        };
        let path = spooled.path.clone();
        let write = async {
            let file = tokio::fs::File::create(&path).await.map_err(failed)?;
            let mut file = tokio::io::BufWriter::with_capacity(1 << 20, file);
            let mut hash = Sha256::new();
            let mut written = 0;
            let mut out = Vec::new();
            let mut is_over = false;
            let mut arrival = Arrival::begin();
            while !is_over {
                match arrival.next(&mut pieces, limits).await? {
                    Some(piece) => {
                        for step in coding.steps(&piece) {
                            out.clear();
                            coding.decode(step, &mut out)?;
                            written += out.len() as u64;
                            if written > most {
                                return Err(Problem::too_large(most));
                            }
                            hash.update(&out);
                            file.write_all(&out).await.map_err(failed)?;
                        }
                    }
                    None => is_over = true,
                }
            }
            out.clear();
            coding.finish(&mut out)?;
            hash.update(&out);
            file.write_all(&out).await.map_err(failed)?;
            file.flush().await.map_err(failed)?;
            Ok(hash.finalize().to_vec())
        };
        spooled.sha256 = within(limits, write).await?;
        Ok(spooled)
    }

    /// A file that is there already.
    pub(super) fn at(path: PathBuf) -> Self {
        Self {
            path,
            sha256: Vec::new(),
            is_kept: false,
        }
    }

    /// A file that is there already and stays.
    pub(super) fn kept_at(path: PathBuf) -> Self {
        Self {
            path,
            sha256: Vec::new(),
            is_kept: true,
        }
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
        if !self.is_kept
            && let Err(error) = std::fs::remove_file(&self.path)
        {
            tracing::debug!(file = %self.path.display(), %error, "upload file not removed");
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

/// Refuses a body that says itself that it is too long.
fn announced(headers: &HeaderMap, most: u64) -> Result<Option<u64>, Problem> {
    let length = headers
        .get(header::CONTENT_LENGTH)
        .and_then(|value| value.to_str().ok()?.parse().ok());
    match length {
        Some(length) if length > most => Err(Problem::too_large(most)),
        length => Ok(length),
    }
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

async fn within<T>(limits: &HttpLimits, reading: impl Future<Output = Result<T, Problem>>) -> Result<T, Problem> {
    tokio::time::timeout(limits.body_timeout, reading).await.unwrap_or_else(|_| {
        Err(Problem::new(
            StatusCode::REQUEST_TIMEOUT,
            format!("the body took longer than {} s", limits.body_timeout.as_secs()),
        ))
    })
}
