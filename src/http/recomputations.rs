//! `/v1/recomputations`: histories being recomputed in the background.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};

use super::app::App;
use super::problem::Problem;
use super::request::query::Parameters;
use crate::asset::AssetId;
use crate::service::Recomputation;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ListParameters {
    /// Only those of this asset.
    asset: Option<AssetId>,
}

/// The last recomputation of each channel since the start.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RecomputationList {
    /// One entry per channel.
    items: Vec<Recomputation>,
}

/// List recomputations
///
/// Histories recomputed in the background after a change; the latest one of each channel.
#[utoipa::path(
    get,
    path = "/v1/recomputations",
    tag = "assets",
    params(ListParameters),
    responses(
        (status = 200, body = RecomputationList),
        (status = 404, description = "Asset not found"),
    ),
)]
pub(super) async fn list(
    State(app): State<App>,
    Parameters(params): Parameters<ListParameters>,
) -> Result<Json<RecomputationList>, Problem> {
    let asset = match params.asset {
        Some(id) => Some(app.service.store.asset(&id).await?.spec.id),
        None => None,
    };
    let shown = app.service.history.recomputations(asset.as_ref());
    Ok(Json(RecomputationList { items: shown.iter().map(|shown| Recomputation::clone(shown)).collect() }))
}
