//! `/v1/replays`.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::Serialize;

use super::app::App;
use super::problem::Problem;
use super::request::body::JsonBody;
use super::request::query::{self, NamePath, Page, PageParameters, Parameters};
use crate::service::{Replay, ReplayFile, ReplayRequest};

/// Start a replay
///
/// Replays a recording from the configured folder.
#[utoipa::path(
    post,
    path = "/v1/replays",
    tag = "replays",
    request_body(content = ReplayRequest),
    responses(
        (status = 404, description = "Asset not found"),
        (status = 409, description = "The asset uses the sensor of another asset"),
        (status = 202, body = Replay, headers(("location" = String, description = "Its address"))),
    ),
)]
pub(super) async fn start(
    State(app): State<App>,
    JsonBody(request): JsonBody<ReplayRequest>,
) -> Result<impl IntoResponse, Problem> {
    let replay = app.service.replays.start(request).await?;
    let location = format!("/v1/replays/{}", replay.id);
    Ok((StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(Replay::clone(&replay))))
}

/// Recordings that can be replayed
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ReplayFiles {
    /// Newest first, at most 1000.
    items: Vec<ReplayFile>,
}

/// List recordings that can be replayed
///
/// Recordings in the configured folder and its subfolders, in any supported format. A node of a cluster has
/// no such folder.
#[utoipa::path(
    get,
    path = "/v1/replay-files",
    tag = "replays",
    responses((status = 200, body = ReplayFiles)),
)]
pub(super) async fn files(State(app): State<App>) -> Result<Json<ReplayFiles>, Problem> {
    Ok(Json(ReplayFiles { items: app.service.replays.files().await? }))
}

/// List replays
///
/// Since the service started, newest first.
#[utoipa::path(
    get,
    path = "/v1/replays",
    tag = "replays",
    params(PageParameters),
    responses((status = 200, body = Page<Replay>)),
)]
pub(super) async fn list(
    State(app): State<App>,
    Parameters(params): Parameters<PageParameters>,
) -> Result<Json<Page<Replay>>, Problem> {
    let limit = query::limit(params.limit)?;
    let all = app.service.replays.list();
    let start = match &params.cursor {
        None => 0,
        Some(cursor) => {
            let position = all.iter().position(|replay| replay.id == *cursor);
            1 + position
                .ok_or_else(|| Problem::query("cursor", cursor, "the next_cursor of the previous page"))?
        }
    };
    let shown: Vec<Replay> =
        all[start..].iter().take(limit as usize + 1).map(|replay| Replay::clone(replay)).collect();
    Ok(Json(Page::new(shown, limit, |replay| replay.id.clone())))
}

/// Get the progress of a replay
#[utoipa::path(
    get,
    path = "/v1/replays/{replay}",
    tag = "replays",
    responses((status = 200, body = Replay)),
)]
pub(super) async fn show(State(app): State<App>, NamePath(id): NamePath) -> Result<Json<Replay>, Problem> {
    Ok(Json(Arc::unwrap_or_clone(app.service.replays.get(&id)?)))
}

/// Stop a replay
#[utoipa::path(
    delete,
    path = "/v1/replays/{replay}",
    tag = "replays",
    responses((status = 200, body = Replay)),
)]
pub(super) async fn stop(State(app): State<App>, NamePath(id): NamePath) -> Result<Json<Replay>, Problem> {
    Ok(Json(Arc::unwrap_or_clone(app.service.replays.stop(&id).await?)))
}
