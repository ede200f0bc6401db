//! A damaged database is read as far as possible and never written to.

use axum::extract::{Request, State};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::app::App;
use super::problem::{DamageFound, Problem};

/// Refuses requests that would write to a damaged database, and records damage found by other requests.
pub(super) async fn layer(State(app): State<App>, request: Request, next: Next) -> Response {
    let store = &app.service.store;
    let reads = [Method::GET, Method::HEAD, Method::OPTIONS].contains(request.method());
    if !reads && let Some(what) = store.damage() {
        let detail = format!("the database is damaged: {what}; writing is disabled");
        return Problem::new(StatusCode::SERVICE_UNAVAILABLE, detail).into_response();
    }
    let response = next.run(request).await;
    if let Some(DamageFound(found)) = response.extensions().get() {
        store.report_damage(found);
    }
    response
}
