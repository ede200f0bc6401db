//! Uploads: one recording per body, and keys that make repeats safe.

pub(super) mod csv_preview;
mod parameters;
mod piece_reader;
pub(super) mod recording_preview;
pub(super) mod resumable;
mod resumable_upload;
pub(super) mod tus;
pub(super) mod upload_waits;

use std::fs::File;
use std::io::{self, Read};

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::app::App;
use super::problem::Problem;
use super::request::body::{self, SpooledBody};
use super::request::query::{AssetPath, Parameters};
use crate::asset::{AssetId, Segment, SegmentId};
use crate::estimate::WearEstimate;
use crate::recording::JsonBlock;
use crate::service::{Accepted, BatchSummary, ChannelNames, JointWear};
use crate::store::{KeyedUpload, RecordMetadata};
use parameters::UploadParameters;

const MCAP: &str = "application/mcap";
/// Maximum length of an Idempotency-Key in bytes.
const MAX_KEY_BYTES: usize = 255;

/// The result of one channel's record.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(super) enum AcceptedRecord {
    /// The stored segment.
    Stored(Box<Segment>),
    /// The accepted record, if it is analysed after the response: the segment will have this `id`.
    Queued(Box<QueuedSegment>),
}

/// A record that is accepted and will be analysed.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct QueuedSegment {
    /// `queued`.
    state: &'static str,
    #[serde(flatten)]
    record: RecordMetadata,
}

impl From<Accepted> for AcceptedRecord {
    fn from(accepted: Accepted) -> Self {
        match accepted {
            Accepted::Stored(segment) | Accepted::Repeated(segment) => Self::Stored(segment),
            Accepted::Queued(record) => {
                Self::Queued(Box::new(QueuedSegment { state: "queued", record: *record }))
            }
        }
    }
}

/// The result of an upload.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(super) enum UploadAnswer {
    /// One segment, for a single-channel recording.
    One(AcceptedRecord),
    /// One segment per channel.
    Several {
        /// The segments in channel order.
        segments: Vec<AcceptedRecord>,
    },
    /// The results of an MCAP recording's records.
    Recording(Box<RecordingAnswer>),
}

/// The result of a recording with many records.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RecordingAnswer {
    #[serde(flatten)]
    summary: BatchSummary,
    /// The segments of its records, the first 10 000; without those that were already stored.
    segments: Vec<SegmentId>,
    /// The asset's wear after the latest record.
    wear: Option<WearEstimate>,
}

/// Upload a recording
///
/// The response is sent when the record is on disk and in the database; in a cluster, when its bytes are
/// stored and it is in the workers' queue, with the `state` `queued` and the `id` of the future segment. The
/// same bytes for the same asset, channel and time are one segment: a repeat returns that segment in its
/// current state. With an `Idempotency-Key`, a repeat returns the first response, with `Idempotency-Replayed:
/// true`, and a recording without a start time has the time of its first receipt.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/segments",
    tag = "records",
    params(
        UploadParameters,
        ("idempotency-key" = Option<String>, Header, description = "Key of this upload, at most 255 visible characters, kept for 7 days"),
        ("content-encoding" = Option<String>, Header, description = "`gzip` or `zstd`"),
    ),
    request_body(
        content(
            (Vec<u8> = "audio/wav"),
            (Vec<u8> = "audio/flac"),
            (String = "text/csv"),
            (Vec<u8> = "application/x-matlab-data"),
            (Vec<u8> = "application/x-npy"),
            (JsonBlock = "application/json"),
            (Vec<u8> = "application/x-protobuf"),
            (Vec<u8> = "application/mcap"),
            (Vec<u8> = "application/octet-stream"),
        ),
        description = "One recording",
    ),
    responses(
        (status = 201, body = UploadAnswer),
        (status = 409, description = "The key was used for another upload, or the asset uses the sensor of another one"),
    ),
)]
pub(super) async fn upload(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<UploadParameters>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    // Before reading the body, so that an upload to an unknown asset or a full queue costs nothing
    app.service.store.asset(&asset).await?;
    let key = key(&headers)?;
    let media_type = body::media_type(&headers);
    let upload = Upload { app: &app, asset: &asset, params, key };
    upload.respond(media_type.as_deref(), &headers, body).await
}

struct Upload<'a> {
    app: &'a App,
    asset: &'a AssetId,
    params: UploadParameters,
    key: Option<String>,
}

/// A response and its origin.
#[derive(Serialize)]
#[serde(untagged)]
enum UploadResponse {
    /// A new response.
    New(UploadAnswer),
    /// The stored response of an earlier upload with the same key.
    Repeated(Value),
}

