//! `GET /v1/assets/{asset}/export`: all results of an asset as one MCAP recording.

mod provenance;

use std::collections::HashMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use axum::body::Body;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream::{StreamExt, unfold};
use jiff::Timestamp;
use serde::Deserialize;
use tokio::io::AsyncReadExt;

use super::app::App;
use super::problem::Problem;
use super::request::body::SpooledBody;
use super::request::query::{AssetPath, Parameters};
use super::segments::record_choice::{RecordChoice, parse_statuses};
use crate::asset::{AssetId, Segment, json_name};
use crate::estimate::Severity;
use crate::recording::message::{AlarmState, Indicators, Spectrum, WearEstimate};
use crate::recording::{HistoryKind, HistoryWriter, RecordingError};
use crate::service::{LoadedRecord, Readiness, ServiceError};
use crate::signal::{Record, reduction};
use crate::store::{AlarmFilter, ChannelSummary, SegmentFilter, SegmentKey, StoredAlarmChange};

/// Segments read at once, to limit memory.
const PAGE: u32 = 200;

/// Number of points of an exported spectrum.
const SPECTRUM_POINTS: usize = 2000;

/// Maximum number of spectra per export: each is computed from its record's raw bytes.
const MAX_SPECTRA: u64 = 10_000;

/// Bytes read from the file at once.
const PIECE: usize = 64 << 10;

type Writer = HistoryWriter<BufWriter<File>>;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ExportParameters {
    /// Only this channel.
    channel: Option<String>,
    /// Only records that start at this time or later.
    from: Option<Timestamp>,
    /// Only records that start before this time.
    to: Option<Timestamp>,
    /// Only records whose estimate has one of these statuses, comma-separated; alarms do not depend on it.
    #[param(example = "estimated,excluded")]
    status: Option<String>,
    /// Number of spectra, spread evenly over the exported records of every channel, each of which has at
    /// least one; default 100, at most 10000.
    #[param(maximum = 10000)]
    spectra: Option<u64>,
    /// Whether the samples of the records are included; default false.
    waveforms: Option<bool>,
}

/// Export an asset's history
///
/// Indicators, wear, spectra and alarm changes as `flankwatch.v1` protobuf messages in MCAP, on
/// `/{asset}/{channel}/indicators`, `…/wear`, `…/spectrum` and `…/alarm`. With `waveforms=true` also the
/// records on `…/waveform`, in the format that uploads and `flankwatch replay` read. Metadata records
/// `asset`, `sensor`, `gear_pair` and `acquisition`; the manifest of the wear library is the attachment
/// `library.json`. Records whose raw recordings are no longer kept have no spectrum. Plot `wear.median_um`,
/// `indicators.values[:]{key=="rms"}.value`, or `spectrum.frequency_hz[:]` against `spectrum.amplitude[:]`.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/export",
    tag = "trends",
    params(ExportParameters),
    responses(
        (status = 200, body = Vec<u8>, content_type = "application/mcap"),
        (status = 422, description = "A time out of range"),
    ),
)]
pub(super) async fn export(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<ExportParameters>,
) -> Result<Response, Problem> {
    let spectra = params.spectra.unwrap_or(100);
    if spectra > MAX_SPECTRA {
        return Err(Problem::query("spectra", spectra, "a number from 0 to 10000"));
    }
    app.service.store.asset(&asset).await?;
    let _ticket = app.service.workers.admit_response()?;
    match write_export(&app, &asset, &params, spectra, &app.uploads).await {
        // Stored data can be exported even if the disk of the data folder is full
        Err(problem) if problem.is_no_room() => {
            write_export(&app, &asset, &params, spectra, &std::env::temp_dir()).await
        }
        answer => answer,
    }
}

