//! Live streams: chunks in request bodies, status, and levels.

pub(super) mod campaigns;
pub(super) mod levels;
pub(super) mod live_view;
mod socket;
mod views;

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Extension;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::{HeaderMap, Method, StatusCode};
use axum::response::{IntoResponse, Response};
use bytes::{Bytes, BytesMut};
use jiff::Timestamp;
use serde::de::Error;
use serde::{Deserialize, Deserializer};

use super::access::TokenWatch;
use super::access::client::{Client, ClientPermit};
use super::access::issued_tokens::by;
use super::access::session::Caller;
use super::app::App;
use super::problem::Problem;
use super::request::body::{self, BodySource};
use super::request::query::{AssetPath, Parameters};
use super::server::connections::closing;
use crate::asset::{AssetId, DEFAULT_STREAM};
use crate::recording::RawSample;
use crate::recording::stream::{Chunk, MAX_INDEX, StreamFormat};
use crate::service::{ServiceError, StreamSender};
use crate::store::StoreError;
use views::{KeptView, StreamAnswer, StreamList, StreamView};

const RAW: &str = "application/octet-stream";

/// Bytes of a body processed at a time.
const CHUNK_BYTES: usize = 1 << 20;

/// Interval at which the token and the asset of a stream are checked.
const CHECK_INTERVAL: Duration = Duration::from_secs(2);

/// Stream parameters in the address.
#[derive(Debug, Clone, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct StreamParameters {
    /// The stream's name within the asset, default `main`.
    name: Option<String>,
    /// Sample format, `f32` or `i16`, little-endian, channels interleaved. Required for sending.
    #[param(example = "f32")]
    sample: Option<String>,
    /// Sampling rate in hertz. Required for sending.
    #[param(example = 25600.0)]
    sample_rate_hz: Option<f64>,
    /// Number of channels, default 1.
    channels: Option<u16>,
    /// Value of one count in `unit`; default 1 for `f32`, 1/32768 for `i16`.
    scale: Option<f64>,
    /// Unit of the samples; by default the asset's.
    #[param(example = "m/s2")]
    unit: Option<String>,
    /// Names of the channels in order, comma-separated.
    channel_names: Option<String>,
    /// Name of the channel that is the signal of a tachometer on the driving shaft: records get its pulses
    /// instead of the channel.
    tachometer_channel: Option<String>,
    /// Level in `unit` at which a pulse begins. Required with `tachometer_channel`.
    tachometer_level: Option<f64>,
    /// By how much the signal falls below the level between two pulses; default half the level.
    tachometer_hysteresis: Option<f64>,
    /// Pulses per revolution of `tachometer_channel`, default 1.
    pulses_per_revolution: Option<u32>,
    /// Index of the first sample in the body; by default the next one. For a new stream over a WebSocket: its
    /// first index.
    #[serde(default, deserialize_with = "sample_index")]
    #[param(maximum = 9007199254740991_i64)]
    first_index: Option<u64>,
    /// When the first sample in the body was measured.
    #[param(ignore)]
    start_time: Option<Timestamp>,
    /// No samples before `first_index` will follow: missing ones are a gap at once.
    #[serde(default)]
    #[param(ignore)]
    after_gap: bool,
}

/// Parses the index of a sample.
fn sample_index<'de, D: Deserializer<'de>>(given: D) -> Result<Option<u64>, D::Error> {
    let index = Option::<u64>::deserialize(given)?;
    match index.filter(|index| *index >= MAX_INDEX) {
        Some(index) => Err(D::Error::custom(format!("the index is {index}, expected a number below 2^53"))),
        None => Ok(index),
    }
}

/// A stream of an asset.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct StreamName {
    /// The stream's name, default `main`.
    name: Option<String>,
}

/// The samples to store as a record.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct KeepParameters {
    /// The stream's name, default `main`.
    name: Option<String>,
    /// Number of seconds, at most 60, default 10.
    #[param(minimum = 0.1, maximum = 60)]
    seconds: Option<f64>,
}

