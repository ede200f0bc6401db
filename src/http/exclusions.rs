//! `…/exclude` and `…/include`: records that take no part in their histories, and do so again.

use axum::Json;
use axum::extract::State;
use serde::Serialize;

use super::app::App;
use super::problem::{Details, Problem};
use super::query::{AssetInPath, Parameters, SegmentInPath};
use super::segments::{RangeParameters, find};
use crate::asset::{AssetId, SegmentId};

/// How many records were changed.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Changed {
    /// Records of the asset that were not so before.
    changed: u64,
}

/// Exclude one segment
///
/// It stays stored with its indicators, and takes no part in the baseline, the estimate and the alarms any
/// more, also for the other assets of its sensor. The histories that it was part of are estimated anew in the
/// background.
#[utoipa::path(
    post,
    path = "/v1/segments/{segment}/exclude",
    tag = "records",
    params(("segment" = String, Path, description = "The segment")),
    responses((status = 200, body = Changed), (status = 409, body = Details, content_type = "application/problem+json", description = "It came for another asset, whose sensor this one shares")),
)]
pub(super) async fn exclude(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
) -> Result<Json<Changed>, Problem> {
    set_one(&app, &id, true).await
}

/// Include one segment
///
/// As if it had never been excluded.
#[utoipa::path(
    post,
    path = "/v1/segments/{segment}/include",
    tag = "records",
    params(("segment" = String, Path, description = "The segment")),
    responses((status = 200, body = Changed), (status = 409, body = Details, content_type = "application/problem+json", description = "It came for another asset, whose sensor this one shares")),
)]
pub(super) async fn include(
    State(app): State<App>,
    SegmentInPath(id): SegmentInPath,
) -> Result<Json<Changed>, Problem> {
    set_one(&app, &id, false).await
}

/// Exclude the segments of a range of time, or those that are named
///
/// As each of them by itself. Records that come later are not excluded.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/segments/exclude",
    tag = "records",
    params(("asset" = AssetId, Path, description = "The asset"), RangeParameters),
    responses((status = 200, body = Changed), (status = 422, description = "A time out of range", body = Details, content_type = "application/problem+json"), (status = 409, body = Details, content_type = "application/problem+json", description = "They come for another asset, whose sensor this one shares")),
)]
pub(super) async fn exclude_range(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<RangeParameters>,
) -> Result<Json<Changed>, Problem> {
    set_range(&app, &asset, asked, true).await
}

/// Include the segments of a range of time, or those that are named
///
/// As each of them by itself.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/segments/include",
    tag = "records",
    params(("asset" = AssetId, Path, description = "The asset"), RangeParameters),
    responses((status = 200, body = Changed), (status = 422, description = "A time out of range", body = Details, content_type = "application/problem+json"), (status = 409, body = Details, content_type = "application/problem+json", description = "They come for another asset, whose sensor this one shares")),
)]
pub(super) async fn include_range(
    State(app): State<App>,
    AssetInPath(asset): AssetInPath,
    Parameters(asked): Parameters<RangeParameters>,
) -> Result<Json<Changed>, Problem> {
    set_range(&app, &asset, asked, false).await
}

async fn set_one(app: &App, id: &SegmentId, is_excluded: bool) -> Result<Json<Changed>, Problem> {
    let segment = find(app, id).await?;
    let changed = app.service.exclusions.set_one(&segment, is_excluded).await?;
    Ok(Json(Changed { changed }))
}

async fn set_range(
    app: &App,
    asset: &AssetId,
    asked: RangeParameters,
    is_excluded: bool,
) -> Result<Json<Changed>, Problem> {
    let ranges = asked.ranges(app, asset, "a time here or in to, or ids").await?;
    let changed = app.service.exclusions.set_each(asset, &ranges, is_excluded).await?;
    Ok(Json(Changed { changed }))
}
