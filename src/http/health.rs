//! Whether the service lives and whether it can work.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::Serialize;

use super::router::App;

/// That the process lives.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Alive {
    /// `ok`.
    status: &'static str,
    /// The running version.
    version: &'static str,
}

/// Whether the service can take records.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Ready {
    /// `ok` or `unavailable`.
    status: &'static str,
    /// `ok`, or why the database does not answer.
    database: String,
    /// Records being processed or waiting.
    queue: Queue,
    /// Of a node of a cluster: `ok`, or why another part that it needs cannot be used.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    parts: BTreeMap<&'static str, String>,
}

/// The queue of records.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct Queue {
    /// Requests in it now.
    used: usize,
    /// Beyond which further ones are refused.
    limit: usize,
}

/// Whether the process lives
#[utoipa::path(get, path = "/healthz", tag = "service", responses((status = 200, body = Alive)))]
pub(super) async fn alive() -> Json<Alive> {
    Json(Alive {
        status: "ok",
        version: env!("CARGO_PKG_VERSION"),
    })
}

/// Whether the service can take records
#[utoipa::path(
    get,
    path = "/readyz",
    tag = "service",
    responses((status = 200, body = Ready), (status = 503, body = Ready, description = "Not now")),
)]
pub(super) async fn ready(State(app): State<App>) -> (StatusCode, Json<Ready>) {
    let database = app.ingest.store().check().await;
    let (used, limit) = app.ingest.workers().queue();
    let health = match app.ingest.crew() {
        Some(crew) => crew.health().await,
        None => Vec::new(),
    };
    let is_ready = database.is_ok() && used < limit && health.iter().all(|part| part.fault.is_none());
    let status = if is_ready {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    let parts = Ready {
        status: if is_ready { "ok" } else { "unavailable" },
        database: database.map_or_else(|error| error.to_string(), |()| "ok".to_string()),
        queue: Queue { used, limit },
        parts: health
            .into_iter()
            .map(|part| (part.part, part.fault.unwrap_or_else(|| "ok".to_owned())))
            .collect(),
    };
    (status, Json(parts))
}
