//! Whether the service lives and whether it can work.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Serialize;
use tokio::net::TcpListener;

use super::app::App;
use super::start_error::StartError;
use crate::service::{PartHealth, Service};

/// How long the database has to answer before it counts as away.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3);

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
    /// `ok`, or why the database does not answer, or what is damaged of it.
    database: String,
    /// `ok`, or why nothing is removed from the raw recordings: the database does not know them.
    raw_recordings: String,
    /// `ok`, or why a record cannot be kept: the disk is full, for example.
    room: String,
    /// Records being processed or waiting.
    queue: Queue,
    /// Of a node of a cluster: `ok`, or why another part that it needs cannot be used.
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
pub(super) async fn ready(State(app): State<App>) -> Response {
    let (status, ready) = readiness(&app.service).await;
    let mut response = (status, ready).into_response();
    if status == StatusCode::SERVICE_UNAVAILABLE {
        response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(5));
    }
    response
}

async fn readiness(service: &Service) -> (StatusCode, Json<Ready>) {
    let database = tokio::time::timeout(ANSWER_TIMEOUT, service.store.check()).await;
    let database = match database {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("does not answer".to_owned()),
    };
    let room = room(service).await;
    let (used, limit) = service.workers.queue();
    let mut health = match service.role.queue() {
        Some(queue) => queue.health().await,
        None => Vec::new(),
    };
    if service.store.is_shared() {
        health.push(object_store(service).await);
    }
    let is_ready = database.is_none() && room.is_none() && used < limit && health.iter().all(|part| part.fault.is_none());
    let status = if is_ready {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    let or_ok = |fault: Option<String>| fault.unwrap_or_else(|| "ok".to_owned());
    let parts = Ready {
        status: if is_ready { "ok" } else { "unavailable" },
        database: or_ok(database),
        raw_recordings: or_ok(service.store.held()),
        room: or_ok(room),
        queue: Queue { used, limit },
        parts: health.into_iter().map(|part| (part.part, or_ok(part.fault))).collect(),
        feeds: feeds(service),
    };
    (status, Json(parts))
}

/// Why a record cannot be kept; none where it can.
async fn room(service: &Service) -> Option<String> {
    // What is damaged is not written to, and is told by itself.
    if service.store.damage().is_some() {
        return None;
    }
    let store = service.store.clone();
    let look = tokio::task::spawn_blocking(move || store.objects().check_room());
    match tokio::time::timeout(ANSWER_TIMEOUT, look).await {
        Ok(Ok(Ok(()))) => None,
        Ok(Ok(Err(error))) => Some(error.to_string()),
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("the disk does not answer".to_owned()),
    }
}

async fn object_store(service: &Service) -> PartHealth {
    let store = service.store.clone();
    // Whether it is there does not matter.
    let look = tokio::task::spawn_blocking(move || store.objects().written_at(&"0".repeat(64)));
    let fault = match tokio::time::timeout(ANSWER_TIMEOUT, look).await {
        Ok(Ok(Ok(_))) => None,
        Ok(Ok(Err(error))) => Some(error.to_string()),
        Ok(Err(error)) => Some(error.to_string()),
        Err(_) => Some("does not answer".to_owned()),
    };
    PartHealth {
        part: "object_store",
        fault,
    }
}

/// Tells of a process that answers nothing else whether it lives and can work.
pub struct HealthServer {
    address: SocketAddr,
    task: tokio::task::JoinHandle<()>,
}

impl HealthServer {
    /// Answers `/healthz` and `/readyz` on an address.
    ///
    /// Error: it cannot be listened on.
    pub async fn start(address: SocketAddr, service: Arc<Service>) -> Result<Self, StartError> {
        let failed = |source| StartError::Listen { address, source };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let router = axum::Router::new()
            .route("/healthz", get(alive))
            .route(
                "/readyz",
                get(|State(service): State<Arc<Service>>| async move { readiness(&service).await }),
            )
            .with_state(service);
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
