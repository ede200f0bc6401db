//! Processing of every request around its handler.

use std::sync::Arc;
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

/// Ends a request that takes too long. A change that has started continues; a repeated request finds its
/// result.
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

/// Handles a request that may change something in a task of its own: if its client disconnects or its time is
/// over, a change must not be left half done.
pub(crate) async fn run_to_end(State(app): State<App>, request: Request, next: Next) -> Response {
    if request.method().is_safe() {
        return next.run(request).await;
    }
    let handled = tokio::spawn(async move {
        // The end of the service waits for it.
        let _running = Arc::clone(&app.changes).read_owned().await;
        next.run(request).await
    });
    handled.await.unwrap_or_else(|_| panicked(Box::new(())))
}

/// Responds for a handler that panicked.
pub(crate) fn panicked(_: Box<dyn std::any::Any + Send>) -> Response {
    // The panic message itself goes to standard error
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
