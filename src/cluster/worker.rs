//! A worker: takes records from the queue, analyses and stores them, and acknowledges them after the commit.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use async_nats::jetstream::consumer::{AckPolicy, PullConsumer, pull};
use async_nats::jetstream::{AckKind, Message};
use futures_util::StreamExt;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use super::attempts::Attempts;
use super::connection::{CONSUMER, Connection};
use super::dead_letters;
use super::failure_cause::FailureCause;
use super::{ClusterError, WorkerLimits, message, overview};
use crate::asset::AssetId;
use crate::service::{Accepted, QueuedRecord, Service, ServiceError, WorkerOverview};

/// Time that one request for records waits for records.
const PULL_EXPIRY: Duration = Duration::from_secs(2);

/// First and longest wait between two attempts to store a record.
const FIRST_WAIT: Duration = Duration::from_millis(200);
const MAX_WAIT: Duration = Duration::from_secs(5);

/// Delay before a record that could not be handled is redelivered.
const REDELIVERY_DELAY: Duration = Duration::from_secs(10);

/// Delay before a record of a stopping worker is redelivered: long enough that it does not go to the same
/// worker, whose last request for records may still be open.
const DELAY_AFTER_STOP: Duration = Duration::from_secs(1);

/// Maximum attempts for a record that may itself be the cause of the failure.
const MAX_UNCERTAIN_ATTEMPTS: u32 = 5;

/// A worker. Clones share its state.
#[derive(Clone)]
pub(super) struct Worker {
    connection: Connection,
    service: Arc<Service>,
    limits: WorkerLimits,
    stop: watch::Receiver<bool>,
    /// Number of records in work.
    in_work: Arc<AtomicU64>,
}

/// Outcome of a delivery.
#[derive(Debug)]
enum Outcome {
    /// The record is stored, or its asset was removed.
    Done,
    /// The record can never be stored, for this reason.
    DeadLetter(String),
    /// The record could not be stored now: it is redelivered after this delay.
    Redeliver(Duration),
}

impl Worker {
    pub(super) fn new(
        connection: Connection,
        service: Arc<Service>,
        mut limits: WorkerLimits,
        stop: watch::Receiver<bool>,
    ) -> Self {
        // The service would reject more than that, and the worker would hold them.
        limits.at_once = limits.at_once.min(service.workers.queue().1).max(1);
        Self { connection, service, limits, stop, in_work: Arc::default() }
    }

