//! `/v1/segments/{segment}/lines`: any lines of a record's spectrum or envelope spectrum, beside those of its
//! healthy baseline.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};

use super::line_cache::Axis;
use super::line_levels::{SpectrumKind, SpectrumLines, geometric_mean};
use super::waterfall::evenly;
use super::{angle, envelope_band, matching};
use crate::asset::{Segment, SegmentId};
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{Parameters, SegmentPath};
use crate::http::segments;
use crate::service::BandChoice;

const MAX_LINES: usize = 64;

/// Number of baseline records whose spectra are computed.
const BASELINE_RECORDS: usize = 24;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct LineParameters {
    /// Positions of the lines in the unit of `axis`, comma-separated, 1 to 64.
    #[param(example = "398.4,415.1")]
    at: String,
    /// Axis of the positions.
    #[serde(default)]
    axis: Axis,
    /// Spectrum in which the lines are read.
    #[serde(default)]
    spectrum: SpectrumKind,
    /// For the envelope: lower end of the band in hertz; requires `band_high_hz`. By default the band of the
    /// asset, else the one found in the record.
    band_low_hz: Option<f64>,
    /// For the envelope: upper end of the band in hertz.
    band_high_hz: Option<f64>,
}

/// Lines of a spectrum and of the baseline.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SpectrumLines)]
pub(crate) struct LinesView {
    /// The record.
    segment_id: SegmentId,
    /// Axis of the positions.
    axis: Axis,
    /// Spectrum in which the lines are read.
    spectrum: SpectrumKind,
    /// The band of the envelope in hertz, the same for all records.
    #[serde(skip_serializing_if = "Option::is_none")]
    band_hz: Option<[f64; 2]>,
    /// Unit of the amplitudes.
    unit: String,
    /// Number of baseline records compared, at most 24 of them; 0 without a complete baseline.
    baseline_records: usize,
    /// The lines in the requested order.
    items: Vec<Line>,
}

/// One line: the maximum of the bin at its position and the two beside it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SpectrumLine)]
struct Line {
    /// Position in the unit of the axis.
    position: f64,
    /// Peak amplitude; none beyond the spectrum.
    amplitude: Option<f64>,
    /// Geometric mean of its amplitudes in the baseline records, at the same order if shaft speeds are known.
    baseline_amplitude: Option<f64>,
    /// Change from the baseline in dB.
    change_db: Option<f64>,
}

/// Lines of a spectrum and their change since the baseline
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/lines",
    tag = "records",
    params(LineParameters),
    responses(
        (status = 200, body = LinesView),
        (status = 422, description = "The record has no spectrum over orders"),
    ),
)]
pub(crate) async fn lines(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    Parameters(params): Parameters<LineParameters>,
) -> Result<Json<LinesView>, Problem> {
    let positions = positions(&params.at)?;
    let segment = segments::find(&app, &id).await?;
    let band = envelope_band::requested(params.band_low_hz, params.band_high_hz, &segment)?;
    if band.is_some() && params.spectrum == SpectrumKind::Amplitude {
        return Err(Problem::query(
            "band_low_hz, band_high_hz",
            "given",
            "no value without spectrum=envelope",
        ));
    }
    let band = band.map_or(BandChoice::OfAsset, BandChoice::Hertz);
    let mut baseline = matching::complete_baseline(&app, &segment).await?;
    baseline.retain(|record| record.unit == segment.unit);
    let chosen: Vec<Segment> =
        evenly(baseline.len(), BASELINE_RECORDS).into_iter().map(|n| baseline[n].clone()).collect();
    let _ticket = app.service.workers.admit_response()?;
    let mut lines = SpectrumLines { kind: params.spectrum, axis: params.axis, positions, band };
    let own =
        lines.compute(&app.service, &segment).await.map_err(|error| envelope_band::refusal(error, band))?;
    let (own, band_hz) = own.map_err(|reason| angle::absent("spectrum over orders", reason))?;
    if let Some(band_hz) = band_hz {
        lines.band = BandChoice::Hertz(band_hz);
    }
    let healthy = lines.of_baseline(&app.service, &segment, &chosen).await?;
    let items = lines.positions.iter().zip(own).enumerate().map(|(n, (position, amplitude))| {
        let baseline_amplitude = geometric_mean(healthy.iter().map(|record| record[n]));
        let ratio = amplitude.filter(|amplitude| *amplitude > 0.0).zip(baseline_amplitude);
        let change_db = ratio.map(|(now, then)| 20.0 * (now / then).log10());
        Line { position: *position, amplitude, baseline_amplitude, change_db }
    });
    Ok(Json(LinesView {
        axis: params.axis,
        spectrum: params.spectrum,
        band_hz,
        baseline_records: healthy.len(),
        items: items.collect(),
        unit: segment.unit,
        segment_id: segment.id,
    }))
}

fn positions(text: &str) -> Result<Vec<f64>, Problem> {
    let parse = |part: &str| part.trim().parse().ok().filter(|at: &f64| at.is_finite() && *at >= 0.0);
    let positions: Option<Vec<f64>> = text.split(',').map(parse).collect();
    positions
        .filter(|positions| positions.len() <= MAX_LINES)
        .ok_or_else(|| Problem::query("at", format!("{text:?}"), "1 to 64 numbers from 0, comma-separated"))
}
