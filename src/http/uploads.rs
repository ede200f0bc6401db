//! Uploads: one recording per body, and keys that make repeats safe.

use std::fs::File;
use std::io::{self, Read};

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::app::App;
use super::body::{self, SpooledBody};
use super::csv_preview::CsvParameters;
use super::problem::{Details, Problem};
use super::query::{AssetInPath, Parameters};
use crate::asset::{AssetId, Segment, SegmentId};
use crate::estimate::WearEstimate;
use crate::recording::{JsonBlock, RawLayout};
use crate::service::{
    Accepted, BatchSummary, ChannelNames, QueuedRecord, RecordFormat, SampleFile, ServiceError,
    UploadMetadata, detached,
};
use crate::signal::OperatingPoint;
use crate::store::KeyedUpload;

const MCAP: &str = "application/mcap";
const RAW: &str = "application/octet-stream";
const EXPECTED: &str = "audio/wav, audio/flac, text/csv, application/x-matlab-data, application/x-npy, application/x-protobuf, application/json, application/mcap or application/octet-stream";

/// Millivolts in a volt.
const MV_PER_V: f64 = 1e3;

/// Maximum length of an Idempotency-Key in bytes.
const MAX_KEY_BYTES: usize = 255;

/// Record metadata in the address of an upload.
#[derive(Debug, Clone, Default, Deserialize, Serialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct UploadParameters {
    /// Time of the first sample if the recording does not contain it; by default the time of receipt.
    #[serde(skip_serializing_if = "Option::is_none")]
    start_time: Option<Timestamp>,
    /// Rotational frequency of the driving shaft in hertz.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = 29.7)]
    shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in newton metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    torque_nm: Option<f64>,
    /// Oil or housing temperature in degrees Celsius.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = 62.5)]
    temperature_c: Option<f64>,
    /// The channel's name, if the recording has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    channel: Option<String>,
    /// Names of the channels of a multi-channel recording, in order, comma-separated; for MCAP, those of the
    /// channels in `recorded_channels`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = "input,output")]
    channel_names: Option<String>,
    /// For MCAP: names in the recording of the channels that get the names in `channel_names`, in the same
    /// order, comma-separated. Other channels keep their names.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = "gearbox/x,gearbox/y")]
    recorded_channels: Option<String>,
    /// Unit of the samples if the recording does not contain it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = "m/s2")]
    unit: Option<String>,
    /// Units of the channels named in `channel_names`, in order, comma-separated, for samples whose unit the
    /// recording does not contain; empty entries use `unit`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = "g,m/s2")]
    channel_units: Option<String>,
    /// Wear depth in µm from an inspection: shown beside the estimate, never used by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    reference_wear_um: Option<f64>,
    /// For `application/octet-stream`: sample format, `f32` or `i16`, little-endian, channels interleaved.
    #[serde(skip_serializing_if = "Option::is_none")]
    sample: Option<String>,
    /// Sampling rate in hertz: for `application/octet-stream` and `application/x-npy`, and for `text/csv` and
    /// `application/x-matlab-data` that do not contain it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = 12800.0)]
    sample_rate_hz: Option<f64>,
    /// For `text/csv`: number of the time column, from 1; 0 for none. By default detected from names and
    /// values.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(minimum = 0, maximum = 256)]
    time_column: Option<u16>,
    /// For `text/csv`: numbers of the channel columns, from 1, comma-separated; by default all but the time
    /// column.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = "2,3")]
    columns: Option<String>,
    /// For `application/octet-stream`: number of channels, default 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    channels: Option<u32>,
    /// Factor for each value, stored with the record. Full-scale integers of WAV and FLAC are 1 before it. For
    /// `application/octet-stream`: value of one count in `unit`; default 1 for `f32`, 1/32768 for `i16`. Not
    /// for messages and MCAP.
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<f64>,
    /// Sensitivity of the sensor in mV/g: converts values in volts (after `scale`) to g. For WAV, FLAC, CSV,
    /// MATLAB and NumPy files.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = 100.0)]
    sensitivity_mv_per_g: Option<f64>,
}

/// The result of one channel's record.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(super) enum TakenRecord {
    /// The stored segment.
    Stored(Box<Segment>),
    /// The accepted record, if it is analysed after the answer: the segment will have this `id`.
    Queued(Box<HandedOver>),
}

