//! A segment's samples, spectrum and envelope spectrum, from its raw bytes.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::line_levels::geometric_mean;
use super::line_range::LineRange;
use super::{envelope_band, matching};
use crate::asset::{Segment, SegmentId};
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{self, Parameters, SegmentPath};
use crate::http::segments;
use crate::service::BandChoice;
use crate::signal::{EnvelopeBand, EnvelopeSearch, MeshLine, Motion, Spectrum, reduction};

/// Default number of points of a curve.
const DEFAULT_POINTS: usize = 4000;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct WaveformParameters {
    /// Maximum number of points, 10 to 200000; the minimum and maximum of each interval are kept.
    #[param(minimum = 10, maximum = 200000)]
    max_points: Option<usize>,
    /// Start of the range, in seconds from the first sample.
    #[param(minimum = 0.0)]
    from_s: Option<f64>,
    /// End of the range.
    #[param(exclusive_minimum = 0.0)]
    to_s: Option<f64>,
    /// Quantity of the samples; by default as measured.
    #[param(inline)]
    quantity: Option<Motion>,
    /// Cut-off frequency of the integration in hertz, default 10.
    #[param(exclusive_minimum = 0.0)]
    cut_hz: Option<f64>,
}

/// Default cut-off frequency for velocity and displacement, as in ISO 20816.
const CUT_HZ: f64 = 10.0;

/// Samples over time.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct Waveform {
    /// The record.
    segment_id: SegmentId,
    /// Its channel.
    channel: String,
    /// Time of its first sample.
    start_time: Timestamp,
    /// Its sampling rate in hertz.
    sample_rate_hz: f64,
    /// Unit of `value`.
    unit: String,
    /// Whether samples were dropped to meet `max_points`.
    reduced: bool,
    /// Time since the first sample in seconds.
    time_s: Vec<f64>,
    /// The samples in `unit`.
    value: Vec<f32>,
}

