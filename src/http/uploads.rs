//! Uploads: one recording in a body, or several in a browser's form, and keys that make repeats safe.

use axum::Json;
use axum::body::Body;
use axum::extract::{Query, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::app::App;
use super::body::{self, Pieces, SpooledBody};
use super::problem::{Details, Problem};
use super::query::{AssetInPath, Parameters};
use crate::asset::{AssetId, Segment};
use crate::estimate::WearEstimate;
use crate::recording::{JsonBlock, RawLayout};
use crate::service::{Accepted, BatchSummary, QueuedRecord, RecordFormat, ServiceError, UploadMetadata, detached};
use crate::signal::OperatingPoint;
use crate::store::KeyedUpload;

const MCAP: &str = "application/mcap";
const FORM: &str = "multipart/form-data";
const BARE: &str = "application/octet-stream";
const EXPECTED: &str =
    "audio/wav, application/x-protobuf, application/json, application/mcap, application/octet-stream or multipart/form-data";

/// Longest text field of a form, most of them before one file, and longest Idempotency-Key, in bytes.
const MOST_TEXT: usize = 1024;
const MOST_FIELDS: usize = 32;
const MOST_KEY: usize = 255;

/// What an upload says of the record in its address.
#[derive(Debug, Clone, Default, Deserialize, Serialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct UploadParameters {
    /// Time of the first sample where the recording does not say; the time of receipt where nothing does.
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
    /// The channel's name, where the recording has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    channel: Option<String>,
    /// Names of the measuring points of a recording of several channels, in their order, with commas between them.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = "input,output")]
    channel_names: Option<String>,
    /// Unit of the samples where the recording does not say.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = "m/s2")]
    unit: Option<String>,
    /// Wear depth in µm known from an inspection: shown beside the estimate, never used by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    reference_wear_um: Option<f64>,
    /// For `application/octet-stream`: how a sample is written, `f32` or `i16`, little-endian, channels interleaved.
    #[serde(skip_serializing_if = "Option::is_none")]
    sample: Option<String>,
    /// For `application/octet-stream`: sampling rate in hertz.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[param(example = 12800.0)]
    sample_rate_hz: Option<f64>,
    /// For `application/octet-stream`: number of channels, 1 where not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    channels: Option<u32>,
    /// For `application/octet-stream`: value of one count in `unit`; 1 for `f32`, 1/32768 for `i16` where not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<f64>,
}

/// A browser's form: text fields named as the parameters of the query, then the files that they hold for.
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "described, and read piece by piece")]
pub(super) struct UploadForm {
    /// A recording; its format is told by the end of its name (`wav`, `mcap`, `json`, `pb`), else by its media type. There may be several.
    #[schema(value_type = String, format = Binary)]
    file: Vec<u8>,
}

/// What became of one channel's record.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(super) enum TakenRecord {
    /// The segment that it became.
    Stored(Box<Segment>),
    /// What it was handed over as, where others analyse it after the answer: the segment has this `id` once it is there.
    Queued(Box<HandedOver>),
}

/// A record that is kept and will be analysed.
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
            Accepted::Queued(record) => Self::Queued(Box::new(HandedOver {
                state: "queued",
                record: *record,
            })),
        }
    }
}

/// What an upload made.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(super) enum UploadAnswer {
    /// One segment, for a recording of one channel.
    One(TakenRecord),
    /// A segment for each channel.
    Several {
        /// The segments in the order of the channels.
        segments: Vec<TakenRecord>,
    },
    /// What became of the records of an MCAP recording.
    Recording(Box<RecordingAnswer>),
    /// One answer for each file of a form.
    Form {
        /// The answers in the order of the files.
        #[schema(value_type = Vec<Object>)]
        files: Vec<serde_json::Value>,
    },
}

/// The answer to a recording of many records.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RecordingAnswer {
    #[serde(flatten)]
    summary: BatchSummary,
    /// The asset's wear after the latest record.
    wear: Option<WearEstimate>,
}

