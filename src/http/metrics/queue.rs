//! The queue between API nodes and workers in Prometheus' text format.
//!
//! Every process of a cluster shows the same numbers, which come from the queue's server: alerts use the
//! maximum.

use std::time::{Duration, Instant};

use jiff::Timestamp;
use tokio::sync::Mutex;

use super::text::MetricsText;
use crate::service::{QueueOverview, Service};

/// Time for which a result is reused, however often it is requested.
const KNOWN_FOR: Duration = Duration::from_secs(5);

/// Timeout of the queue's server.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(4);

/// The latest overview of the queue.
#[derive(Debug, Default)]
pub(crate) struct QueueWatch(Mutex<Option<(Instant, Option<QueueOverview>)>>);

impl QueueWatch {
    /// Writes the queue's metrics; nothing if there is no queue or it does not answer.
    pub(crate) async fn write(&self, service: &Service, text: &mut MetricsText) {
        let Some(overview) = self.ask(service).await else {
            return;
        };
        // Its times are those of the queue's server, whose clock may differ from this process's.
        let now = service.store.now(service.now()).await.unwrap_or_else(|_| service.now());
        write(&overview, now, text);
    }

    async fn ask(&self, service: &Service) -> Option<QueueOverview> {
        let queue = service.role.queue()?;
        let mut last = self.0.lock().await;
        if let Some((found_at, found)) = last.as_ref()
            && found_at.elapsed() < KNOWN_FOR
        {
            return found.clone();
        }
        let found = match tokio::time::timeout(RESPONSE_TIMEOUT, queue.overview()).await {
            Ok(Ok(found)) => Some(found),
            Ok(Err(error)) => {
                tracing::debug!(%error, "failed to read the queue status");
                None
            }
            Err(_) => None,
        };
        *last = Some((Instant::now(), found.clone()));
        found
    }
}

/// The metrics of a queue, as `/metrics` shows them.
pub fn queue_metrics(overview: &QueueOverview, now: Timestamp) -> String {
    let mut text = MetricsText::default();
    write(overview, now, &mut text);
    text.into_string()
}

fn write(overview: &QueueOverview, now: Timestamp, text: &mut MetricsText) {
    let oldest_age_s = overview.oldest_at.map_or(0.0, |at| now.duration_since(at).as_secs_f64().max(0.0));
    text.gauge(
        "flankwatch_queue_records",
        "Records of the cluster that are waiting or being processed.",
        overview.records,
    );
    text.gauge(
        "flankwatch_queue_records_in_progress",
        "Of these, records that a worker has not acknowledged yet.",
        overview.in_progress,
    );
    text.gauge("flankwatch_queue_oldest_age_seconds", "Age of the oldest of these records.", oldest_age_s);
    text.gauge(
        "flankwatch_queue_leftover_messages",
        "Acknowledged messages that the queue's server still keeps.",
        overview.leftovers,
    );
    text.gauge(
        "flankwatch_dead_letters",
        "Dead letters: records that could not be stored, kept until they are retried or dropped.",
        overview.dead_letters,
    );
    text.gauge(
        "flankwatch_queue_partitions_unowned",
        "Partitions of the queue that no responding worker owns.",
        overview.partitions_unowned,
    );
    text.gauge("flankwatch_workers_alive", "Responding workers.", overview.workers.len());
}