impl StreamParameters {
    fn format(&self) -> Result<StreamFormat, Problem> {
        let missing = |field| Problem::query(field, "missing", "a value, as raw samples do not contain it");
        let sample: RawSample = self.sample.as_deref().ok_or_else(|| missing("sample"))?.parse()?;
        let rate_hz = self.sample_rate_hz.ok_or_else(|| missing("sample_rate_hz"))?;
        let names = self.channel_names.iter().flat_map(|names| names.split(','));
        let names = names.map(|name| name.trim().to_owned()).collect();
        let format = StreamFormat::new(sample, rate_hz, self.channels.unwrap_or(1).into(), self.scale)
            .and_then(|format| format.with_names(self.unit.clone(), names))?;
        self.with_tachometer(format)
    }

    fn with_tachometer(&self, format: StreamFormat) -> Result<StreamFormat, Problem> {
        let Some(channel) = &self.tachometer_channel else {
            let is_without = self.tachometer_level.is_none()
                && self.tachometer_hysteresis.is_none()
                && self.pulses_per_revolution.is_none();
            let expected = "the name of a channel, as other parameters of a tachometer are given";
            let missing = || Problem::query("tachometer_channel", "missing", expected);
            return is_without.then_some(format).ok_or_else(missing);
        };
        let expected = "the level at which a pulse begins, required with tachometer_channel";
        let missing = || Problem::query("tachometer_level", "missing", expected);
        let level = self.tachometer_level.ok_or_else(missing)?;
        let of_revolution = self.pulses_per_revolution.unwrap_or(1);
        Ok(format.with_tachometer(channel.trim(), level, self.tachometer_hysteresis, of_revolution)?)
    }

    fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(DEFAULT_STREAM)
    }

    /// Refuses what only the samples of a body have.
    fn check_without_body(&self) -> Result<(), Problem> {
        if let Some(start_time) = self.start_time {
            let expected = "no start time in a GET: over a WebSocket each message has its time";
            return Err(Problem::query("start_time", start_time, expected));
        }
        if self.after_gap {
            let expected = "false in a GET: over a WebSocket a message `gap` says so";
            return Err(Problem::query("after_gap", true, expected));
        }
        Ok(())
    }
}

/// An open stream, with its place in the limit on streams.
pub(super) struct OpenStream {
    pub(super) sender: StreamSender,
    pub(super) permit: ClientPermit,
}

async fn open(
    app: &App,
    asset: &AssetId,
    params: &StreamParameters,
    client: Client,
) -> Result<OpenStream, Problem> {
    if let Some(what) = app.service.store.damage() {
        return Err(Problem::busy(format!("the database is damaged: {what}; writing is disabled"), 60));
    }
    let format = params.format()?;
    let too_many = || Problem::busy("too many live streams of this client or in total", 30);
    let permit = app.service.stream_limiter.try_acquire(client).ok_or_else(too_many)?;
    let sender = app.service.streams.open(asset, params.name(), format, params.first_index).await?;
    Ok(OpenStream { sender, permit })
}

/// Send a live stream, or get its status
///
/// With `Upgrade: websocket`, the request starts sending the stream: samples in binary messages, acknowledged
/// by index once stored (`docs/streams.md`). That needs a token with the scope `write`. Without the upgrade,
/// the answer is the stream's status.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/stream",
    tag = "streams",
    params(StreamParameters),
    responses(
        (status = 200, body = StreamView),
        (status = 101, description = "Messages of `docs/streams.md` follow"),
        (status = 409, description = "The stream has another format"),
        (status = 422, description = "Invalid format"),
    ),
)]
pub(super) async fn connect(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<StreamParameters>,
    client: Client,
    caller: Option<Extension<Caller>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    params.check_without_body()?;
    let Ok(upgrade) = upgrade else {
        let status = app.service.streams.status(&asset, params.name()).await?;
        return Ok(Json(StreamView::from(status)).into_response());
    };
    let stream = match open(&app, &asset, &params, client).await {
        Ok(stream) => stream,
        // The connection would stay idle while others need its place
        Err(problem) => return Ok(closing(problem.into_response())),
    };
    let caller = caller.map(|Extension(caller)| caller);
    Ok(socket::upgrade(upgrade, app, stream, caller))
}

