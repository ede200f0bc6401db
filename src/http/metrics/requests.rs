//! Request metrics of the API.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use axum::http::{Method, StatusCode};

use super::text::MetricsText;

/// Upper bounds of the latency histogram in seconds.
const BOUNDS_S: [f64; 12] = [0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0];

/// Methods with their own series.
const KNOWN_METHODS: [Method; 7] =
    [Method::GET, Method::HEAD, Method::POST, Method::PUT, Method::PATCH, Method::DELETE, Method::OPTIONS];

/// Request metrics by method and route.
#[derive(Debug, Default)]
pub(crate) struct Measurements {
    by_route: Mutex<BTreeMap<(String, String), RouteMeasurements>>,
}

/// Metrics of one route and method.
#[derive(Debug, Clone, Default)]
struct RouteMeasurements {
    /// Number of requests per latency bucket, not cumulative; the last one counts requests beyond all bounds.
    latency: [u64; BOUNDS_S.len() + 1],
    latency_sum_s: f64,
    /// Responses by the first digit of the status.
    responses: BTreeMap<u16, u64>,
}

impl Measurements {
    /// Counts a request and its duration.
    pub(crate) fn request(&self, method: &Method, route: Option<&str>, took: Duration, status: StatusCode) {
        let took_s = took.as_secs_f64();
        // Unknown methods and paths share a series: clients could otherwise create any number of them.
        let method = if KNOWN_METHODS.contains(method) { method.as_str() } else { "other" };
        let route = route.unwrap_or("unmatched");
        let mut by_route = self.by_route.lock().unwrap_or_else(PoisonError::into_inner);
        let measured = by_route.entry((method.to_owned(), route.to_owned())).or_default();
        measured.latency[BOUNDS_S.partition_point(|bound| *bound < took_s)] += 1;
        measured.latency_sum_s += took_s;
        *measured.responses.entry(status.as_u16() / 100).or_default() += 1;
    }

    /// Writes the metrics.
    pub(crate) fn write(&self, text: &mut MetricsText) {
        let by_route = &self.by_route.lock().unwrap_or_else(PoisonError::into_inner).clone();
        text.head("flankwatch_requests_total", "counter", "Requests answered, by status class.");
        for ((method, route), measured) in by_route {
            for (class, count) in &measured.responses {
                let class = format!("{class}xx");
                text.line(
                    "flankwatch_requests_total",
                    &[("method", method), ("route", route), ("status", &class)],
                    count,
                );
            }
        }
        let name = "flankwatch_request_duration_seconds";
        text.head(name, "histogram", "Time from the request head to the response head.");
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
}