/// Writes the export to a file in `folder` and returns it.
async fn write_export(
    app: &App,
    asset: &AssetId,
    params: &ExportParameters,
    spectra: u64,
    folder: &Path,
) -> Result<Response, Problem> {
    let store = &app.service.store;
    let spec = store.asset(asset).await?.spec;
    let choice = RecordChoice { bin: None, statuses: parse_statuses(params.status.as_deref())? };
    let channels = store.channels(asset).await?;
    let is_wanted =
        |channel: &&ChannelSummary| params.channel.as_ref().is_none_or(|name| *name == channel.channel);
    let mut records = 0;
    for channel in channels.iter().filter(is_wanted).filter(|_| spectra > 0) {
        let trend = store.trend(channel).await?;
        records += choice.of(&trend, params.from, params.to).len() as u64;
    }
    let (file, spooled) = new_file(folder)?;
    let mut writer = HistoryWriter::new(BufWriter::with_capacity(1 << 20, file))?;
    let latest: Vec<_> =
        channels.iter().filter(is_wanted).filter_map(|channel| channel.last_segment.clone()).collect();
    for (name, entries) in provenance::metadata(&spec, &store.segments_by_id(&latest).await?) {
        writer.metadata(name, entries)?;
    }
    if let Readiness::Ready(library) = app.service.simulations.of(&spec).1.readiness
        && let Ok(manifest) = serde_json::to_vec_pretty(library.manifest())
    {
        writer.attach("library.json", "application/json", app.service.now(), &manifest)?;
    }
    let mut filter = SegmentFilter {
        channel: params.channel.clone(),
        from: params.from,
        to: params.to,
        ..SegmentFilter::default()
    };
    let with_waveforms = params.waveforms.unwrap_or(false);
    let at_once = if with_waveforms { 1 } else { PAGE };
    let mut passed: HashMap<String, u64> = HashMap::new();
    loop {
        let page = choice.segments(store, asset, &filter, at_once).await?;
        let Some(last) = page.last() else { break };
        filter.after = Some(SegmentKey { start_time: last.start_time, id: last.id.clone() });
        let mut with_spectra = Vec::with_capacity(page.len());
        for segment in page {
            // Every k-th record of each channel, to approach the requested number
            let number = passed.entry(segment.channel.clone()).or_default();
            let is_chosen = spectra > 0 && number.is_multiple_of(records.div_ceil(spectra).max(1));
            *number += 1;
            let spectrum = if is_chosen { spectrum_of(app, &segment).await? } else { None };
            let record = if with_waveforms { record_of(app, &segment).await? } else { None };
            with_spectra.push((segment, spectrum, record));
        }
        let written = app.service.workers.run("write a history", move || {
            with_spectra.iter().try_for_each(|(segment, spectrum, record)| {
                write(&mut writer, segment, spectrum.as_ref(), record.as_deref())
            })?;
            Ok::<_, RecordingError>(writer)
        });
        writer = written.await??;
    }
    let changes = alarm_changes(app, asset, params).await?;
    let written = app.service.workers.run("write alarms", move || {
        changes.iter().try_for_each(|(base, message)| {
            let time = Timestamp::from_nanosecond(message.start_time_ns.into()).unwrap_or_default();
            writer.write(base, HistoryKind::Alarm, time, time, message)
        })?;
        Ok::<_, RecordingError>(writer)
    });
    let writer = written.await??;
    let finished = app.service.workers.run("write a history", move || writer.finish().map(drop));
    finished.await??;
    let name = format!("attachment; filename=\"{asset}.mcap\"");
    let fields =
        [(header::CONTENT_TYPE, "application/mcap".to_string()), (header::CONTENT_DISPOSITION, name)];
    Ok((fields, stream(spooled).await?).into_response())
}

/// Reads the record; `None` if its raw bytes are no longer available.
async fn record_of(app: &App, segment: &Segment) -> Result<Option<LoadedRecord>, Problem> {
    match app.service.records.load(segment).await {
        Err(error) if error.is_raw_unavailable() => Ok(None),
        record => Ok(Some(record?)),
    }
}

/// Computes the spectrum of a record; `None` if its raw bytes are no longer available.
async fn spectrum_of(app: &App, segment: &Segment) -> Result<Option<Spectrum>, Problem> {
    let spectrum = match app.service.records.spectrum(segment).await {
        Err(error) if error.is_raw_unavailable() => return Ok(None),
        spectrum => spectrum?.0,
    };
    let indices = reduction::peaks(&spectrum.amplitude, SPECTRUM_POINTS);
    Ok(Some(Spectrum {
        start_time_ns: nanoseconds(segment.start_time),
        quantity: spectrum.quantity.to_string(),
        unit: spectrum.unit,
        window: spectrum.window.to_string(),
        bandwidth_hz: spectrum.bandwidth_hz,
        frequency_hz: indices.iter().map(|n| *n as f64 * spectrum.resolution_hz).collect(),
        amplitude: indices.iter().map(|n| spectrum.amplitude[*n]).collect(),
    }))
}