/// Upload a recording
///
/// Answered when it is on the disk and in the database; in a cluster when its bytes are kept and it is in the workers' queue, with the `state`
/// `queued` and the `id` of the segment that it becomes. The same bytes for the same asset, channel and time are one segment: a repeat is
/// answered with that segment as it is now. With an `Idempotency-Key` a repeat has the first answer itself, with `Idempotency-Replayed: true`,
/// and a recording that does not say when it began is of the time of its first receipt. A form (`multipart/form-data`) has its text fields,
/// named as the parameters here, before its files.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/segments",
    tag = "records",
    params(
        ("asset" = AssetId, Path, description = "The asset"),
        UploadParameters,
        ("idempotency-key" = Option<String>, Header, description = "Name of this upload, at most 255 visible characters, kept for 7 days"),
        ("content-encoding" = Option<String>, Header, description = "`gzip` or `zstd`"),
    ),
    request_body(
        content(
            (Vec<u8> = "audio/wav"),
            (JsonBlock = "application/json"),
            (Vec<u8> = "application/x-protobuf"),
            (Vec<u8> = "application/mcap"),
            (Vec<u8> = "application/octet-stream"),
            (UploadForm = "multipart/form-data"),
        ),
        description = "One recording",
    ),
    responses(
        (status = 201, body = UploadAnswer),
        (status = 409, body = Details, content_type = "application/problem+json", description = "The key was used for something else, or the records of the asset come with those of another one"),
    ),
)]
pub(super) async fn upload(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<UploadParameters>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    // Before the body is read: an upload to nowhere, or to a full queue, costs nothing.
    app.service.store.asset(&asset).await?;
    let key = key(&headers)?;
    let media_type = body::media_type(&headers);
    let upload = Upload {
        app: &app,
        asset: &asset,
        asked,
        key,
    };
    if media_type.as_deref() == Some(FORM) {
        return upload.form(&headers, body).await;
    }
    upload.one(media_type.as_deref(), &headers, Pieces::Body(body)).await
}

struct Upload<'a> {
    app: &'a App,
    asset: &'a AssetId,
    asked: UploadParameters,
    key: Option<String>,
}

/// What is answered.
#[derive(Serialize)]
#[serde(untagged)]
enum Answered {
    /// For the first time, or from what is stored.
    Now(UploadAnswer),
    /// As it was before.
    Before(serde_json::Value),
}