/// Samples of a segment
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/waveform",
    tag = "records",
    params(WaveformParameters),
    responses((status = 200, body = Waveform)),
)]
pub(crate) async fn waveform(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    Parameters(params): Parameters<WaveformParameters>,
) -> Result<Json<Waveform>, Problem> {
    let max_points = query::max_points(params.max_points, DEFAULT_POINTS)?;
    let (from_s, to_s) = (params.from_s.unwrap_or(0.0), params.to_s.unwrap_or(f64::INFINITY));
    if !(from_s >= 0.0 && from_s < to_s) {
        let expected = "seconds from the first sample, from_s at least 0 and below to_s";
        return Err(Problem::query("from_s, to_s", format!("{from_s} to {to_s}"), expected));
    }
    let cut_hz = params.cut_hz.unwrap_or(CUT_HZ);
    if !(cut_hz > 0.0 && cut_hz.is_finite()) {
        return Err(Problem::query("cut_hz", cut_hz, "a frequency above 0 Hz"));
    }
    let segment = segments::find(&app, &id).await?;
    if params.quantity.is_some() && Motion::of_unit(&segment.unit).is_none() {
        let expected =
            format!("none, as the samples are in {:?}, which is not a unit of motion", segment.unit);
        return Err(Problem::query("quantity", "given", &expected));
    }
    let _ticket = app.service.workers.admit_response()?;
    let record = app.service.records.load(&segment).await?;
    let reduce = move || {
        let rate_hz = record.sample_rate_hz();
        let converted = params.quantity.and_then(|quantity| quantity.of_record(&record, cut_hz));
        let all = converted.as_deref().unwrap_or(record.samples());
        // One more sample on either side, so that the curve reaches the edges of the view
        let low = ((from_s * rate_hz).floor() as usize).min(all.len());
        let high = ((to_s * rate_hz).ceil() as usize).saturating_add(1).clamp(low, all.len());
        let samples: Vec<f64> = all[low..high].iter().map(|sample| f64::from(*sample)).collect();
        let indices = reduction::extremes(&[&samples], samples.len(), max_points);
        let time_s = indices.iter().map(|n| (low + n) as f64 / rate_hz).collect();
        let value = indices.iter().map(|n| all[low + *n]).collect();
        (indices.len() < samples.len(), time_s, value)
    };
    let (reduced, time_s, value) = app.service.workers.run("reduce a waveform", reduce).await?;
    Ok(Json(Waveform {
        segment_id: segment.id,
        channel: segment.channel,
        start_time: segment.start_time,
        sample_rate_hz: segment.sample_rate_hz,
        unit: params.quantity.map_or(segment.unit, |quantity| quantity.unit().to_owned()),
        reduced,
        time_s,
        value,
    }))
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct SpectrumParameters {
    /// Maximum number of points, 10 to 200000; the maximum of each interval is kept.
    #[param(minimum = 10, maximum = 200000)]
    max_points: Option<usize>,
    /// Lowest frequency returned, in hertz.
    #[param(minimum = 0.0)]
    from_hz: Option<f64>,
    /// Highest frequency returned, in hertz.
    #[param(exclusive_minimum = 0.0)]
    to_hz: Option<f64>,
}

/// Amplitude over frequency.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = Spectrum)]
pub(crate) struct SpectrumView {
    /// The record.
    segment_id: SegmentId,
    /// Kind of `amplitude`: `amplitude_peak`.
    quantity: &'static str,
    /// Unit of `amplitude`.
    unit: String,
    /// Window function.
    window: &'static str,
    /// Equivalent noise bandwidth in hertz.
    bandwidth_hz: f64,
    /// Bin spacing in hertz.
    resolution_hz: f64,
    /// Whether bins were dropped to meet `max_points`.
    reduced: bool,
    /// Frequencies in hertz.
    frequency_hz: Vec<f64>,
    /// Peak amplitudes in `unit`.
    amplitude: Vec<f64>,
    /// Shaft speed in hertz; none if unknown.
    shaft_speed_hz: Option<f64>,
    /// Mesh frequency in hertz.
    mesh_frequency_hz: Option<f64>,
    /// The mesh harmonics of the whole record, regardless of the requested range.
    mesh_harmonics: Vec<MeshHarmonic>,
}

/// One mesh harmonic, at full resolution.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct MeshHarmonic {
    #[serde(flatten)]
    line: MeshLine,
    /// Geometric mean of its amplitudes in the baseline records; missing without a baseline.
    #[serde(skip_serializing_if = "Option::is_none")]
    baseline_amplitude: Option<f64>,
}