impl Upload<'_> {
    async fn respond(
        self,
        media_type: Option<&str>,
        headers: &HeaderMap,
        body: Body,
    ) -> Result<Response, Problem> {
        let outcome = self.take(media_type, headers, body).await?;
        let mut response = (StatusCode::CREATED, Json(&outcome)).into_response();
        if matches!(outcome, UploadResponse::Repeated(_)) {
            let name = HeaderName::from_static("idempotency-replayed");
            response.headers_mut().insert(name, HeaderValue::from_static("true"));
        }
        Ok(response)
    }

    async fn take(
        &self,
        media_type: Option<&str>,
        headers: &HeaderMap,
        body: Body,
    ) -> Result<UploadResponse, Problem> {
        if media_type == Some(MCAP) {
            return self.take_mcap(headers, body).await;
        }
        let format = self.params.format(media_type)?;
        let app = self.app;
        let mut ticket = app.service.workers.admit()?;
        let bytes = body::read(headers, body, app.limits.record_bytes, &app.limits, |bytes| {
            ticket.grow(bytes).map_err(Problem::from)
        })
        .await?;
        let mut metadata = self.params.metadata()?;
        if self.key.is_some() {
            let first = self.begin(&format.media_type(), &Sha256::digest(&bytes)).await?;
            if let Some(response) = self.earlier_response(&first).await? {
                return Ok(response);
            }
            metadata.start_time = Some(metadata.start_time.unwrap_or(first.received_at));
        }
        let work = async {
            let accepted = app.service.pipeline.accept(self.asset, format, bytes, metadata, ticket).await?;
            let mut segments: Vec<AcceptedRecord> = accepted.into_iter().map(AcceptedRecord::from).collect();
            Ok(match segments.pop() {
                Some(segment) if segments.is_empty() => UploadAnswer::One(segment),
                last => {
                    segments.extend(last);
                    UploadAnswer::Several { segments }
                }
            })
        };
        self.store_response(work).await
    }

    /// Processes an upload and stores its response for repeats with the same key.
    async fn store_response(
        &self,
        work: impl Future<Output = Result<UploadAnswer, Problem>>,
    ) -> Result<UploadResponse, Problem> {
        let response = work.await?;
        if let Some(key) = &self.key
            && let Ok(text) = serde_json::to_string(&response)
            && let Some(first) = self.app.service.store.finish_upload(self.asset, key, &text).await?
            && let Ok(first) = serde_json::from_str(&first)
        {
            return Ok(UploadResponse::Repeated(first));
        }
        Ok(UploadResponse::New(response))
    }

    async fn take_mcap(&self, headers: &HeaderMap, body: Body) -> Result<UploadResponse, Problem> {
        let app = self.app;
        let names = self.params.channels_of_recording()?;
        let ticket = app.service.workers.admit()?;
        let spooled = SpooledBody::receive(headers, body, &app.uploads, &app.limits).await?;
        if self.key.is_some()
            && let Some(response) = self.earlier_response(&self.begin(MCAP, spooled.sha256()).await?).await?
        {
            return Ok(response);
        }
        let work = async {
            let path = spooled.path().to_path_buf();
            let response = take_recording(app, self.asset, names, move || File::open(path)).await;
            drop((spooled, ticket));
            response
        };
        self.store_response(work).await
    }

    /// Returns the state of this upload's key, and claims the key if it is new.
    async fn begin(&self, media_type: &str, content: &[u8]) -> Result<KeyedUpload, Problem> {
        let key = self.key.as_deref().unwrap_or_default();
        let mut hash = Sha256::new();
        hash.update(media_type);
        hash.update(serde_json::to_vec(&self.params).unwrap_or_default());
        hash.update(content);
        let digest: String = hex::encode(hash.finalize());
        let first = &self.app.service.store;
        let first = first.begin_upload(self.asset, key, &digest, self.app.service.now()).await?;
        if first.request_sha256 == digest {
            return Ok(first);
        }
        let detail = format!("idempotency-key {key:?} was used for another upload at {}", first.received_at);
        Err(Problem::new(StatusCode::CONFLICT, detail))
    }

    /// The stored response of an earlier upload. If one of its segments was deleted, the response is
    /// forgotten and the upload is processed again.
    async fn earlier_response(&self, first: &KeyedUpload) -> Result<Option<UploadResponse>, Problem> {
        let Some(response) =
            first.response.as_deref().and_then(|text| serde_json::from_str::<Value>(text).ok())
        else {
            return Ok(None);
        };
        let (store, ids) = (&self.app.service.store, stored_in(&response));
        if store.segments_by_id(&ids).await?.len() == ids.len() {
            return Ok(Some(UploadResponse::Repeated(response)));
        }
        store.forget_response(self.asset, self.key.as_deref().unwrap_or_default()).await?;
        Ok(None)
    }
}

/// The segments that a stored response says are stored.
fn stored_in(response: &Value) -> Vec<SegmentId> {
    let one = std::slice::from_ref(response);
    let all = response["segments"].as_array().map_or(one, Vec::as_slice);
    // A queued record is not a segment yet
    let stored = all.iter().filter(|segment| segment["state"] != "queued");
    let ids = stored.filter_map(|segment| segment.as_str().or(segment["id"].as_str()));
    ids.map(|id| SegmentId(id.to_owned())).collect()
}

/// Reads an MCAP recording into an asset.
pub(super) async fn take_recording<R: Read + Send + 'static>(
    app: &App,
    asset: &AssetId,
    names: ChannelNames,
    open: impl FnOnce() -> io::Result<R> + Send + 'static,
) -> Result<UploadAnswer, Problem> {
    let mut summary = app.service.pipeline.accept_recording(asset, names, open).await?;
    let segments = std::mem::take(&mut summary.segments);
    let store = &app.service.store;
    let channels = store.channels(asset).await?;
    let description = store.asset(asset).await?;
    let joint = JointWear::load(store, &JointWear::contributing_channels(&description, &channels)).await?;
    let wear = joint.map(|joint| joint.wear);
    Ok(UploadAnswer::Recording(Box::new(RecordingAnswer { summary, segments, wear })))
}

fn key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let Some(key) = headers.get("idempotency-key") else {
        return Ok(None);
    };
    match key.to_str() {
        Ok(text) if !text.is_empty() && text.len() <= MAX_KEY_BYTES => Ok(Some(text.to_string())),
        _ => Err(Problem::query("idempotency-key", format!("{key:?}"), "1 to 255 visible characters")),
    }
}
