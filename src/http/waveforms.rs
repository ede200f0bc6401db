//! A segment's samples, spectrum and envelope spectrum, from its raw bytes.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::problem::Problem;
use super::query::{self, Parameters, SegmentInPath};
use super::router::App;
use super::{reduction, segments};
use crate::asset::{Segment, SegmentId};
use crate::ingest::IngestError;
use crate::signal::{BandSource, MeshLine, Spectrum};

/// Points of a curve where the client does not say how many.
const DEFAULT_POINTS: usize = 4000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WaveformParameters {
    max_points: Option<usize>,
}

/// Samples over time.
#[derive(Debug, Serialize)]
pub(super) struct Waveform {
    segment_id: SegmentId,
    channel: String,
    start_time: Timestamp,
    sample_rate_hz: f64,
    unit: String,
    reduced: bool,
    time_s: Vec<f64>,
    value: Vec<f32>,
}

pub(super) async fn waveform(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
    Parameters(asked): Parameters<WaveformParameters>,
) -> Result<Json<Waveform>, Problem> {
    let most = query::max_points(asked.max_points, DEFAULT_POINTS)?;
    let segment = segments::find(&app, &id).await?;
    let _ticket = app.ingest.workers().admit()?;
    let record = app.ingest.recall(&segment).await?;
    let reduce = move || {
        let samples: Vec<f64> = record.samples().iter().map(|sample| f64::from(*sample)).collect();
        let kept = reduction::extremes(&[&samples], samples.len(), most);
        let time_s = kept.iter().map(|n| *n as f64 / record.sample_rate_hz()).collect();
        let value = kept.iter().map(|n| record.samples()[*n]).collect();
        (kept.len() < samples.len(), time_s, value)
    };
    let (reduced, time_s, value) = app.ingest.workers().run("reduce a waveform", reduce).await?;
    Ok(Json(Waveform {
        segment_id: segment.id,
        channel: segment.channel,
        start_time: segment.start_time,
        sample_rate_hz: segment.sample_rate_hz,
        unit: segment.unit,
        reduced,
        time_s,
        value,
    }))
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SpectrumParameters {
    max_points: Option<usize>,
    max_hz: Option<f64>,
}

/// Amplitude over frequency.
#[derive(Debug, Serialize)]
pub(super) struct SpectrumView {
    segment_id: SegmentId,
    quantity: &'static str,
    unit: String,
    window: &'static str,
    bandwidth_hz: f64,
    resolution_hz: f64,
    reduced: bool,
    frequency_hz: Vec<f64>,
    amplitude: Vec<f64>,
    shaft_speed_hz: Option<f64>,
    mesh_frequency_hz: Option<f64>,
    mesh_harmonics: Vec<MeshLine>,
}

pub(super) async fn spectrum(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
    Parameters(asked): Parameters<SpectrumParameters>,
) -> Result<Json<SpectrumView>, Problem> {
    let most = query::max_points(asked.max_points, DEFAULT_POINTS)?;
    let max_hz = max_hz(asked.max_hz)?;
    let segment = segments::find(&app, &id).await?;
    let _ticket = app.ingest.workers().admit()?;
    let (spectrum, lines) = app.ingest.spectrum(&segment).await?;
    Ok(Json(view(segment, spectrum, lines, most, max_hz)))
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EnvelopeParameters {
    band_low_hz: Option<f64>,
    band_high_hz: Option<f64>,
    max_points: Option<usize>,
    max_hz: Option<f64>,
}

/// Amplitude of the envelope over frequency.
#[derive(Debug, Serialize)]
pub(super) struct EnvelopeView {
    #[serde(flatten)]
    spectrum: SpectrumView,
    band_hz: [f64; 2],
    band_source: BandSource,
}

pub(super) async fn envelope(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
    Parameters(asked): Parameters<EnvelopeParameters>,
) -> Result<Json<EnvelopeView>, Problem> {
    let most = query::max_points(asked.max_points, DEFAULT_POINTS)?;
    let max_hz = max_hz(asked.max_hz)?;
    let segment = segments::find(&app, &id).await?;
    let half_rate_hz = segment.sample_rate_hz / 2.0;
    let band = match (asked.band_low_hz, asked.band_high_hz) {
        (None, None) => None,
        (Some(low), Some(high)) if low >= 0.0 && low < high && high <= half_rate_hz => Some([low, high]),
        (low, high) => {
            let found = format!("{low:?} to {high:?}").replace("Some(", "").replace(')', "");
            let expected = format!("both ends, the lower one first, from 0 to {half_rate_hz} Hz");
            return Err(Problem::query("band_low_hz, band_high_hz", found, &expected));
        }
    };
    let _ticket = app.ingest.workers().admit()?;
    let computed = app.ingest.envelope(&segment, band).await;
    let (spectrum, band_hz, band_source, lines) = computed.map_err(|error| match error {
        // A band that the record does not resolve, and that the address asked for.
        IngestError::Field { value, expected, .. } if band.is_some() => Problem::query("band_low_hz, band_high_hz", value, expected),
        error => error.into(),
    })?;
    Ok(Json(EnvelopeView {
        spectrum: view(segment, spectrum, lines, most, max_hz),
        band_hz,
        band_source,
    }))
}

fn max_hz(asked: Option<f64>) -> Result<f64, Problem> {
    match asked {
        None => Ok(f64::INFINITY),
        Some(hz) if hz > 0.0 => Ok(hz),
        Some(hz) => Err(Problem::query("max_hz", hz, "a frequency above 0")),
    }
}

fn view(segment: Segment, spectrum: Spectrum, lines: Vec<MeshLine>, most: usize, max_hz: f64) -> SpectrumView {
    let resolution_hz = spectrum.resolution_hz;
    let shown = spectrum
        .amplitude
        .len()
        .min(((max_hz / resolution_hz).floor() as usize).saturating_add(1));
    let amplitude = &spectrum.amplitude[..shown];
    let kept = reduction::peaks(amplitude, most);
    SpectrumView {
        segment_id: segment.id,
        quantity: spectrum.quantity,
        unit: spectrum.unit,
        window: spectrum.window,
        bandwidth_hz: spectrum.bandwidth_hz,
        resolution_hz,
        reduced: kept.len() < shown,
        frequency_hz: kept.iter().map(|n| *n as f64 * resolution_hz).collect(),
        amplitude: kept.iter().map(|n| amplitude[*n]).collect(),
        shaft_speed_hz: segment.shaft_speed.map(|speed| speed.shaft_speed_hz),
        mesh_frequency_hz: segment.shaft_speed.map(|speed| speed.mesh_frequency_hz),
        mesh_harmonics: lines,
    }
}
