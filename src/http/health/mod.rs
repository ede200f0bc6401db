//! Health checks: whether the service is alive, readable, and able to accept records.

pub(super) mod write_probe;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::{Deserialize, Serialize};
use tokio::net::TcpListener;

use super::app::App;
use super::metrics;
use super::metrics::queue::QueueWatch;
use super::problem::Problem;
use super::request::query::Parameters;
use super::server::start_error::StartError;
use crate::service::Service;
use write_probe::{RESPONSE_TIMEOUT, WriteProbe};

/// The process is alive.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Alive {
    /// `ok`.
    status: &'static str,
    /// The running version.
    version: &'static str,
}

/// The purpose of a readiness check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum Purpose {
    /// Read stored data: the database answers.
    Reading,
    /// Accept records as well: everything that stores a part of one is writable, and the queue has room.
    #[default]
    Records,
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ReadyParameters {
    /// What to check: `reading` stored data, or also accepting `records` (default).
    #[serde(default, rename = "for")]
    #[param(value_type = Option<Purpose>, example = "reading")]
    purpose: Purpose,
}

/// Whether the service is ready for the requested purpose.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Ready {
    /// `ok` or `unavailable`.
    status: &'static str,
    /// The requested purpose.
    #[serde(rename = "for")]
    purpose: Purpose,
    /// `ok`, or why the database does not answer or cannot be written to, or its damage.
    database: String,
    /// `ok`, or why no raw recordings are removed: the database does not know them.
    raw_recordings: String,
    /// For records: `ok`, or why a record cannot be stored, for example because the disk is full.
    #[serde(skip_serializing_if = "Option::is_none")]
    free_space: Option<String>,
    /// Records being processed or waiting.
    queue: Queue,
    /// For records in a cluster: `ok`, or why another required part is unavailable.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    parts: BTreeMap<&'static str, String>,
    /// Message connections that deliver records; missing if there are none. HTTP requests are accepted even
    /// if one is lost.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    feeds: Vec<FeedHealth>,
}

/// A message connection that delivers records.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct FeedHealth {
    /// Its kind, `mqtt`.
    name: &'static str,
    /// Whether it is connected.
    is_connected: bool,
    /// Messages that cannot be accepted now and wait unacknowledged.
    held: usize,
    /// Why it is not connected, or why messages wait; missing if all is well.
    #[serde(skip_serializing_if = "Option::is_none")]
    trouble: Option<String>,
}

/// The queue of records.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct Queue {
    /// Requests in it now.
    used: usize,
    /// Limit beyond which requests are refused.
    limit: usize,
}

/// Liveness check
#[utoipa::path(get, path = "/healthz", tag = "service", responses((status = 200, body = Alive)))]
pub(super) async fn alive() -> Json<Alive> {
    Json(Alive { status: "ok", version: env!("CARGO_PKG_VERSION") })
}

/// Readiness check
///
/// Acceptance of records is checked by writing to the database and, in a cluster, to the object store and the
/// queue, at most every 2 s.
#[utoipa::path(
    get,
    path = "/readyz",
    tag = "service",
    params(ReadyParameters),
    responses((status = 200, body = Ready), (status = 503, body = Ready, description = "Not ready")),
)]
pub(super) async fn ready(
    State(app): State<App>,
    Parameters(params): Parameters<ReadyParameters>,
) -> Response {
    readiness(&app.service, &app.write_probe, params.purpose).await
}

async fn readiness(service: &Arc<Service>, probe: &WriteProbe, purpose: Purpose) -> Response {
    let database = tokio::time::timeout(RESPONSE_TIMEOUT, service.store.check()).await;
    let mut database = match database {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("does not answer".to_owned()),
    };
    let (used, limit) = service.workers.queue();
    let mut is_ready = database.is_none();
    let or_ok = |fault: Option<String>| fault.unwrap_or_else(|| "ok".to_owned());
    let (mut free_space, mut parts) = (None, BTreeMap::new());
    if purpose == Purpose::Records {
        let found = probe.ask(service).await;
        is_ready &= found.is_whole() && used < limit;
        database = database.or(found.database);
        free_space = Some(or_ok(found.free_space));
        parts.extend(found.parts.into_iter().map(|part| (part.part, or_ok(part.fault))));
    }
    let ready = Ready {
        status: if is_ready { "ok" } else { "unavailable" },
        purpose,
        database: or_ok(database),
        raw_recordings: or_ok(service.store.removal_hold()),
        free_space,
        queue: Queue { used, limit },
        parts,
        feeds: feeds(service),
    };
    if is_ready {
        return Json(ready).into_response();
    }
    let mut response = (StatusCode::SERVICE_UNAVAILABLE, Json(ready)).into_response();
    response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(5));
    response
}

/// A server for a process without the API: answers health checks and metrics.
pub struct HealthServer {
    address: SocketAddr,
    task: tokio::task::JoinHandle<()>,
}

/// The state that is reported.
#[derive(Clone)]
struct HealthState {
    service: Arc<Service>,
    write_probe: Arc<WriteProbe>,
    queue: Arc<QueueWatch>,
}

impl HealthServer {
    /// Answers `/healthz`, `/readyz` and `/metrics` on an address.
    ///
    /// Fails if it cannot listen there.
    pub async fn start(address: SocketAddr, service: Arc<Service>) -> Result<Self, StartError> {
        let failed = |source| StartError::Listen { address, source };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let router = axum::Router::new()
            .route("/healthz", get(alive))
            .route("/readyz", get(ready_of_worker))
            .route("/metrics", get(metrics_of_worker))
            .with_state(HealthState { service, write_probe: Arc::default(), queue: Arc::default() });
        let task = tokio::spawn(async move {
            if let Err(error) = axum::serve(listener, router).await {
                tracing::error!(%error, "the health server stopped");
            }
        });
        Ok(Self { address: bound, task })
    }

    /// The address it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

async fn ready_of_worker(
    State(state): State<HealthState>,
    Parameters(params): Parameters<ReadyParameters>,
) -> Response {
    readiness(&state.service, &state.write_probe, params.purpose).await
}

async fn metrics_of_worker(State(state): State<HealthState>) -> Result<impl IntoResponse, Problem> {
    metrics::of_worker(&state.service, &state.queue).await
}

impl Drop for HealthServer {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn feeds(service: &Service) -> Vec<FeedHealth> {
    let feeds = service.feeds.all();
    let health = feeds.iter().map(|feed| FeedHealth {
        name: feed.name(),
        is_connected: feed.is_connected(),
        held: feed.held(),
        trouble: feed.trouble(),
    });
    health.collect()
}
