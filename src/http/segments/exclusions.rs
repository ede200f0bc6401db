//! `…/exclude` and `…/include`: removes records from their histories and adds them again.

use axum::Json;
use axum::extract::State;
use serde::Serialize;

use super::{RangeParameters, find};
use crate::asset::{AssetId, SegmentId};
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{AssetPath, Parameters, SegmentPath};

/// The number of changed records.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct Changed {
    /// Records of the asset that changed.
    changed: u64,
}

/// Exclude one segment
///
/// The segment stays stored with its indicators, but is no longer used for the baseline, the estimate and
/// alarms, including those of other assets with the same sensor. The affected histories are recomputed in the
/// background.
#[utoipa::path(
    post,
    path = "/v1/segments/{segment}/exclude",
    tag = "records",
    responses(
        (status = 200, body = Changed),
        (status = 409, description = "The record belongs to another asset with the same sensor"),
    ),
)]
pub(crate) async fn exclude(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
) -> Result<Json<Changed>, Problem> {
    set_one(&app, &id, true).await
}

/// Include one segment
///
/// Reverses an exclusion.
#[utoipa::path(
    post,
    path = "/v1/segments/{segment}/include",
    tag = "records",
    responses(
        (status = 200, body = Changed),
        (status = 409, description = "The record belongs to another asset with the same sensor"),
    ),
)]
pub(crate) async fn include(
    State(app): State<App>,
    SegmentPath(id): SegmentPath,
) -> Result<Json<Changed>, Problem> {
    set_one(&app, &id, false).await
}

/// Exclude segments by time range or id
///
/// Applies to each as `POST /v1/segments/{segment}/exclude`. Later records are not excluded.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/segments/exclude",
    tag = "records",
    params(RangeParameters),
    responses(
        (status = 200, body = Changed),
        (status = 422, description = "A time out of range"),
        (status = 409, description = "The records belong to another asset with the same sensor"),
    ),
)]
pub(crate) async fn exclude_range(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<RangeParameters>,
) -> Result<Json<Changed>, Problem> {
    set_range(&app, &asset, params, true).await
}

/// Include segments by time range or id
///
/// Applies to each as `POST /v1/segments/{segment}/include`.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/segments/include",
    tag = "records",
    params(RangeParameters),
    responses(
        (status = 200, body = Changed),
        (status = 422, description = "A time out of range"),
        (status = 409, description = "The records belong to another asset with the same sensor"),
    ),
)]
pub(crate) async fn include_range(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<RangeParameters>,
) -> Result<Json<Changed>, Problem> {
    set_range(&app, &asset, params, false).await
}

async fn set_one(app: &App, id: &SegmentId, is_excluded: bool) -> Result<Json<Changed>, Problem> {
    let segment = find(app, id).await?;
    let changed = app.service.exclusions.set_one(&segment, is_excluded).await?;
    Ok(Json(Changed { changed }))
}

async fn set_range(
    app: &App,
    asset: &AssetId,
    params: RangeParameters,
    is_excluded: bool,
) -> Result<Json<Changed>, Problem> {
    let ranges = params.ranges(app, asset, "at least one of from, to and ids").await?;
    let changed = app.service.exclusions.set_each(asset, &ranges, is_excluded).await?;
    Ok(Json(Changed { changed }))
}
