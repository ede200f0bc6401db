//! Measuring campaigns of live streams: all samples become records for a limited time.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::Deserialize;

use super::StreamName;
use crate::asset::DEFAULT_STREAM;
use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::request::query::{AssetPath, Parameters};
use crate::service::CampaignStatus;

/// The maximum duration of a campaign: one day.
const MAX_S: f64 = 86_400.0;

/// A campaign to start.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(crate) struct CampaignParameters {
    /// The stream's name, default `main`.
    name: Option<String>,
    /// Duration in seconds, at most 86400, default 60.
    #[param(minimum = 1, maximum = 86400)]
    seconds: Option<f64>,
}

/// Start a measuring campaign
///
/// All samples from now on become back-to-back records, regardless of the asset's stream settings. A running
/// campaign is replaced.
#[utoipa::path(
    post,
    path = "/v1/assets/{asset}/stream/campaign",
    tag = "streams",
    params(CampaignParameters),
    responses(
        (status = 200, body = CampaignStatus),
    ),
)]
pub(crate) async fn begin(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<CampaignParameters>,
) -> Result<Json<CampaignStatus>, Problem> {
    let seconds = params.seconds.unwrap_or(60.0);
    if !(1.0..=MAX_S).contains(&seconds) {
        return Err(Problem::query("seconds", seconds, "a number from 1 to 86400"));
    }
    let name = params.name.as_deref().unwrap_or(DEFAULT_STREAM);
    Ok(Json(app.service.streams.begin_campaign(&asset, name, seconds).await?))
}

/// End a measuring campaign
///
/// The samples received so far become its last record. Does nothing if no campaign is running.
#[utoipa::path(
    delete,
    path = "/v1/assets/{asset}/stream/campaign",
    tag = "streams",
    params(StreamName),
    responses((status = 204, description = "No campaign is running")),
)]
pub(crate) async fn end(
    State(app): State<App>,
    AssetPath(asset): AssetPath,
    Parameters(params): Parameters<StreamName>,
) -> Result<StatusCode, Problem> {
    let name = params.name.as_deref().unwrap_or(DEFAULT_STREAM);
    app.service.streams.end_campaign(&asset, name).await?;
    Ok(StatusCode::NO_CONTENT)
}
