//! `/v1/segments/{segment}/lines`: any lines of a record's spectrum, beside those of its healthy baseline.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use tokio::task::JoinSet;

use super::app::App;
use super::line_cache::Axis;
use super::problem::{Details, Problem};
use super::query::{Parameters, SegmentInPath};
use super::waterfall::evenly;
use super::{angle, matching, segments};
use crate::asset::{Segment, SegmentId};
use crate::service::{Service, ServiceError};
use crate::signal::NotComputed;

const MAX_LINES: usize = 64;

/// Number of baseline records whose spectra are computed.
const BASELINE_RECORDS: usize = 24;

/// Number of spectra computed at the same time: each holds a whole record.
const AT_ONCE: usize = 4;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct LineParameters {
    /// Positions of the lines in the unit of `axis`, comma-separated, 1 to 64.
    #[param(example = "398.4,415.1")]
    at: String,
    /// Axis of the positions.
    #[serde(default)]
    axis: Axis,
}

/// Lines of a spectrum and of the baseline.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = SpectrumLines)]
pub(super) struct LinesView {
    /// The record.
    segment_id: SegmentId,
    /// Axis of the positions.
    axis: Axis,
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
    params(("segment" = String, Path, description = "The segment"), LineParameters),
    responses((status = 200, body = LinesView), (status = 422, body = Details, description = "The record has no spectrum over orders", content_type = "application/problem+json")),
)]
pub(super) async fn lines(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
    Parameters(params): Parameters<LineParameters>,
) -> Result<Json<LinesView>, Problem> {
    let positions = positions(&params.at)?;
    let segment = segments::find(&app, &id).await?;
    let mut baseline = matching::baseline(&app, &segment).await?;
    if baseline.len() < segment.wear.baseline.need as usize {
        baseline.clear(); // the baseline is still being collected
    }
    baseline.retain(|record| record.unit == segment.unit);
    let chosen: Vec<Segment> =
        evenly(baseline.len(), BASELINE_RECORDS).into_iter().map(|n| baseline[n].clone()).collect();
    let _ticket = app.service.workers.admit_answer()?;
    let own = amplitudes(&app.service, &segment, params.axis, positions.clone()).await?;
    let own = own.map_err(|reason| angle::absent("spectrum over orders", reason))?;
    let healthy = of_baseline(&app, &segment, &chosen, params.axis, &positions).await?;
    let items = positions.iter().zip(own).enumerate().map(|(n, (position, amplitude))| {
        let baseline_amplitude = geometric_mean(healthy.iter().map(|record| record[n]));
        let ratio = amplitude.filter(|amplitude| *amplitude > 0.0).zip(baseline_amplitude);
        let change_db = ratio.map(|(now, then)| 20.0 * (now / then).log10());
        Line { position: *position, amplitude, baseline_amplitude, change_db }
    });
    Ok(Json(LinesView {
        axis: params.axis,
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

/// The amplitudes of baseline records at the lines of a segment; records without raw bytes or speed are left
/// out.
async fn of_baseline(
    app: &App,
    segment: &Segment,
    baseline: &[Segment],
    axis: Axis,
    positions: &[f64],
) -> Result<Vec<Vec<Option<f64>>>, Problem> {
    let mut healthy = Vec::new();
    for some in baseline.chunks(AT_ONCE) {
        let mut tasks = JoinSet::new();
        for record in some {
            let scale = match axis {
                Axis::Hz => speed_ratio(record, segment),
                Axis::Orders => 1.0,
            };
            let (service, record) = (app.service.clone(), record.clone());
            let places: Vec<f64> = positions.iter().map(|at| at * scale).collect();
            tasks.spawn(async move { amplitudes(&service, &record, axis, places).await });
        }
        while let Some(done) = tasks.join_next().await {
            match done.map_err(|_| ServiceError::WorkerLost("read the lines of a spectrum"))? {
                Ok(Ok(read)) => healthy.push(read),
                Ok(Err(_)) => {}
                Err(error) if error.is_raw_unavailable() => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
    Ok(healthy)
}

/// Shaft speed of a record relative to that of another; 1 if either is unknown.
fn speed_ratio(record: &Segment, other: &Segment) -> f64 {
    let speeds = record.shaft_speed.zip(other.shaft_speed);
    speeds.map_or(1.0, |(one, two)| one.shaft_speed_hz / two.shaft_speed_hz)
}

/// The amplitudes of a segment's spectrum at these positions.
async fn amplitudes(
    service: &Service,
    segment: &Segment,
    axis: Axis,
    positions: Vec<f64>,
) -> Result<Result<Vec<Option<f64>>, NotComputed>, ServiceError> {
    let read = move |amplitude: &[f64], resolution: f64| -> Vec<Option<f64>> {
        positions.iter().map(|at| line_at(amplitude, at / resolution)).collect()
    };
    service
        .records
        .analyse_stored(segment, "read the lines of a spectrum", move |analyzer, record, mesh| match axis {
            Axis::Hz => {
                let spectrum = analyzer.amplitude_spectrum(record);
                Ok(read(&spectrum.amplitude, spectrum.resolution_hz))
            }
            Axis::Orders => analyzer
                .order_spectrum(record, mesh, None)
                .map(|spectrum| read(&spectrum.amplitude, spectrum.resolution_orders)),
        })
        .await
}

/// The maximum of the bin nearest to a place and the two beside it, as a tone may fall between two; `None`
/// beyond the spectrum.
fn line_at(amplitude: &[f64], place: f64) -> Option<f64> {
    let nearest = place.round() as usize;
    let around = nearest.saturating_sub(1)..amplitude.len().min(nearest + 2);
    (nearest < amplitude.len()).then(|| amplitude[around].iter().copied().fold(0.0, f64::max))
}

/// The geometric mean of positive values; `None` if one is missing or there are none.
fn geometric_mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let logarithms: Vec<f64> =
        values.map(|value| value.filter(|value| *value > 0.0).map(f64::ln)).collect::<Option<_>>()?;
    (!logarithms.is_empty()).then(|| (logarithms.iter().sum::<f64>() / logarithms.len() as f64).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_between_two_bins_is_found() {
        let amplitude = [0.0, 1.0, 5.0, 1.0, 0.0];
        let at = |place| line_at(&amplitude, place);
        assert_eq!([at(1.4), at(3.0), at(0.0), at(4.0)], [Some(5.0), Some(5.0), Some(1.0), Some(1.0)]);
        assert_eq!(at(4.6), None);
    }

    #[test]
    fn the_mean_of_levels_is_geometric() {
        let mean = |values: &[Option<f64>]| geometric_mean(values.iter().copied());
        assert!((mean(&[Some(1.0), Some(100.0)]).unwrap() - 10.0).abs() < 1e-12);
        assert_eq!([mean(&[]), mean(&[Some(1.0), None]), mean(&[Some(0.0)])], [None, None, None]);
    }
}