/// A record that is accepted and will be analysed.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct HandedOver {
    /// `queued`.
    state: &'static str,
    #[serde(flatten)]
    record: QueuedRecord,
}

impl From<Accepted> for TakenRecord {
    fn from(accepted: Accepted) -> Self {
        match accepted {
            Accepted::Stored(segment) | Accepted::Repeated(segment) => Self::Stored(segment),
            Accepted::Queued(record) => {
                Self::Queued(Box::new(HandedOver { state: "queued", record: *record }))
            }
        }
    }
}

/// The result of an upload.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(super) enum UploadAnswer {
    /// One segment, for a single-channel recording.
    One(TakenRecord),
    /// One segment per channel.
    Several {
        /// The segments in channel order.
        segments: Vec<TakenRecord>,
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
/// Answered when the record is on disk and in the database; in a cluster, when its bytes are stored and it is
/// in the workers' queue, with the `state` `queued` and the `id` of the future segment. The same bytes for
/// the same asset, channel and time are one segment: a repeat returns that segment in its current state. With
/// an `Idempotency-Key`, a repeat returns the first answer, with `Idempotency-Replayed: true`, and a
/// recording without a start time has the time of its first receipt.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/segments",
    tag = "records",
    params(
        ("asset" = AssetId, Path, description = "The asset"),
        UploadParameters,
        ("idempotency-key" = Option<String>, Header, description = "Key of this upload, at most 255 visible characters, kept for 7 days"),
        ("content-encoding" = Option<String>, Header, description = "`gzip` or `zstd`"),
    ),
    request_body(
        content(
            (Vec<u8> = "audio/wav"),
            (String = "text/csv"),
            (Vec<u8> = "application/x-matlab-data"),
            (JsonBlock = "application/json"),
            (Vec<u8> = "application/x-protobuf"),
            (Vec<u8> = "application/mcap"),
            (Vec<u8> = "application/octet-stream"),
        ),
        description = "One recording",
    ),
    responses(
        (status = 201, body = UploadAnswer),
        (status = 409, body = Details, content_type = "application/problem+json", description = "The key was used for another upload, or the asset uses the sensor of another one"),
    ),
)]
pub(super) async fn upload(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(params): Parameters<UploadParameters>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    // before reading the body, so that an upload to an unknown asset or a full queue costs nothing
    app.service.store.asset(&asset).await?;
    let key = key(&headers)?;
    let media_type = body::media_type(&headers);
    let upload = Upload { app: &app, asset: &asset, params, key };
    upload.answer(media_type.as_deref(), &headers, body).await
}

struct Upload<'a> {
    app: &'a App,
    asset: &'a AssetId,
    params: UploadParameters,
    key: Option<String>,
}

/// An answer and its origin.
#[derive(Serialize)]
#[serde(untagged)]
enum Answered {
    /// A new answer.
    Now(UploadAnswer),
    /// The stored answer of an earlier upload with the same key.
    Before(serde_json::Value),
}

