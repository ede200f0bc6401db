//! Whether the service lives and whether it can work.

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
    /// Connections over which records come besides requests; absent where there are none. Requests are taken also while one is lost.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    feeds: Vec<FeedHealth>,
}

/// A connection over which records come.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct FeedHealth {
    /// What it is, `mqtt`.
    name: &'static str,
    /// Whether the connection stands.
    is_connected: bool,
    /// Messages that cannot be taken now and wait, unacknowledged.
    held: usize,
    /// Why it is not connected, or why messages wait; absent where all is well.
    #[serde(skip_serializing_if = "Option::is_none")]
    trouble: Option<String>,
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
    let is_ready = database.is_ok() && used < limit;
    let status = if is_ready {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    let parts = Ready {
        status: if is_ready { "ok" } else { "unavailable" },
        database: database.map_or_else(|error| error.to_string(), |()| "ok".to_string()),
        queue: Queue { used, limit },
        feeds: feeds(&app),
    };
    (status, Json(parts))
}

fn feeds(app: &App) -> Vec<FeedHealth> {
    let feeds = app.ingest.feeds();
    let health = feeds.iter().map(|feed| FeedHealth {
        name: feed.name(),
        is_connected: feed.is_connected(),
        held: feed.held(),
        trouble: feed.trouble(),
    });
    health.collect()
}
