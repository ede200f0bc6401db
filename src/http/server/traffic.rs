//! Processing of every request around its handler.

use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::http::app::App;
use crate::http::problem::Problem;
use crate::http::streams;

/// Logs every request.
pub(crate) async fn trace(request: Request, next: Next) -> Response {
    let began = Instant::now();
    let method = request.method().clone();
    let path = request.uri().path().to_string();
    let response = next.run(request).await;
    tracing::debug!(
        %method,
        path,
        status = response.status().as_u16(),
        milliseconds = began.elapsed().as_secs_f64() * 1e3,
        "request"
    );
    response
}

/// Ends a request that takes too long. An upload that has started continues and is found by a repeated
/// request.
pub(crate) async fn time_out(
    State(app): State<App>,
    path: Option<MatchedPath>,
    request: Request,
    next: Next,
) -> Response {
    if streams::is_endless(request.method(), path.as_ref().map(MatchedPath::as_str)) {
        return next.run(request).await;
    }
    let mut limit = app.limits.request_timeout;
    if matches!(*request.method(), Method::POST | Method::PATCH) {
        limit += app.limits.body_timeout;
    }
    match tokio::time::timeout(limit, next.run(request)).await {
        Ok(response) => response,
        Err(_) => {
            Problem::busy(format!("the request took longer than {} s", limit.as_secs()), 5).into_response()
        }
    }
}

/// Responds for a handler that panicked.
pub(crate) fn panicked(_: Box<dyn std::any::Any + Send>) -> Response {
    // the panic message itself goes to standard error
    Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "internal error; see the log").into_response()
}

/// Measures the time from a request's head to the head of its response.
pub(crate) async fn measure(
    State(app): State<App>,
    path: Option<MatchedPath>,
    request: Request,
    next: Next,
) -> Response {
    let began = Instant::now();
    let method = request.method().clone();
    let response = next.run(request).await;
    let route = path.as_ref().map(MatchedPath::as_str);
    app.measurements.request(&method, route, began.elapsed(), response.status());
    response
}
