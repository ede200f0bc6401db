//! `/v1/recording-preview`: the contents of a MATLAB, NumPy, FLAC, protobuf or MCAP recording before the
//! upload.

use std::io::Cursor;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::body;
use crate::http::request::query::Parameters;
use crate::recording::{
    BlockEncoding, McapReader, RecordDefaults, RecordingError, decode_block, decode_flac, decode_mat,
    decode_npy,
};
use crate::signal::Record;

/// Maximum number of bytes read of a file.
const MAX_BYTES: usize = 16 << 20;

/// Maximum number of channels returned for an MCAP recording.
const MAX_CHANNELS: usize = 16;

/// Maximum number of MCAP records searched for channels.
const MAX_RECORDS: usize = 64;

/// Maximum number of envelope intervals.
const STRETCHES: usize = 200;

const EXPECTED: &str =
    "application/x-matlab-data, application/x-npy, audio/flac, application/x-protobuf or application/mcap";

/// Parameters for data missing in the recording.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct RecordingParameters {
    /// Sampling rate in hertz of a NumPy array, or of a MATLAB file that does not contain it.
    #[param(example = 12800.0)]
    sample_rate_hz: Option<f64>,
}

/// A recording as an upload would read it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = RecordingPreview)]
pub(crate) struct RecordingPreviewView {
    /// The record of each channel; of an MCAP recording the first record of each of up to 16 channels.
    channels: Vec<RecordedChannel>,
    /// Why no record can be read from it.
    fault: Option<String>,
}

/// The record of one channel.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct RecordedChannel {
    /// Name of the channel.
    channel: String,
    /// Unit in the recording; none if it has none.
    unit: Option<String>,
    /// Sampling rate in hertz.
    sample_rate_hz: f64,
    /// Number of samples.
    samples: usize,
    /// Time of the first sample, if the recording contains it.
    start_time: Option<Timestamp>,
    /// Minimum and maximum of up to 200 intervals of the record.
    envelope: Vec<[f32; 2]>,
}

/// Preview a MATLAB, NumPy or FLAC file, a protobuf block or an MCAP recording
///
/// Inspects a recording, or the beginning of an MCAP recording: channels with names, units, rates, start
/// times and shapes, as an upload would read them. The body is at most 16 MiB. Nothing is stored.
#[utoipa::path(
    post,
    path = "/v1/recording-preview",
    tag = "records",
    params(RecordingParameters),
    request_body(content(
        (Vec<u8> = "application/x-matlab-data"),
        (Vec<u8> = "application/x-npy"),
        (Vec<u8> = "audio/flac"),
        (Vec<u8> = "application/x-protobuf"),
        (Vec<u8> = "application/mcap"),
    )),
    responses((status = 200, body = RecordingPreviewView)),
)]
pub(crate) async fn recording_preview(
    State(app): State<App>,
    Parameters(params): Parameters<RecordingParameters>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<RecordingPreviewView>, Problem> {
    let media_type = body::media_type(&headers);
    let look: Look = match media_type.as_deref() {
        Some("application/x-matlab-data") => decode_mat,
        Some("application/x-npy") => decode_npy,
        Some("audio/flac") => decode_flac,
        Some("application/x-protobuf") => decode_message,
        Some("application/mcap") => first_records,
        other => return Err(body::unsupported(other, EXPECTED)),
    };
    if let Some(rate) = params.sample_rate_hz.filter(|rate| !(1e-6..=1e7).contains(rate)) {
        return Err(Problem::query("sample_rate_hz", rate, "a rate from 0.000001 to 10000000"));
    }
    let _ticket = app.service.workers.admit_response()?;
    let bytes = body::read(&headers, body, MAX_BYTES, &app.limits, |_| Ok(())).await?;
    let defaults = RecordDefaults {
        start_time: Timestamp::UNIX_EPOCH,
        sample_rate_hz: params.sample_rate_hz,
        ..RecordDefaults::default()
    };
    let preview = move || RecordingPreviewView::of(look(&bytes, &defaults));
    Ok(Json(app.service.workers.run("preview a recording", preview).await?))
}

/// Reads the record of each channel.
type Look = fn(&[u8], &RecordDefaults) -> Result<Vec<Record>, RecordingError>;

fn decode_message(bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
    Ok(vec![decode_block(bytes, BlockEncoding::Protobuf, defaults)?])
}

/// The first record of each channel; the recording may be truncated.
fn first_records(bytes: &[u8], defaults: &RecordDefaults) -> Result<Vec<Record>, RecordingError> {
    let mut records: Vec<Record> = Vec::new();
    let reader = McapReader::with_defaults(Cursor::new(bytes.to_vec()), defaults.clone());
    for recorded in reader.take(MAX_RECORDS) {
        match recorded {
            Ok(recorded) if records.iter().all(|known| known.channel() != recorded.record.channel()) => {
                records.push(recorded.record);
            }
            Ok(_) => {}
            Err(error) if records.is_empty() => return Err(error),
            Err(_) => break,
        }
        if records.len() == MAX_CHANNELS {
            break;
        }
    }
    Ok(records)
}

impl RecordingPreviewView {
    fn of(records: Result<Vec<Record>, RecordingError>) -> Self {
        match records {
            Ok(records) => Self { channels: records.iter().map(RecordedChannel::of).collect(), fault: None },
            Err(error) => Self { channels: Vec::new(), fault: Some(error.to_string()) },
        }
    }
}

impl RecordedChannel {
    fn of(record: &Record) -> Self {
        Self {
            channel: record.channel().to_owned(),
            unit: Some(record.unit().to_owned()).filter(|unit| unit != "1"),
            sample_rate_hz: record.sample_rate_hz(),
            samples: record.samples().len(),
            start_time: Some(record.start_time()).filter(|start| *start != Timestamp::UNIX_EPOCH),
            envelope: envelope(record.samples()),
        }
    }
}

/// Minimum and maximum of each interval.
fn envelope(samples: &[f32]) -> Vec<[f32; 2]> {
    let extremes = |stretch: &[f32]| {
        stretch.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], &x| [low.min(x), high.max(x)])
    };
    samples.chunks(samples.len().div_ceil(STRETCHES).max(1)).map(extremes).collect()
}