    /// Processes records until it is stopped, then finishes those in work.
    pub(super) async fn run(self) {
        while let Err(error) = self.service.resume().await {
            tracing::warn!(%error, "failed to resume, retrying");
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
        let changes = tokio::spawn(self.clone().follow_changes());
        let slots = Arc::new(Semaphore::new(self.limits.at_once));
        let responder = tokio::spawn(self.respond());
        let mut stop = self.stop.clone();
        while !*stop.borrow() {
            let result = tokio::select! {
                _ = stop.wait_for(|stop| *stop) => break,
                result = self.consume(&slots) => result,
            };
            if let Err(error) = result {
                tracing::warn!(%error, "failed to take records from the queue, retrying");
                tokio::select! {
                    _ = stop.wait_for(|stop| *stop) => break,
                    () = tokio::time::sleep(Duration::from_secs(1)) => {}
                }
            }
        }
        // All slots are free once no record is in work.
        let all = u32::try_from(self.limits.at_once).unwrap_or(u32::MAX);
        let _ = slots.acquire_many(all).await;
        changes.abort();
        responder.abort();
    }

    /// Responds to status queries.
    fn respond(&self) -> impl Future<Output = ()> + use<> {
        let (service, in_work, at_once) =
            (Arc::clone(&self.service), Arc::clone(&self.in_work), self.limits.at_once);
        let name = overview::worker_name();
        overview::respond(self.connection.clone(), move || WorkerOverview {
            name: name.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            in_work: in_work.load(Ordering::Relaxed),
            at_once: at_once as u64,
            stored: service.tally.stored(),
        })
    }

    /// Takes records from the queue until a request fails; each one is processed in a task of its own.
    async fn consume(&self, slots: &Arc<Semaphore>) -> Result<(), ClusterError> {
        let failed = ClusterError::jetstream;
        self.connection.prepare().await?;
        let stream = self.connection.jetstream.get_stream(self.connection.work_stream()).await;
        let stream = stream.map_err(|error| failed("find the queue")(error.into()))?;
        let config = pull::Config {
            durable_name: Some(CONSUMER.to_owned()),
            ack_policy: AckPolicy::Explicit,
            ack_wait: self.connection.settings().ack_wait,
            // Unlimited: the worker counts deliveries and moves the record to the dead letters.
            max_deliver: -1,
            max_ack_pending: -1,
            ..pull::Config::default()
        };
        let consumer: PullConsumer = match stream.create_consumer(config).await {
            Ok(consumer) => consumer,
            Err(error) => return Err(failed("create the consumer")(error.into())),
        };
        loop {
            let first = Arc::clone(slots).acquire_owned().await;
            let Ok(first) = first else { return Ok(()) };
            let mut free = vec![first];
            while let Ok(more) = Arc::clone(slots).try_acquire_owned() {
                free.push(more);
            }
            let batch = consumer.batch().max_messages(free.len()).expires(PULL_EXPIRY).messages().await;
            let mut messages = batch.map_err(|error| failed("request records")(error.into()))?;
            while let Some(message) = messages.next().await {
                let message = message.map_err(failed("take a record"))?;
                let Some(slot) = free.pop() else {
                    // More than requested: it is redelivered.
                    continue;
                };
                let worker = self.clone();
                tokio::spawn(async move {
                    let in_work = Arc::clone(&worker.in_work);
                    in_work.fetch_add(1, Ordering::Relaxed);
                    worker.handle(message, slot).await;
                    in_work.fetch_sub(1, Ordering::Relaxed);
                });
            }
        }
    }

    /// Stores the record of a message and acknowledges the message; holds the slot meanwhile.
    async fn handle(self, message: Message, slot: OwnedSemaphorePermit) {
        let _slot = slot;
        // There are no attempts to remove for a record that is delivered for the first time and has no error.
        let mut has_attempts = deliveries(&message) > 1;
        let outcome = tokio::select! {
            outcome = self.store(&message, &mut has_attempts) => outcome,
            () = keep_alive(&message, self.connection.settings().ack_wait / 3) => return,
        };
        let kind = match outcome {
            Outcome::Done => AckKind::Ack,
            Outcome::DeadLetter(reason) => match self.put_dead_letter(&message, &reason).await {
                Ok(()) => AckKind::Ack,
                Err(error) => {
                    tracing::warn!(%error, reason, "failed to move a record to the dead letters, retrying later");
                    self.excuse(&message, &reason).await;
                    AckKind::Nak(Some(REDELIVERY_DELAY))
                }
            },
            Outcome::Redeliver(delay) => AckKind::Nak(Some(delay)),
        };
        let is_done = matches!(kind, AckKind::Ack);
        // If the acknowledgement is lost, the record is redelivered and found to be stored already.
        if let Err(error) = message.double_ack_with(kind).await {
            tracing::debug!(%error, "failed to confirm an acknowledgement");
        } else if is_done && has_attempts {
            Attempts::remove(&self.connection, &message).await;
        }
    }

    /// Excuses this delivery, so that it does not count against the record. On failure it counts as one that
    /// no worker survived.
    async fn excuse(&self, message: &Message, error: &str) {
        if let Err(error) = Attempts::excuse(&self.connection, message, error).await {
            tracing::warn!(%error, "failed to store the error of a record");
        }
    }

    /// Moves a message to the dead letters and counts it in the store, so that the same record sent again is
    /// not rejected as a duplicate.
    async fn put_dead_letter(&self, message: &Message, reason: &str) -> Result<(), ClusterError> {
        // Counted first: once the dead letter is visible, its record may be sent again at once.
        if let (Ok(record), Ok(info)) = (message::decode(&message.payload), message.info()) {
            let letter = i64::try_from(info.stream_sequence).unwrap_or(i64::MAX);
            self.service.store.count_dead_letter(&record.id, letter, self.service.now()).await?;
        }
        dead_letters::put(&self.connection, message, reason).await
    }

    /// Stores the record of a message; retries for as long as the cause of the failure is external. Sets
    /// `has_attempts` where it stored an error.
    async fn store(&self, message: &Message, has_attempts: &mut bool) -> Outcome {
        let record = match message::decode(&message.payload) {
            Ok(record) => record,
            Err(error) => return Outcome::DeadLetter(error.to_string()),
        };
        match self.crashed_too_often(message).await {
            Ok(None) => {}
            Ok(Some(reason)) => {
                return Outcome::DeadLetter(format!(
                    "segment {} of {}: {reason}",
                    record.id, record.asset_id
                ));
            }
            Err(error) => {
                tracing::warn!(%error, "failed to count the deliveries of a record, returning it to the queue");
                return Outcome::Redeliver(REDELIVERY_DELAY);
            }
        }
        let (mut wait, mut uncertain, mut is_excused) = (FIRST_WAIT, 0, false);
        let mut stop = self.stop.clone();
        loop {
            let error = match self.store_once(&record).await {
                Ok(Some(_)) => return Outcome::Done,
                Ok(None) => {
                    tracing::info!(segment = %record.id, asset = %record.asset_id, "dropped a record whose asset was removed");
                    return Outcome::Done;
                }
                Err(error) => error,
            };
            let reason = format!("segment {} of {}: {error}", record.id, record.asset_id);
            match FailureCause::from(&error) {
                FailureCause::Record => return Outcome::DeadLetter(reason),
                FailureCause::Uncertain => {
                    uncertain += 1;
                    if uncertain == MAX_UNCERTAIN_ATTEMPTS {
                        return Outcome::DeadLetter(format!("{reason} (tried {uncertain} times)"));
                    }
                }
                FailureCause::External => {}
            }
            if !is_excused {
                (is_excused, *has_attempts) = (true, true);
                // Before the log line, after which somebody may kill this worker.
                self.excuse(message, &reason).await;
                tracing::warn!(segment = %record.id, %error, "failed to store a record, retrying");
            }
            tokio::select! {
                _ = stop.wait_for(|stop| *stop) => return Outcome::Redeliver(DELAY_AFTER_STOP),
                () = tokio::time::sleep(wait) => {}
            }
            wait = (2 * wait).min(MAX_WAIT);
        }
    }

    /// Returns the reason if too many deliveries of a record ended without a worker that survived them.
    async fn crashed_too_often(&self, message: &Message) -> Result<Option<String>, ClusterError> {
        let (before, max) = (deliveries(message) - 1, i64::from(self.limits.max_deliveries));
        if before < max {
            return Ok(None);
        }
        let attempts = Attempts::of(&self.connection, message).await?;
        let crashes = before - attempts.excused;
        if crashes < max {
            return Ok(None);
        }
        let last = if attempts.last_error.is_empty() {
            String::new()
        } else {
            format!("; last error: {}", attempts.last_error)
        };
        Ok(Some(format!("delivered {crashes} times and never finished: it may crash its workers{last}")))
    }

    async fn store_once(&self, record: &QueuedRecord) -> Result<Option<Accepted>, ServiceError> {
        let mut ticket = self.service.workers.admit()?;
        ticket.grow(usize::try_from(record.raw.bytes).unwrap_or(usize::MAX))?;
        self.service.pipeline.process(record, ticket).await
    }

    /// Refreshes assets when they change. Missed notifications are made up for by the periodic upkeep.
    async fn follow_changes(self) {
        loop {
            match self.connection.client.subscribe(self.connection.changes_subject()).await {
                Err(error) => tracing::warn!(%error, "failed to subscribe to changes, retrying"),
                Ok(mut changes) => {
                    while let Some(change) = changes.next().await {
                        let name = String::from_utf8_lossy(&change.payload).into_owned();
                        let Ok(asset) = AssetId::new(name) else { continue };
                        if let Err(error) = self.service.assets.refresh(&asset).await {
                            tracing::warn!(%asset, %error, "failed to refresh an asset");
                        }
                    }
                }
            }
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }
}

/// Returns the number of deliveries of a message, including this one.
fn deliveries(message: &Message) -> i64 {
    message.info().map_or(1, |info| info.delivered)
}

/// Reports progress of a message at an interval, so that it is not redelivered; never returns.
async fn keep_alive(message: &Message, interval: Duration) {
    loop {
        tokio::time::sleep(interval).await;
        if let Err(error) = message.ack_with(AckKind::Progress).await {
            tracing::debug!(%error, "failed to report progress of a record");
        }
    }
}