/// Amplitude spectrum of a segment
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/spectrum",
    tag = "records",
    params(SpectrumParameters),
    responses((status = 200, body = SpectrumView)),
)]
pub(crate) async fn spectrum(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    Parameters(params): Parameters<SpectrumParameters>,
) -> Result<Json<SpectrumView>, Problem> {
    let max_points = query::max_points(params.max_points, DEFAULT_POINTS)?;
    let range = LineRange::new(["from_hz", "to_hz"], params.from_hz, params.to_hz)?;
    let segment = segments::find(&app, &id).await?;
    let _ticket = app.service.workers.admit_response()?;
    let baseline = matching::complete_baseline(&app, &segment).await?;
    let (spectrum, lines) = app.service.records.spectrum(&segment).await?;
    let mut view = view(segment, spectrum, lines, max_points, range);
    for harmonic in &mut view.mesh_harmonics {
        harmonic.baseline_amplitude = baseline_amplitude(&baseline, harmonic.line.order, &view.unit);
    }
    Ok(Json(view))
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct EnvelopeParameters {
    /// Selection of the band, unless its ends are given.
    band: Option<EnvelopeSearch>,
    /// Lower end of the band in hertz; requires `band_high_hz`.
    band_low_hz: Option<f64>,
    /// Upper end of the band in hertz.
    band_high_hz: Option<f64>,
    /// Maximum number of points, 10 to 200000; the maximum of each interval is kept.
    #[param(minimum = 10, maximum = 200000)]
    max_points: Option<usize>,
    /// Lowest frequency returned, in hertz.
    #[param(minimum = 0.0)]
    from_hz: Option<f64>,
    /// Highest frequency returned, in hertz.
    #[param(exclusive_minimum = 0.0)]
    to_hz: Option<f64>,
}

/// Amplitude of the envelope over frequency.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = EnvelopeSpectrum)]
pub(crate) struct EnvelopeView {
    #[serde(flatten)]
    spectrum: SpectrumView,
    #[serde(flatten)]
    band: EnvelopeBand,
}

/// Envelope spectrum of a segment
///
/// Empty if the record is too short for any band and none was requested.
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/envelope",
    tag = "records",
    params(EnvelopeParameters),
    responses(
        (status = 200, body = EnvelopeView),
        (status = 422, description = "The record does not resolve the asset's band"),
    ),
)]
pub(crate) async fn envelope(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    Parameters(params): Parameters<EnvelopeParameters>,
) -> Result<Json<EnvelopeView>, Problem> {
    let max_points = query::max_points(params.max_points, DEFAULT_POINTS)?;
    let range = LineRange::new(["from_hz", "to_hz"], params.from_hz, params.to_hz)?;
    let segment = segments::find(&app, &id).await?;
    if params.band.is_some() && (params.band_low_hz.is_some() || params.band_high_hz.is_some()) {
        let expected = "no value together with band_low_hz and band_high_hz";
        return Err(Problem::query("band", "given", expected));
    }
    let ends = envelope_band::requested(params.band_low_hz, params.band_high_hz, &segment)?;
    let band = match (params.band, ends) {
        (Some(search), _) => BandChoice::Search(search),
        (None, Some(ends)) => BandChoice::Hertz(ends),
        (None, None) => BandChoice::OfAsset,
    };
    let _ticket = app.service.workers.admit_response()?;
    let computed = app.service.records.envelope(&segment, band).await;
    let envelope = computed.map_err(|error| envelope_band::refusal(error, band))?;
    Ok(Json(EnvelopeView {
        spectrum: view(segment, envelope.spectrum, envelope.mesh_lines, max_points, range),
        band: envelope.band,
    }))
}

/// The geometric mean of a mesh harmonic's amplitudes in the baseline records; `None` if one of them lacks
/// it.
fn baseline_amplitude(baseline: &[Segment], order: u32, unit: &str) -> Option<f64> {
    let name = format!("mesh_{order}");
    let amplitude =
        |record: &Segment| record.indicators.values.get(&name).copied().filter(|_| record.unit == unit);
    geometric_mean(baseline.iter().map(amplitude))
}

fn view(
    segment: Segment,
    spectrum: Spectrum,
    lines: Vec<MeshLine>,
    max_points: usize,
    range: LineRange,
) -> SpectrumView {
    let resolution_hz = spectrum.resolution_hz;
    let places = range.places(spectrum.amplitude.len(), resolution_hz);
    let (first, amplitude) = (places.start, &spectrum.amplitude[places]);
    let indices = reduction::peaks(amplitude, max_points);
    SpectrumView {
        segment_id: segment.id,
        quantity: spectrum.quantity,
        unit: spectrum.unit,
        window: spectrum.window,
        bandwidth_hz: spectrum.bandwidth_hz,
        resolution_hz,
        reduced: indices.len() < amplitude.len(),
        frequency_hz: indices.iter().map(|n| (first + n) as f64 * resolution_hz).collect(),
        amplitude: indices.iter().map(|n| amplitude[*n]).collect(),
        shaft_speed_hz: segment.shaft_speed.map(|speed| speed.shaft_speed_hz),
        mesh_frequency_hz: segment.shaft_speed.map(|speed| speed.mesh_frequency_hz),
        mesh_harmonics: lines
            .into_iter()
            .map(|line| MeshHarmonic { line, baseline_amplitude: None })
            .collect(),
    }
}
