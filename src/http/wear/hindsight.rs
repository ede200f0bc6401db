//! `/v1/assets/{asset}/wear/hindsight`: records re-estimated with a later inspection.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Uri, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{assets, etag};
use crate::asset::SegmentId;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{AssetPath, Parameters};

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct HindsightParameters {
    /// The channel; by default the one that represents the asset.
    channel: Option<String>,
}

/// Wear before the last inspection, re-estimated with its result.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
#[schema(as = WearHindsight)]
pub(crate) struct HindsightView {
    /// The channel; none if the asset has no records.
    channel: Option<String>,
    /// Records with a depth in order of time; empty without an inspection.
    items: Vec<HindsightRow>,
}

#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = WearHindsightRow)]
struct HindsightRow {
    /// Time of the record's first sample.
    start_time: Timestamp,
    /// The record.
    segment_id: SegmentId,
    /// Median wear depth in µm.
    median_um: f64,
    /// Lower end of the 90 % interval of the wear depth in µm.
    low_um: f64,
    /// Upper end of this interval in µm.
    high_um: f64,
}

/// Wear in hindsight of an inspection
///
/// An inspection shows which of the simulated pairs match the machine. With that knowledge the earlier
/// records are filtered again, which takes some milliseconds per record; at most 5000 are processed. The
/// history itself stays unchanged.
#[utoipa::path(
    get,
    path = "/v1/assets/{asset}/wear/hindsight",
    tag = "trends",
    params(HindsightParameters),
    responses((status = 200, body = HindsightView), (status = 304, description = "Not modified")),
)]
pub(crate) async fn hindsight(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<HindsightParameters>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (asset, channel) = assets::asset_and_channel(&app, &asset, params.channel.as_deref()).await?;
    let tag = etag::of_channel(&asset, channel.as_ref(), &uri, &headers);
    if etag::is_known(&headers, &tag) {
        return Ok(etag::not_modified(tag));
    }
    let Some(channel) = channel else {
        return Ok(([(header::ETAG, tag)], Json(HindsightView::default())).into_response());
    };
    let _ticket = app.service.workers.admit_response()?;
    let estimates = app.service.history.in_hindsight(&channel).await?;
    let rows = estimates.into_iter().filter_map(|(key, wear)| {
        Some(HindsightRow {
            start_time: key.start_time,
            segment_id: key.id,
            median_um: wear.median_um?,
            low_um: wear.low_um?,
            high_um: wear.high_um?,
        })
    });
    let view = HindsightView { channel: Some(channel.channel.clone()), items: rows.collect() };
    Ok(([(header::ETAG, tag)], Json(view)).into_response())
}