/// Send a part of a live stream
///
/// The body is raw samples of any length; it may be chunked and of unknown length. It is stored as it arrives
/// and answered at its end with the `next` index. Samples that are already stored are skipped. If the body
/// breaks off, the received part is kept: get `next` from the stream's status and continue from there.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/stream",
    tag = "streams",
    params(
        StreamParameters,
        ("start_time" = Option<Timestamp>, Query, description = "When the first sample in the body was measured"),
        ("after_gap" = Option<bool>, Query, description = "No samples before `first_index` will follow: missing ones are a gap at once; default false"),
    ),
    request_body(content((Vec<u8> = "application/octet-stream")), description = "Samples"),
    responses(
        (status = 200, body = StreamAnswer),
        (status = 409, description = "The stream has another format, another connection is sending it, or the sender's count has restarted"),
    ),
)]
pub(super) async fn send(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<StreamParameters>,
    client: Client,
    caller: Option<Extension<Caller>>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<StreamAnswer>, Problem> {
    let media_type = body::media_type(&headers);
    if media_type.as_deref() != Some(RAW) {
        return Err(body::unsupported(media_type.as_deref(), RAW));
    }
    let missing = || Problem::query("first_index", "missing", "an index, required with after_gap");
    let after_gap = params.after_gap.then(|| params.first_index.ok_or_else(missing)).transpose()?;
    let mut start_time_ns = params.start_time.map(nanoseconds).transpose()?;
    let OpenStream { mut sender, permit: _permit } = open(&app, &asset, &params, client).await?;
    let (mut gaps, stored_to) = (Vec::new(), sender.next());
    if let Some(first) = after_gap {
        gaps.extend(sender.declare_lost_before(first).await?.gaps);
    }
    let mut body = BodyChunks {
        source: BodySource::endless(body, &app.limits),
        frame_bytes: sender.format().frame_bytes(),
        channels: sender.format().channels(),
        received: 0,
        rest: BytesMut::new(),
    };
    let begin = params.first_index.or(sender.next()).unwrap_or(0);
    let mut first = begin;
    let mut over = app.service.streams.watch_end();
    let mut token = TokenWatch::new(Arc::clone(&app.access), caller.map(|Extension(caller)| caller));
    let mut checked_at = Instant::now();
    loop {
        let bytes = tokio::select! {
            _ = over.wait_for(|over| *over) => return Err(Problem::busy("the service is stopping", 1)),
            bytes = body.next() => bytes?,
        };
        let Some(bytes) = bytes else { break };
        if token.is_revoked().await {
            return Err(Problem::new(StatusCode::UNAUTHORIZED, "the token was revoked"));
        }
        if checked_at.elapsed() >= CHECK_INTERVAL {
            checked_at = Instant::now();
            refresh(&mut sender).await?;
        }
        let frames = (bytes.len() / sender.format().frame_bytes()) as u64;
        let mut chunk: Chunk = sender.received_now(first, bytes);
        if params.start_time.is_some() {
            // The sender's clock determines the time
            chunk.time_ns = start_time_ns.take();
            sender.check_repeat(&chunk)?;
        }
        gaps.extend(sender.take(vec![chunk]).await?.gaps);
        first += frames;
    }
    let repeated = stored_to.map_or(0, |stored_to| stored_to.clamp(begin, first) - begin);
    Ok(Json(StreamAnswer { next: sender.next(), gaps, repeated }))
}

/// The start time of samples in nanoseconds.
fn nanoseconds(time: Timestamp) -> Result<i64, Problem> {
    let expected = "a time from 1677-09-21T00:12:44Z to 2262-04-11T23:47:16Z";
    i64::try_from(time.as_nanosecond()).map_err(|_| Problem::content("start_time", time, expected))
}

/// Checks whether a stream may continue, and reloads its record settings.
async fn refresh(sender: &mut StreamSender) -> Result<(), ServiceError> {
    match sender.refresh().await {
        Err(error @ (ServiceError::Store(StoreError::AssetUnknown(_)) | ServiceError::StreamTaken)) => {
            Err(error)
        }
        // The database may be back at the next check; the stream does not wait for it
        _ => Ok(()),
    }
}

/// A body in chunks of whole frames.
struct BodyChunks {
    source: BodySource,
    frame_bytes: usize,
    channels: usize,
    /// Number of bytes received.
    received: u64,
    /// Bytes received but not returned yet.
    rest: BytesMut,
}

impl BodyChunks {
    /// Returns the next whole frames; `None` at the end.
    async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        while self.rest.len() < self.frame_bytes {
            match self.source.next().await? {
                Some(piece) => self.take(&piece),
                None if self.rest.is_empty() => return Ok(None),
                None => {
                    let detail = incomplete_frame(self.received, self.frame_bytes, self.channels);
                    return Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail));
                }
            }
        }
        // Bytes that have already arrived cost no further write
        while self.rest.len() < CHUNK_BYTES
            && let Some(piece) = self.source.next_now().await?
        {
            self.take(&piece);
        }
        let whole = self.rest.len() / self.frame_bytes * self.frame_bytes;
        Ok(Some(self.rest.split_to(whole).freeze()))
    }

    fn take(&mut self, piece: &[u8]) {
        self.received += piece.len() as u64;
        self.rest.extend_from_slice(piece);
    }
}

