//! `GET /metrics` and `GET /metrics/machines` in Prometheus' text format.
//!
//! The metrics of a process are its own and few. The metrics of machines are the same on every node of a
//! cluster and grow with the fleet, so they have a separate address that is scraped on one node.

mod machines;
pub(super) mod queue;
pub(super) mod requests;
pub(super) mod text;

use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use serde::Deserialize;

use super::app::App;
use super::notifications;
use super::problem::Problem;
use super::request::query::{self, Parameters};
use crate::service::{FeedCount, RecordOutcome, Service};
use machines::{alarms, assets};
use queue::QueueWatch;
use text::MetricsText;

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct MetricsParameters {
    /// Names of the indicators shown, comma-separated, for large fleets; all by default, none if empty.
    #[param(example = "rms,kurtosis,novelty")]
    indicators: Option<String>,
}

/// Metrics of this process in Prometheus' text format
#[utoipa::path(
    get,
    path = "/metrics",
    tag = "service",
    responses((status = 200, body = String, content_type = "text/plain")),
)]
pub(super) async fn show(State(app): State<App>) -> Result<impl IntoResponse, Problem> {
    let mut text = MetricsText::default();
    process(&app.service, &mut text).await?;
    app.measurements.write(&mut text);
    app.queue_watch.write(&app.service, &mut text).await;
    Ok(page(text))
}

/// Indicators, wear and alarms of each machine in Prometheus' text format
///
/// The same on every node of a cluster: scrape one of them.
#[utoipa::path(
    get,
    path = "/metrics/machines",
    tag = "service",
    params(MetricsParameters),
    responses((status = 200, body = String, content_type = "text/plain")),
)]
pub(super) async fn machines(
    State(app): State<App>,
    Parameters(params): Parameters<MetricsParameters>,
) -> Result<impl IntoResponse, Problem> {
    let wanted: Option<Vec<&str>> =
        params.indicators.as_deref().map(|names| query::entries(Some(names)).collect());
    let mut text = MetricsText::default();
    assets(&app, wanted.as_deref(), &mut text).await?;
    alarms(&app, &mut text).await?;
    Ok(page(text))
}

/// The metrics of a worker.
pub(super) async fn of_worker(
    service: &Service,
    queue: &QueueWatch,
) -> Result<impl IntoResponse + use<>, Problem> {
    let mut text = MetricsText::default();
    process(service, &mut text).await?;
    queue.write(service, &mut text).await;
    Ok(page(text))
}

fn page(text: MetricsText) -> impl IntoResponse + use<> {
    let content_type = [(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")];
    (content_type, text.into_string())
}

async fn process(service: &Service, text: &mut MetricsText) -> Result<(), Problem> {
    text.head("flankwatch_build_info", "gauge", "The running version.");
    text.line("flankwatch_build_info", &[("version", env!("CARGO_PKG_VERSION"))], 1);
    let segments = service.store.segment_count().await?;
    text.gauge("flankwatch_segments", "Segments in the store.", segments);
    text.head("flankwatch_records_total", "counter", "Records received since the start, by outcome.");
    let outcomes = [
        ("stored", RecordOutcome::Stored),
        ("repeated", RecordOutcome::Repeated),
        ("refused", RecordOutcome::Refused),
        ("queued", RecordOutcome::Queued),
    ];
    for (name, outcome) in outcomes {
        text.line("flankwatch_records_total", &[("outcome", name)], service.record_counts.of(outcome));
    }
    let (used, capacity) = service.workers.queue();
    text.gauge("flankwatch_ingest_queue_used", "Uploads being processed or waiting.", used);
    text.gauge(
        "flankwatch_ingest_queue_limit",
        "Maximum number of uploads; further ones are refused.",
        capacity,
    );
    feeds(service, text);
    notifications::metrics(service, text).await
}

fn feeds(service: &Service, text: &mut MetricsText) {
    let feeds = service.feeds.all();
    if feeds.is_empty() {
        return;
    }
    text.head(
        "flankwatch_feed_messages_total",
        "counter",
        "Messages of a feed since the start: received, and of these accepted, repeated and refused.",
    );
    let outcomes = [
        ("received", FeedCount::Received),
        ("accepted", FeedCount::Accepted),
        ("repeated", FeedCount::Repeated),
        ("refused", FeedCount::Refused),
    ];
    for feed in &feeds {
        for (outcome, count) in outcomes {
            let labels = [("feed", feed.name()), ("outcome", outcome)];
            text.line("flankwatch_feed_messages_total", &labels, feed.counted(count));
        }
    }
    text.head("flankwatch_feed_reconnects_total", "counter", "Reconnections of a feed.");
    for feed in &feeds {
        let count = feed.counted(FeedCount::Reconnected);
        text.line("flankwatch_feed_reconnects_total", &[("feed", feed.name())], count);
    }
    text.head("flankwatch_feed_connected", "gauge", "Whether a feed is connected.");
    for feed in &feeds {
        text.line("flankwatch_feed_connected", &[("feed", feed.name())], u8::from(feed.is_connected()));
    }
    text.head(
        "flankwatch_feed_messages_held",
        "gauge",
        "Messages of a feed that cannot be accepted now and wait unacknowledged.",
    );
    for feed in &feeds {
        text.line("flankwatch_feed_messages_held", &[("feed", feed.name())], feed.held());
    }
}
