//! A segment's cepstrum.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};

use super::angle::absent;
use crate::asset::SegmentId;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{self, Parameters, SegmentPath};
use crate::http::segments;
use crate::signal::reduction;

/// Default number of points of a curve.
const DEFAULT_POINTS: usize = 4000;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct CepstrumParameters {
    /// Maximum number of points, 10 to 200000.
    #[param(minimum = 10, maximum = 200000)]
    max_points: Option<usize>,
    /// Longest quefrency returned, in seconds.
    #[param(exclusive_minimum = 0.0)]
    max_s: Option<f64>,
}

/// The real cepstrum over quefrency; dimensionless.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct CepstrumView {
    /// The record.
    segment_id: SegmentId,
    /// Quefrency spacing in seconds, equal to the sample spacing.
    resolution_s: f64,
    /// Whether points were dropped to meet `max_points`.
    reduced: bool,
    /// Quefrencies in seconds.
    quefrency_s: Vec<f64>,
    /// The real cepstrum, dimensionless.
    value: Vec<f64>,
    /// Tooth counts, driving and driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    teeth: Option<[u32; 2]>,
    /// Shaft speed in hertz, if known.
    shaft_speed_hz: Option<f64>,
}

/// Real cepstrum of a segment
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/cepstrum",
    tag = "records",
    params(CepstrumParameters),
    responses(
        (status = 200, body = CepstrumView),
        (status = 422, description = "The curve is not available for this record"),
    ),
)]
pub(crate) async fn cepstrum(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
    Parameters(params): Parameters<CepstrumParameters>,
) -> Result<Json<CepstrumView>, Problem> {
    let max_points = query::max_points(params.max_points, DEFAULT_POINTS)?;
    let max_s = match params.max_s {
        None => f64::INFINITY,
        Some(seconds) if seconds > 0.0 => seconds,
        Some(seconds) => return Err(Problem::query("max_s", seconds, "seconds above 0")),
    };
    let segment = segments::find(&app, &id).await?;
    let teeth = app.service.store.asset(&segment.asset_id).await?.spec.teeth();
    let _ticket = app.service.workers.admit_response()?;
    let computed =
        app.service
            .records
            .analyse_stored(&segment, "compute a cepstrum", |analyzer, record, _| analyzer.cepstrum(record));
    let cepstrum = computed.await?.map_err(|reason| absent("cepstrum", reason))?;
    let resolution_s = cepstrum.resolution_s;
    // The value at zero is the mean level of the spectrum and dwarfs the others.
    let first = 1.min(cepstrum.value.len());
    let end = ((max_s / resolution_s).floor() as usize).saturating_add(1).clamp(first, cepstrum.value.len());
    let value = &cepstrum.value[first..end];
    let indices = reduction::extremes(&[value], value.len(), max_points);
    Ok(Json(CepstrumView {
        segment_id: segment.id,
        resolution_s,
        reduced: indices.len() < value.len(),
        quefrency_s: indices.iter().map(|n| (first + n) as f64 * resolution_s).collect(),
        value: indices.iter().map(|n| value[*n]).collect(),
        teeth,
        shaft_speed_hz: segment.shaft_speed.map(|speed| speed.shaft_speed_hz),
    }))
}
