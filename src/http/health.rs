//! Whether the service lives and whether it can work.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde_json::json;

use super::router::App;

pub(super) async fn alive() -> Response {
    Json(json!({ "status": "ok", "version": env!("CARGO_PKG_VERSION") })).into_response()
}

pub(super) async fn ready(State(app): State<App>) -> Response {
    let database = app.ingest.store().check().await;
    let (used, most) = app.ingest.workers().queue();
    let is_ready = database.is_ok() && used < most;
    let status = if is_ready {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    let parts = json!({
        "status": if is_ready { "ok" } else { "unavailable" },
        "database": database.map_or_else(|error| error.to_string(), |()| "ok".to_string()),
        "queue": { "used": used, "limit": most },
    });
    (status, Json(parts)).into_response()
}