fn incomplete_frame(received: u64, frame_bytes: usize, channels: usize) -> String {
    let frame = if channels == 1 {
        "one sample".to_owned()
    } else {
        format!("one sample of each of {channels} channels")
    };
    format!("the body has {received} bytes, expected a multiple of {frame_bytes} ({frame})")
}

/// List the live streams of an asset
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/streams",
    tag = "streams",
    responses((status = 200, body = StreamList)),
)]
pub(super) async fn list(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
) -> Result<Json<StreamList>, Problem> {
    let streams = app.service.streams.list(&asset).await?;
    Ok(Json(StreamList { items: streams.into_iter().map(StreamView::from).collect() }))
}

/// Remove a live stream
///
/// Only what is stored as records stays. A connection that sends the stream is closed.
#[utoipa::path(
    delete,
    path = "/v1/assets/{asset}/stream",
    tag = "streams",
    params(StreamName),
    responses((status = 204, description = "Removed"), (status = 404, description = "There is no such stream")),
)]
pub(super) async fn remove(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<StreamName>,
    caller: Option<Extension<Caller>>,
) -> Result<StatusCode, Problem> {
    let name = params.name.as_deref().unwrap_or(DEFAULT_STREAM);
    app.service.streams.remove_stream(&asset, name).await?;
    tracing::info!(%asset, name, by = by(caller.as_deref()), "removed stream");
    Ok(StatusCode::NO_CONTENT)
}

/// Store the last seconds of a live stream as a record
///
/// Regardless of the asset's stream settings; shorter if there is a gap.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/stream/keep",
    tag = "streams",
    params(KeepParameters),
    responses((status = 200, body = KeptView), (status = 422, description = "The requested seconds are not available")),
)]
pub(super) async fn keep(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<KeepParameters>,
) -> Result<Json<KeptView>, Problem> {
    let seconds = params.seconds.unwrap_or(10.0);
    if !(0.1..=60.0).contains(&seconds) {
        return Err(Problem::query("seconds", seconds, "a number from 0.1 to 60"));
    }
    let name = params.name.as_deref().unwrap_or(DEFAULT_STREAM);
    let (start_time, samples) = app.service.streams.keep_last(&asset, name, seconds).await?;
    Ok(Json(KeptView { start_time, samples }))
}

/// Whether a request may last as long as the client likes.
pub(super) fn is_endless(method: &Method, route: Option<&str>) -> bool {
    *method == Method::POST && route == Some("/v1/assets/{asset}/stream")
}
