//! What happens to every request around its handler.

use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::app::App;
use super::problem::Problem;
use super::streams;

/// Writes a line to the log for every request.
pub(super) async fn trace(request: Request, next: Next) -> Response {
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

/// Ends a request that takes too long. What an upload has begun goes on by itself and is found by its repeat.
pub(super) async fn time_out(
    State(app): State<App>,
    path: Option<MatchedPath>,
    request: Request,
    next: Next,
) -> Response {
    if streams::is_endless(request.method(), path.as_ref().map(MatchedPath::as_str)) {
        return next.run(request).await;
    }
    let mut most = app.limits.request_timeout;
    if matches!(*request.method(), Method::POST | Method::PATCH) {
        most += app.limits.body_timeout;
    }
    match tokio::time::timeout(most, next.run(request)).await {
        Ok(response) => response,
        Err(_) => {
            Problem::busy(format!("the request took longer than {} s", most.as_secs()), 5).into_response()
        }
    }
}

/// Answers for a handler that panicked: a fault of the program.
pub(super) fn panicked(_: Box<dyn std::any::Any + Send>) -> Response {
    // The panic's own message has gone to standard error.
    Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "the service made a mistake; its log says where")
        .into_response()
}

/// Measures how long a request takes, from its head to the head of its answer, whoever answers it.
pub(super) async fn measure(
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