impl Upload<'_> {
    async fn answer(
        self,
        media_type: Option<&str>,
        headers: &HeaderMap,
        body: Body,
    ) -> Result<Response, Problem> {
        let answer = self.take(media_type, headers, body).await?;
        let mut response = (StatusCode::CREATED, Json(&answer)).into_response();
        if matches!(answer, Answered::Before(_)) {
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
    ) -> Result<Answered, Problem> {
        if media_type == Some(MCAP) {
            return self.take_mcap(headers, body).await;
        }
        let format = self.format(media_type)?;
        let app = self.app;
        let mut ticket = app.service.workers.admit()?;
        let bytes = body::read(headers, body, app.limits.record_bytes, &app.limits, |bytes| {
            ticket.grow(bytes).map_err(Problem::from)
        })
        .await?;
        let mut metadata = self.metadata()?;
        if self.key.is_some() {
            let first = self.begin(&format.media_type(), &Sha256::digest(&bytes)).await?;
            if let Some(answer) = answer_before(&first) {
                return Ok(answer);
            }
            metadata.start_time = Some(metadata.start_time.unwrap_or(first.received_at));
        }
        let (service, asset) = (app.service.clone(), self.asset.clone());
        let work = async move {
            let accepted = service.pipeline.accept(&asset, format, bytes, metadata, ticket).await?;
            let mut segments: Vec<TakenRecord> = accepted.into_iter().map(TakenRecord::from).collect();
            Ok(match segments.pop() {
                Some(segment) if segments.is_empty() => UploadAnswer::One(segment),
                last => {
                    segments.extend(last);
                    UploadAnswer::Several { segments }
                }
            })
        };
        self.store_answer(work).await
    }

    /// Processes an upload and stores its answer for repeats with the same key, in a task of its own, so that
    /// a disconnected client does not interrupt it.
    async fn store_answer(
        &self,
        work: impl Future<Output = Result<UploadAnswer, Problem>> + Send + 'static,
    ) -> Result<Answered, Problem> {
        let (service, asset, key) = (self.app.service.clone(), self.asset.clone(), self.key.clone());
        let work = async move {
            let answer = work.await?;
            if let Some(key) = key
                && let Ok(text) = serde_json::to_string(&answer)
                && let Some(first) = service.store.finish_upload(&asset, &key, &text).await?
                && let Ok(first) = serde_json::from_str(&first)
            {
                return Ok(Answered::Before(first));
            }
            Ok(Answered::Now(answer))
        };
        detached("store an upload", work).await?
    }

    async fn take_mcap(&self, headers: &HeaderMap, body: Body) -> Result<Answered, Problem> {
        let app = self.app;
        let names = self.params.channels_of_recording()?;
        let ticket = app.service.workers.admit()?;
        let spooled = SpooledBody::receive(headers, body, &app.uploads, &app.limits).await?;
        if self.key.is_some()
            && let Some(answer) = answer_before(&self.begin(MCAP, spooled.sha256()).await?)
        {
            return Ok(answer);
        }
        let (app, asset) = (app.clone(), self.asset.clone());
        let work = async move {
            let path = spooled.path().to_path_buf();
            let answer = take_recording(&app, &asset, names, move || File::open(path)).await;
            drop((spooled, ticket));
            answer
        };
        self.store_answer(work).await
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

    fn format(&self, media_type: Option<&str>) -> Result<RecordFormat, Problem> {
        let params = &self.params;
        let format = match media_type {
            Some(RAW) => return self.raw_format(),
            _ => media_type.and_then(RecordFormat::from_media_type),
        };
        let format = format.ok_or_else(|| body::unsupported(media_type, EXPECTED))?;
        // A value that the format does not use is an error: ignoring it would give wrong records.
        let given: &[(&str, bool)] = &[
            ("sample", params.sample.is_some()),
            ("channels", params.channels.is_some()),
            ("recorded_channels", params.recorded_channels.is_some()),
            ("time_column", params.time_column.is_some()),
            ("columns", params.columns.is_some()),
            ("sample_rate_hz", params.sample_rate_hz.is_some()),
            ("scale", params.scale.is_some()),
            ("sensitivity_mv_per_g", params.sensitivity_mv_per_g.is_some()),
        ];
        let used: &[&str] = match format {
            RecordFormat::File(SampleFile { kind, .. }) if kind.has_rate() => {
                &["scale", "sensitivity_mv_per_g"]
            }
            RecordFormat::File(_) => &["sample_rate_hz", "scale", "sensitivity_mv_per_g"],
            RecordFormat::Csv(_) => {
                &["sample_rate_hz", "scale", "sensitivity_mv_per_g", "time_column", "columns"]
            }
            _ => &[],
        };
        if let Some((name, _)) = given.iter().find(|(name, is_given)| *is_given && !used.contains(name)) {
            return Err(Problem::query(name, "given", "no value with this content-type"));
        }
        let (sample_rate_hz, scale) = (params.sample_rate_hz, params.scale()?);
        Ok(match format {
            RecordFormat::Csv(_) => {
                let columns = params.columns.clone();
                let mut layout = CsvParameters::new(sample_rate_hz, params.time_column, columns).layout()?;
                layout.scale = scale;
                RecordFormat::Csv(layout)
            }
            RecordFormat::File(file) => {
                if let Some(rate) = sample_rate_hz.filter(|rate| !(*rate > 0.0 && rate.is_finite())) {
                    return Err(Problem::query("sample_rate_hz", rate, "a rate above 0"));
                }
                RecordFormat::File(SampleFile { sample_rate_hz, scale, ..file })
            }
            other => other,
        })
    }

    fn raw_format(&self) -> Result<RecordFormat, Problem> {
        let params = &self.params;
        if params.sensitivity_mv_per_g.is_some() {
            return Err(Problem::query(
                "sensitivity_mv_per_g",
                "given",
                "no value for raw samples: use scale",
            ));
        }
        let missing = |field| Problem::query(field, "missing", "a value, as raw samples do not contain it");
        let sample = params.sample.as_deref().ok_or_else(|| missing("sample"))?;
        let rate = params.sample_rate_hz.ok_or_else(|| missing("sample_rate_hz"))?;
        let layout = sample
            .parse()
            .and_then(|sample| RawLayout::new(sample, rate, params.channels.unwrap_or(1), params.scale));
        Ok(RecordFormat::Raw(layout.map_err(ServiceError::from)?))
    }

    fn metadata(&self) -> Result<UploadMetadata, Problem> {
        let params = &self.params;
        let in_g = params.sensitivity_mv_per_g.map(|_| "g".to_owned());
        if let (Some(_), Some(unit)) = (&in_g, params.unit.as_deref().filter(|unit| *unit != "g")) {
            return Err(Problem::query("unit", unit, "g, or no value, with sensitivity_mv_per_g"));
        }
        Ok(UploadMetadata {
            start_time: params.start_time,
            channel: params.channel.clone(),
            channel_names: listed(&params.channel_names),
            unit: in_g.or_else(|| params.unit.clone()),
            channel_units: listed(&params.channel_units),
            operating_point: OperatingPoint {
                shaft_speed_hz: params.shaft_speed_hz,
                torque_nm: params.torque_nm,
                temperature_c: params.temperature_c,
            },
            reference_wear_um: params.reference_wear_um,
        })
    }
}

/// The stored answer of an earlier upload.
fn answer_before(first: &KeyedUpload) -> Option<Answered> {
    serde_json::from_str(first.answer.as_deref()?).ok().map(Answered::Before)
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
    let (_, channel) = super::assets::asset_and_channel(app, asset, None).await?;
    let wear = match channel {
        Some(channel) => app.service.store.latest_counted(&channel).await?.map(|segment| segment.wear),
        None => None,
    };
    Ok(UploadAnswer::Recording(Box::new(RecordingAnswer { summary, segments, wear })))
}

impl UploadParameters {
    /// Returns the factor for each value, if one is given.
    fn scale(&self) -> Result<Option<f64>, Problem> {
        if let Some(scale) = self.scale.filter(|scale| *scale == 0.0 || !scale.is_finite()) {
            return Err(Problem::query("scale", scale, "a finite number other than 0"));
        }
        match self.sensitivity_mv_per_g {
            None => Ok(self.scale),
            Some(sensitivity) if sensitivity > 0.0 && sensitivity.is_finite() => {
                Ok(Some(self.scale.unwrap_or(1.0) * MV_PER_V / sensitivity))
            }
            Some(other) => Err(Problem::query("sensitivity_mv_per_g", other, "a finite number above 0")),
        }
    }

    /// Returns the new names of an MCAP recording's channels; a problem if anything else is given, as the
    /// recording contains it.
    fn channels_of_recording(&self) -> Result<ChannelNames, Problem> {
        const USED: [&str; 3] = ["recorded_channels", "channel_names", "channel_units"];
        let given = serde_json::to_value(self).unwrap_or_default();
        let mut names = given.as_object().into_iter().flat_map(|given| given.keys());
        if let Some(name) = names.find(|name| !USED.contains(&name.as_str())) {
            return Err(Problem::query(name, "given", "no value: an MCAP file contains it for each record"));
        }
        let [recorded, names, units] =
            [&self.recorded_channels, &self.channel_names, &self.channel_units].map(listed);
        Ok(ChannelNames::new(&recorded, &names, &units)?)
    }
}

/// The entries of a comma-separated list.
fn listed(list: &Option<String>) -> Vec<String> {
    let list = list.as_deref();
    list.map(|list| list.split(',').map(|each| each.trim().to_string()).collect()).unwrap_or_default()
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
