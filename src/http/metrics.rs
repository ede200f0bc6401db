//! `GET /metrics` in Prometheus' text format.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use axum::extract::State;
use axum::http::{Method, StatusCode, header};
use axum::response::IntoResponse;
use serde::Deserialize;

use super::asset_metrics::{alarms, assets};
use super::problem::Problem;
use super::query::Parameters;
use super::router::App;
use crate::ingest::FeedCount;

/// Upper bounds of the latency histogram in seconds.
const BOUNDS_S: [f64; 12] = [0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0];

/// Methods that are told apart.
const KNOWN_METHODS: [Method; 7] = [
    Method::GET,
    Method::HEAD,
    Method::POST,
    Method::PUT,
    Method::PATCH,
    Method::DELETE,
    Method::OPTIONS,
];

#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct MetricsParameters {
    /// Names of the indicators that are shown, with commas between them, for a fleet of which all would be too many; all where not given, none where
    /// empty.
    #[param(example = "rms,kurtosis,novelty")]
    indicators: Option<String>,
}

/// What the API measures of itself, by method and route.
#[derive(Debug, Default)]
pub(super) struct Measurements {
    by_route: Mutex<BTreeMap<(String, String), RouteMeasurements>>,
}

/// What is measured of one route under one method.
#[derive(Debug, Clone, Default)]
struct RouteMeasurements {
    /// Requests no longer than each bound and longer than the one before; the last counts the longer ones.
    latency: [u64; BOUNDS_S.len() + 1],
    latency_sum_s: f64,
    /// Answers by the first digit of their status.
    answers: BTreeMap<u16, u64>,
}

impl Measurements {
    /// Counts a request and how long it took.
    pub(super) fn request(&self, method: &Method, route: Option<&str>, took: Duration, status: StatusCode) {
        let took_s = took.as_secs_f64();
        // A client may name any method and any path; each of those would be a series of its own for ever.
        let method = if KNOWN_METHODS.contains(method) { method.as_str() } else { "other" };
        let route = route.unwrap_or("unmatched");
        let mut by_route = self.by_route.lock().unwrap_or_else(PoisonError::into_inner);
        let measured = by_route.entry((method.to_owned(), route.to_owned())).or_default();
        measured.latency[BOUNDS_S.partition_point(|bound| *bound < took_s)] += 1;
        measured.latency_sum_s += took_s;
        *measured.answers.entry(status.as_u16() / 100).or_default() += 1;
    }

    fn snapshot(&self) -> BTreeMap<(String, String), RouteMeasurements> {
        self.by_route.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// The page's lines.
pub(super) struct Text(String);

impl Text {
    pub(super) fn head(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    pub(super) fn line(&mut self, name: &str, labels: &[(&str, &str)], value: impl std::fmt::Display) {
        let labels: Vec<String> = labels
            .iter()
            .map(|(name, value)| {
                let value = value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
                format!("{name}=\"{value}\"")
            })
            .collect();
        let labels = if labels.is_empty() {
            String::new()
        } else {
            format!("{{{}}}", labels.join(","))
        };
        let _ = writeln!(self.0, "{name}{labels} {value}");
    }

    fn single(&mut self, name: &str, kind: &str, help: &str, value: impl std::fmt::Display) {
        self.head(name, kind, help);
        self.line(name, &[], value);
    }
}

/// Measurements in Prometheus' text format
#[utoipa::path(
    get,
    path = "/metrics",
    tag = "service",
    params(MetricsParameters),
    responses((status = 200, body = String, content_type = "text/plain")),
)]
pub(super) async fn show(State(app): State<App>, Parameters(asked): Parameters<MetricsParameters>) -> Result<impl IntoResponse, Problem> {
    let wanted: Option<Vec<&str>> = asked.indicators.as_deref().map(|names| names.split(',').map(str::trim).collect());
    let mut text = Text(String::new());
    service(&app, &mut text).await?;
    assets(&app, wanted.as_deref(), &mut text).await?;
    alarms(&app, &mut text).await?;
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text.0))
}

async fn service(app: &App, text: &mut Text) -> Result<(), Problem> {
    text.head("flankwatch_build_info", "gauge", "The running version.");
    text.line("flankwatch_build_info", &[("version", env!("CARGO_PKG_VERSION"))], 1);
    let segments = app.ingest.store().segment_count().await?;
    text.single("flankwatch_segments", "gauge", "Segments in the store.", segments);
    let tally = app.ingest.tally();
    text.head(
        "flankwatch_records_total",
        "counter",
        "Records received since the start, by what became of them.",
    );
    let outcomes = [
        ("stored", tally.stored()),
        ("repeated", tally.repeated()),
        ("refused", tally.refused()),
        ("queued", tally.queued()),
    ];
    for (outcome, count) in outcomes {
        text.line("flankwatch_records_total", &[("outcome", outcome)], count);
    }
    let (used, most) = app.ingest.workers().queue();
    text.single("flankwatch_ingest_queue_used", "gauge", "Uploads being processed or waiting.", used);
    text.single(
        "flankwatch_ingest_queue_limit",
        "gauge",
        "Uploads beyond which further ones are refused.",
        most,
    );
    feeds(app, text);
    requests(&app.measurements.snapshot(), text);
    Ok(())
}

fn requests(by_route: &BTreeMap<(String, String), RouteMeasurements>, text: &mut Text) {
    text.head(
        "flankwatch_requests_total",
        "counter",
        "Requests answered, by the class of the answer's status.",
    );
    for ((method, route), measured) in by_route {
        for (class, count) in &measured.answers {
            let class = format!("{class}xx");
            text.line(
                "flankwatch_requests_total",
                &[("method", method), ("route", route), ("status", &class)],
                count,
            );
        }
    }
    let name = "flankwatch_request_duration_seconds";
    text.head(name, "histogram", "Time from the head of a request to the head of its answer.");
    for ((method, route), measured) in by_route {
        let labels = [("method", method.as_str()), ("route", route.as_str())];
        let mut count = 0;
        let bounds = BOUNDS_S.iter().map(f64::to_string).chain(["+Inf".to_string()]);
        for (bound, bucket) in bounds.zip(&measured.latency) {
            count += bucket;
            text.line(&format!("{name}_bucket"), &[labels[0], labels[1], ("le", &bound)], count);
        }
        text.line(&format!("{name}_sum"), &labels, measured.latency_sum_s);
        text.line(&format!("{name}_count"), &labels, count);
    }
}

fn feeds(app: &App, text: &mut Text) {
    let feeds = app.ingest.feeds();
    if feeds.is_empty() {
        return;
    }
    text.head(
        "flankwatch_feed_messages_total",
        "counter",
        "Messages of a feed since the start: received, and of these accepted, repeated (sent again) and refused.",
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
    text.head(
        "flankwatch_feed_reconnects_total",
        "counter",
        "Connections of a feed after its first.",
    );
    for feed in &feeds {
        let count = feed.counted(FeedCount::Reconnected);
        text.line("flankwatch_feed_reconnects_total", &[("feed", feed.name())], count);
    }
    text.head("flankwatch_feed_connected", "gauge", "Whether a feed's connection stands.");
    for feed in &feeds {
        text.line("flankwatch_feed_connected", &[("feed", feed.name())], u8::from(feed.is_connected()));
    }
    text.head(
        "flankwatch_feed_messages_held",
        "gauge",
        "Messages of a feed that cannot be taken now and wait, unacknowledged.",
    );
    for feed in &feeds {
        text.line("flankwatch_feed_messages_held", &[("feed", feed.name())], feed.held());
    }
}
