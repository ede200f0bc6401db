//! A segment's cepstrum.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};

use super::angle::absent;
use super::app::App;
use super::problem::{Details, Problem};
use super::query::{self, Parameters, SegmentInPath};
use super::segments;
use crate::asset::SegmentId;
use crate::signal::reduction;

/// Points of a curve where the client does not say how many.
const DEFAULT_POINTS: usize = 4000;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct CepstrumParameters {
    /// Points at most, 10 to 200000.
    #[param(minimum = 10, maximum = 200000)]
    max_points: Option<usize>,
    /// Longest quefrency shown, in seconds.
    #[param(exclusive_minimum = 0.0)]
    max_s: Option<f64>,
}

/// The real cepstrum over quefrency; its values have no unit.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CepstrumView {
    /// The record.
    segment_id: SegmentId,
    /// Distance of quefrencies in seconds: that of the samples.
    resolution_s: f64,
    /// Points were left out to keep to `max_points`.
    reduced: bool,
    /// Quefrencies in seconds.
    quefrency_s: Vec<f64>,
    /// The real cepstrum, without a unit.
    value: Vec<f64>,
    /// Tooth numbers, driving and driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    teeth: Option<[u32; 2]>,
    /// Shaft speed in hertz, where it is known.
    shaft_speed_hz: Option<f64>,
}

/// Real cepstrum of a segment
#[utoipa::path(
    get,
    path = "/v1/segments/{segment}/cepstrum",
    tag = "records",
    params(("segment" = String, Path, description = "The segment"), CepstrumParameters),
    responses((status = 200, body = CepstrumView), (status = 422, body = Details, description = "The record has no such curve", content_type = "application/problem+json")),
)]
pub(super) async fn cepstrum(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
    Parameters(asked): Parameters<CepstrumParameters>,
) -> Result<Json<CepstrumView>, Problem> {
    let most = query::max_points(asked.max_points, DEFAULT_POINTS)?;
    let max_s = match asked.max_s {
        None => f64::INFINITY,
        Some(seconds) if seconds > 0.0 => seconds,
        Some(seconds) => return Err(Problem::query("max_s", seconds, "seconds above 0")),
    };
    let segment = segments::find(&app, &id).await?;
    let teeth = app.service.store.asset(&segment.asset_id).await?.spec.teeth();
    let _ticket = app.service.workers.admit_answer()?;
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
    let kept = reduction::extremes(&[value], value.len(), most);
    Ok(Json(CepstrumView {
        segment_id: segment.id,
        resolution_s,
        reduced: kept.len() < value.len(),
        quefrency_s: kept.iter().map(|n| (first + n) as f64 * resolution_s).collect(),
        value: kept.iter().map(|n| value[*n]).collect(),
        teeth,
        shaft_speed_hz: segment.shaft_speed.map(|speed| speed.shaft_speed_hz),
    }))
}
