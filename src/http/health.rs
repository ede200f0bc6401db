//! Whether the service lives, whether it can be read, and whether it can take records.

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
use super::problem::Problem;
use super::query::Parameters;
use super::queue_metrics::QueueWatch;
use super::start_error::StartError;
use super::write_probe::{ANSWER_TIMEOUT, WriteProbe};
use crate::service::Service;

/// That the process lives.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Alive {
    /// `ok`.
    status: &'static str,
    /// The running version.
    version: &'static str,
}

/// What the service is to be ready for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum Purpose {
    /// To show what is stored: the database answers.
    Reading,
    /// To take records too: everything that keeps a part of one can be written, and the queue has room.
    #[default]
    Records,
}

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ReadyParameters {
    /// For what: `reading` what is stored, or taking `records` too, which is what is meant where it is not
    /// given.
    #[serde(default, rename = "for")]
    #[param(value_type = Option<Purpose>, example = "reading")]
    purpose: Purpose,
}

/// Whether the service is ready for what was asked.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Ready {
    /// `ok` or `unavailable`.
    status: &'static str,
    /// What was asked for.
    #[serde(rename = "for")]
    purpose: Purpose,
    /// `ok`, or why the database does not answer or takes nothing, or what is damaged of it.
    database: String,
    /// `ok`, or why nothing is removed from the raw recordings: the database does not know them.
    raw_recordings: String,
    /// Asked for records: `ok`, or why a record cannot be kept: the disk is full, for example.
    #[serde(skip_serializing_if = "Option::is_none")]
    room: Option<String>,
    /// Records being processed or waiting.
    queue: Queue,
    /// Asked for records, of a process of a cluster: `ok`, or why another part that it needs cannot be used.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    parts: BTreeMap<&'static str, String>,
    /// Connections over which records come besides requests; absent where there are none. Requests are taken
    /// also while one is lost.
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
    Json(Alive { status: "ok", version: env!("CARGO_PKG_VERSION") })
}

/// Whether the service can be read, or can take records
///
/// Taking records is found out by writing: to the database and, in a cluster, to the object store and the
/// queue, at most every 2 s.
#[utoipa::path(
    get,
    path = "/readyz",
    tag = "service",
    params(ReadyParameters),
    responses((status = 200, body = Ready), (status = 503, body = Ready, description = "Not now")),
)]
pub(super) async fn ready(
    State(app): State<App>,
    Parameters(asked): Parameters<ReadyParameters>,
) -> Response {
    readiness(&app.service, &app.write_probe, asked.purpose).await
}

async fn readiness(service: &Arc<Service>, probe: &WriteProbe, purpose: Purpose) -> Response {
    let database = tokio::time::timeout(ANSWER_TIMEOUT, service.store.check()).await;
    let mut database = match database {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("does not answer".to_owned()),
    };
    let (used, limit) = service.workers.queue();
    let mut is_ready = database.is_none();
    let or_ok = |fault: Option<String>| fault.unwrap_or_else(|| "ok".to_owned());
    let (mut room, mut parts) = (None, BTreeMap::new());
    if purpose == Purpose::Records {
        let found = probe.ask(service).await;
        is_ready &= found.is_whole() && used < limit;
        database = database.or(found.database);
        room = Some(or_ok(found.room));
        parts.extend(found.parts.into_iter().map(|part| (part.part, or_ok(part.fault))));
    }
    let ready = Ready {
        status: if is_ready { "ok" } else { "unavailable" },
        purpose,
        database: or_ok(database),
        raw_recordings: or_ok(service.store.removal_hold()),
        room,
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

/// Tells of a process that answers nothing else whether it lives and can work, and what it measures.
pub struct HealthServer {
    address: SocketAddr,
    task: tokio::task::JoinHandle<()>,
}

/// What is told about.
#[derive(Clone)]
struct Watched {
    service: Arc<Service>,
    write_probe: Arc<WriteProbe>,
    queue: Arc<QueueWatch>,
}

impl HealthServer {
    /// Answers `/healthz`, `/readyz` and `/metrics` on an address.
    ///
    /// Error: it cannot be listened on.
    pub async fn start(address: SocketAddr, service: Arc<Service>) -> Result<Self, StartError> {
        let failed = |source| StartError::Listen { address, source };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let router = axum::Router::new()
            .route("/healthz", get(alive))
            .route("/readyz", get(ready_of_worker))
            .route("/metrics", get(metrics_of_worker))
            .with_state(Watched { service, write_probe: Arc::default(), queue: Arc::default() });
        let task = tokio::spawn(async move {
            if let Err(error) = axum::serve(listener, router).await {
                tracing::error!(%error, "the health server stopped");
            }
        });
        Ok(Self { address: bound, task })
    }

    /// The address that it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

async fn ready_of_worker(
    State(watched): State<Watched>,
    Parameters(asked): Parameters<ReadyParameters>,
) -> Response {
    readiness(&watched.service, &watched.write_probe, asked.purpose).await
}

async fn metrics_of_worker(State(watched): State<Watched>) -> Result<impl IntoResponse, Problem> {
    metrics::of_worker(&watched.service, &watched.queue).await
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