/// The asset's alarm changes in the requested time, in order, each with the start of its topic; without
/// withdrawn ones.
async fn alarm_changes(
    app: &App,
    asset: &AssetId,
    params: &ExportParameters,
) -> Result<Vec<(String, AlarmState)>, Problem> {
    let store = &app.service.store;
    let filter =
        AlarmFilter { asset: Some(asset.clone()), channel: params.channel.clone(), ..AlarmFilter::default() };
    let mut changes = Vec::new();
    for alarm in store.alarms(&filter, app.service.now(), u32::MAX).await? {
        let (history, _) = store.alarm_history(&alarm.id, u32::MAX).await?;
        let is_asked = |time: Timestamp| {
            params.from.is_none_or(|from| from <= time) && params.to.is_none_or(|to| time < to)
        };
        let current =
            history.into_iter().filter(|entry| entry.withdrawn_at.is_none() && is_asked(entry.change.time));
        changes.extend(current.map(|StoredAlarmChange { change, .. }| {
            let message = AlarmState {
                start_time_ns: nanoseconds(change.time),
                name: alarm.quantity.to_string(),
                state: change.state.name().to_owned(),
                severity: match change.severity {
                    None => 0,
                    Some(Severity::Warning) => 1,
                    Some(Severity::Danger) => 2,
                },
                value: change.value,
                by: change.by,
                comment: change.comment,
            };
            (format!("/{asset}/{}", alarm.channel), message)
        }));
    }
    changes.sort_by_key(|(_, message)| message.start_time_ns);
    Ok(changes)
}

fn write(
    writer: &mut Writer,
    segment: &Segment,
    spectrum: Option<&Spectrum>,
    record: Option<&Record>,
) -> Result<(), RecordingError> {
    let base = format!("/{}/{}", segment.asset_id, segment.channel);
    let (start, received) = (segment.start_time, segment.received_at);
    if let Some(record) = record {
        writer.write_record(&base, record, received)?;
    }
    let indicators = Indicators {
        start_time_ns: nanoseconds(start),
        values: segment.indicators.values.iter().map(|(name, value)| (name.to_string(), *value)).collect(),
    };
    writer.write(&base, HistoryKind::Indicators, start, received, &indicators)?;
    let wear = WearEstimate {
        start_time_ns: nanoseconds(start),
        status: json_name(&segment.wear.status),
        median_um: segment.wear.median_um,
        low_um: segment.wear.low_um,
        high_um: segment.wear.high_um,
        p25_um: segment.wear.p25_um,
        p75_um: segment.wear.p75_um,
    };
    writer.write(&base, HistoryKind::Wear, start, received, &wear)?;
    match spectrum {
        Some(spectrum) => writer.write(&base, HistoryKind::Spectrum, start, received, spectrum),
        None => Ok(()),
    }
}

fn nanoseconds(time: Timestamp) -> i64 {
    i64::try_from(time.as_nanosecond()).unwrap_or(i64::MAX)
}

/// Creates a file with an unguessable name in a folder that others may write to; only the owner can read it.
fn new_file(folder: &Path) -> Result<(File, SpooledBody), ServiceError> {
    let failed =
        |source: std::io::Error| ServiceError::File { action: "write", path: folder.to_path_buf(), source };
    let mut unguessable = [0; 16];
    getrandom::fill(&mut unguessable).map_err(|error| failed(std::io::Error::other(error.to_string())))?;
    let path = folder.join(format!("flankwatch-export-{}", hex::encode(unguessable)));
    let mut options = File::options();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let file = options.open(&path).map_err(failed)?;
    Ok((file, SpooledBody::at(path)))
}

/// Streams the file in pieces; it is removed after the last one or when the client disconnects.
async fn stream(spooled: SpooledBody) -> Result<Body, Problem> {
    let opened = tokio::fs::File::open(spooled.path()).await;
    let file = opened.map_err(|source| ServiceError::File {
        action: "read",
        path: spooled.path().to_path_buf(),
        source,
    })?;
    let pieces = unfold((file, spooled), |(mut file, spooled)| async move {
        let mut piece = Vec::with_capacity(PIECE);
        match file.read_buf(&mut piece).await {
            Ok(0) => None,
            Ok(_) => Some((Ok(Bytes::from(piece)), (file, spooled))),
            Err(error) => Some((Err(error), (file, spooled))),
        }
    });
    // Compression polls once more after the end
    Ok(Body::from_stream(pieces.fuse()))
}