impl Upload<'_> {
    async fn one(self, media_type: Option<&str>, headers: &HeaderMap, pieces: Pieces<'_>) -> Result<Response, Problem> {
        let answer = self.take(media_type, headers, pieces).await?;
        let mut response = (StatusCode::CREATED, Json(&answer)).into_response();
        if matches!(answer, Answered::Before(_)) {
            let name = HeaderName::from_static("idempotency-replayed");
            response.headers_mut().insert(name, HeaderValue::from_static("true"));
        }
        Ok(response)
    }

    async fn take(&self, media_type: Option<&str>, headers: &HeaderMap, pieces: Pieces<'_>) -> Result<Answered, Problem> {
        if media_type == Some(MCAP) {
            return self.take_mcap(headers, pieces).await;
        }
        let format = self.format(media_type)?;
        let app = self.app;
        let mut ticket = app.service.workers.admit()?;
        let bytes = body::read(headers, pieces, app.limits.record_bytes, &app.limits, |bytes| {
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
        self.answer(work).await
    }

    /// Does an upload's work and keeps its answer for repeats under the same key, in a task of its own: a client that hangs up must not leave
    /// half of it.
    async fn answer(&self, work: impl Future<Output = Result<UploadAnswer, Problem>> + Send + 'static) -> Result<Answered, Problem> {
        let (service, asset, key) = (self.app.service.clone(), self.asset.clone(), self.key.clone());
        let kept = async move {
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
        detached("take an upload", kept).await?
    }

    async fn take_mcap(&self, headers: &HeaderMap, pieces: Pieces<'_>) -> Result<Answered, Problem> {
        let app = self.app;
        if let Some(name) = self.asked.first_given() {
            return Err(Problem::query(
                &name,
                "given",
                "nothing: an MCAP file says it for each of its records",
            ));
        }
        let ticket = app.service.workers.admit()?;
        let spooled = SpooledBody::receive(headers, pieces, &app.uploads, &app.limits).await?;
        if self.key.is_some()
            && let Some(answer) = answer_before(&self.begin(MCAP, spooled.sha256()).await?)
        {
            return Ok(answer);
        }
        let (app, asset) = (app.clone(), self.asset.clone());
        self.answer(async move { take_recording(&app, &asset, spooled, ticket).await })
            .await
    }

    /// What is known of this upload's key, which is taken where nobody has.
    async fn begin(&self, media_type: &str, content: &[u8]) -> Result<KeyedUpload, Problem> {
        let key = self.key.as_deref().unwrap_or_default();
        let mut hash = Sha256::new();
        hash.update(media_type);
        hash.update(serde_json::to_vec(&self.asked).unwrap_or_default());
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
        let asked = &self.asked;
        if media_type != Some(BARE) {
            let format = media_type.and_then(RecordFormat::from_media_type);
            return format.ok_or_else(|| body::unsupported(media_type, EXPECTED));
        }
        let missing = |field| Problem::query(field, "missing", "its value: bare samples do not say it themselves");
        let sample = asked.sample.as_deref().ok_or_else(|| missing("sample"))?;
        let rate = asked.sample_rate_hz.ok_or_else(|| missing("sample_rate_hz"))?;
        let layout = sample
            .parse()
            .and_then(|sample| RawLayout::new(sample, rate, asked.channels.unwrap_or(1), asked.scale));
        Ok(RecordFormat::Raw(layout.map_err(ServiceError::from)?))
    }

    fn metadata(&self) -> Result<UploadMetadata, Problem> {
        let asked = &self.asked;
        let names = asked
            .channel_names
            .as_deref()
            .map(|names| names.split(',').map(|name| name.trim().to_string()).collect());
        Ok(UploadMetadata {
            start_time: asked.start_time,
            channel: asked.channel.clone(),
            channel_names: names.unwrap_or_default(),
            unit: asked.unit.clone(),
            operating_point: OperatingPoint {
                shaft_speed_hz: asked.shaft_speed_hz,
                torque_nm: asked.torque_nm,
                temperature_c: asked.temperature_c,
            },
            reference_wear_um: asked.reference_wear_um,
        })
    }

    /// Takes the files of a form, one after the other as they come.
    async fn form(mut self, headers: &HeaderMap, body: Body) -> Result<Response, Problem> {
        let boundary = headers
            .get(header::CONTENT_TYPE)
            .and_then(|value| multer::parse_boundary(value.to_str().ok()?).ok());
        let boundary = boundary.ok_or_else(|| body::unsupported(Some(FORM), "a boundary with it"))?;
        if headers.contains_key(header::CONTENT_ENCODING) {
            return Err(body::unsupported(Some(FORM), "no content-encoding of the form as a whole"));
        }
        let limits = &self.app.limits;
        let whole = multer::SizeLimit::new().whole_stream(limits.recording_bytes);
        let constraints = multer::Constraints::new().size_limit(whole);
        let mut form = multer::Multipart::with_constraints(body.into_data_stream(), boundary, constraints);
        let mut fields = Vec::new();
        let mut files = Vec::new();
        let base = self.key.take();
        while let Some(part) = form.next_field().await.map_err(body::broken_form)? {
            let name = part.name().unwrap_or_default().to_string();
            let Some(file) = part.file_name().map(str::to_string) else {
                if fields.len() == MOST_FIELDS {
                    return Err(Problem::content("form", "more text fields", "at most 32 before a file"));
                }
                let text = body::text(part, MOST_TEXT).await?;
                fields.push((name, text));
                continue;
            };
            if files.len() == limits.form_files {
                let most = format!("at most {} in one form", limits.form_files);
                return Err(Problem::content("file", "more files", &most));
            }
            if !fields.is_empty() {
                self.asked = self.asked.with(&std::mem::take(&mut fields))?;
            }
            let media_type = part.content_type().map(|media_type| media_type.essence_str().to_string());
            let media_type = by_name(&file).map(str::to_string).or(media_type);
            self.key = base.as_ref().map(|base| format!("{base}/{}", files.len()));
            let nothing = HeaderMap::new();
            let answer = self.take(media_type.as_deref(), &nothing, Pieces::Role(Box::new(part))).await?;
            files.push(serde_json::to_value(answer).unwrap_or_default());
        }
        if files.is_empty() {
            return Err(Problem::content("file", "missing", "at least one file in the form"));
        }
        Ok((StatusCode::CREATED, Json(UploadAnswer::Form { files })).into_response())
    }
}

/// What was answered to an upload before.
fn answer_before(first: &KeyedUpload) -> Option<Answered> {
    serde_json::from_str(first.answer.as_deref()?).ok().map(Answered::Before)
}

/// Reads an MCAP file into an asset.
pub(super) async fn take_recording(
    app: &App,
    asset: &AssetId,
    spooled: SpooledBody,
    ticket: crate::service::Ticket,
) -> Result<UploadAnswer, Problem> {
    let summary = app.service.pipeline.accept_recording(asset, spooled.path()).await?;
    drop((spooled, ticket));
    let (_, channel) = super::assets::asset_and_channel(app, asset, None).await?;
    let wear = match channel.and_then(|channel| channel.last_segment) {
        Some(id) => app.service.store.segment(&id).await?.map(|segment| segment.wear),
        None => None,
    };
    Ok(UploadAnswer::Recording(Box::new(RecordingAnswer { summary, wear })))
}

impl UploadParameters {
    fn first_given(&self) -> Option<String> {
        let given = serde_json::to_value(self).ok()?;
        given.as_object()?.keys().next().cloned()
    }

    /// The same with the text fields of a form.
    fn with(&self, fields: &[(String, String)]) -> Result<Self, Problem> {
        let escaped = |text: &str| -> String {
            let escape = |byte: u8| match byte {
                b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' => char::from(byte).to_string(),
                _ => format!("%{byte:02X}"),
            };
            text.bytes().map(escape).collect()
        };
        // An empty field of a form is one that was not filled in.
        let filled = fields.iter().filter(|(_, text)| !text.trim().is_empty());
        let pairs: Vec<String> = filled
            .map(|(name, text)| format!("{}={}", escaped(name), escaped(text.trim())))
            .collect();
        let unusable = |message: String| Problem::new(StatusCode::BAD_REQUEST, message);
        let uri: Uri = format!("/?{}", pairs.join("&"))
            .parse()
            .map_err(|_| unusable("a field of the form cannot be used".into()))?;
        let Query(from_form): Query<Self> = Query::try_from_uri(&uri).map_err(|error| unusable(error.body_text()))?;
        let both = (serde_json::to_value(self), serde_json::to_value(&from_form));
        let (Ok(serde_json::Value::Object(mut all)), Ok(serde_json::Value::Object(more))) = both else {
            return Ok(from_form);
        };
        all.extend(more);
        serde_json::from_value(all.into()).map_err(|error| unusable(error.to_string()))
    }
}

/// The media type of a file by the end of its name.
fn by_name(file: &str) -> Option<&'static str> {
    match file.rsplit('.').next()?.to_ascii_lowercase().as_str() {
        "wav" => Some("audio/wav"),
        "mcap" => Some(MCAP),
        "json" => Some("application/json"),
        "pb" => Some("application/x-protobuf"),
        _ => None,
    }
}

fn key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let Some(key) = headers.get("idempotency-key") else {
        return Ok(None);
    };
    match key.to_str() {
        Ok(text) if !text.is_empty() && text.len() <= MOST_KEY => Ok(Some(text.to_string())),
        _ => Err(Problem::query("idempotency-key", format!("{key:?}"), "1 to 255 visible characters")),
    }
}
