//! A worker: analyses and stores the records of its partitions, and acknowledges them after the commit.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use async_nats::jetstream::{AckKind, Message};
use futures_util::StreamExt;
use tokio::sync::{Semaphore, mpsc, oneshot, watch};

use super::attempts::Attempts;
use super::connection::Connection;
use super::dead_letters;
use super::intake::Intake;
use super::ownership::Ownership;
use super::{ClusterError, WorkerLimits, message, overview};
use crate::asset::AssetId;
use crate::service::{
    Accepted, FailureCause, QueuedRecord, RecordOutcome, Service, ServiceError, WorkerOverview,
};

/// First and longest wait between two attempts to store a record.
const FIRST_WAIT: Duration = Duration::from_millis(200);
const MAX_WAIT: Duration = Duration::from_secs(5);

/// Delay before a record that could not be handled is redelivered.
const REDELIVERY_DELAY: Duration = Duration::from_secs(10);

/// Delay before a record of a stopping worker is redelivered: long enough that it does not go to the same
/// worker, whose last request for a record may still be open.
const DELAY_AFTER_STOP: Duration = Duration::from_secs(1);

/// Maximum attempts for a record that may itself be the cause of the failure.
const MAX_UNCERTAIN_ATTEMPTS: u32 = 5;

/// A worker. Clones share its state.
#[derive(Clone)]
pub(super) struct Worker {
    /// Its unique name.
    name: String,
    pub(super) connection: Connection,
    service: Arc<Service>,
    limits: WorkerLimits,
    stop: watch::Receiver<bool>,
    /// Number of records in progress.
    in_progress: Arc<AtomicU64>,
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
        let name = overview::worker_name();
        Self { name, connection, service, limits, stop, in_progress: Arc::default() }
    }

    /// Processes records until it is stopped, then finishes those in progress.
    pub(super) async fn run(self) {
        while let Err(error) = self.service.resume().await {
            tracing::warn!(%error, "failed to resume; retrying");
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
        let changes = tokio::spawn(self.clone().watch_changes());
        let (owns, owned) = watch::channel(BTreeSet::new());
        let responder = tokio::spawn(self.respond(owned.clone()));
        let ownership = Ownership {
            connection: self.connection.clone(),
            service: Arc::clone(&self.service),
            worker: self.name.clone(),
            owned: owns,
        };
        let ownership = tokio::spawn(ownership.run(self.stop.clone()));
        let (busy, mut is_idle) = mpsc::channel(1);
        let slots = Arc::new(Semaphore::new(self.limits.at_once));
        let intake = Intake { worker: self.clone(), owned, slots, busy };
        let mut stop = self.stop.clone();
        while !*stop.borrow() {
            let result = tokio::select! {
                _ = stop.wait_for(|stop| *stop) => break,
                result = intake.run() => result,
            };
            if let Err(error) = result {
                tracing::warn!(%error, "failed to take records from the queue; retrying");
                tokio::select! {
                    _ = stop.wait_for(|stop| *stop) => break,
                    () = tokio::time::sleep(Duration::from_secs(1)) => {}
                }
            }
        }
        drop(intake);
        // Others take over while the records in progress are finished.
        if let Err(error) = ownership.await {
            tracing::error!(%error, "the ownership task failed");
        }
        // Each record in progress holds a sender.
        let _ = is_idle.recv().await;
        changes.abort();
        responder.abort();
    }

    /// Responds to status queries.
    fn respond(&self, owned: watch::Receiver<BTreeSet<u16>>) -> impl Future<Output = ()> + use<> {
        let (service, in_progress, at_once) =
            (Arc::clone(&self.service), Arc::clone(&self.in_progress), self.limits.at_once);
        let name = self.name.clone();
        overview::respond(self.connection.clone(), move || WorkerOverview {
            name: name.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            in_progress: in_progress.load(Ordering::Relaxed),
            at_once: at_once as u64,
            stored: service.record_counts.of(RecordOutcome::Stored),
            partitions: owned.borrow().iter().copied().collect(),
            states_read: service.history.states_read(),
        })
    }

    /// Waits for a slot, then processes a record while holding it; signals when that begins. A record that
    /// waits when the worker stops returns to the queue.
    pub(super) async fn process_in_slot(
        self,
        message: Message,
        slots: Arc<Semaphore>,
        started: oneshot::Sender<()>,
    ) {
        let mut stop = self.stop.clone();
        let slot = tokio::select! {
            slot = slots.acquire_owned() => slot.ok(),
            _ = stop.wait_for(|stop| *stop) => None,
            () = keep_alive(&message, self.connection.settings().ack_wait / 3) => None,
        };
        let Some(_slot) = slot else {
            // The first delivery counts unless it is excused.
            if deliveries(&message) == 1 {
                self.excuse(&message, "the worker stopped before it began").await;
            }
            if let Err(error) = message.double_ack_with(AckKind::Nak(Some(DELAY_AFTER_STOP))).await {
                tracing::debug!(%error, "failed to return a record to the queue");
            }
            return;
        };
        let _ = started.send(());
        let in_progress = Arc::clone(&self.in_progress);
        in_progress.fetch_add(1, Ordering::Relaxed);
        self.handle(message).await;
        in_progress.fetch_sub(1, Ordering::Relaxed);
    }

    /// Stores the record of a message and acknowledges the message.
    async fn handle(self, message: Message) {
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
                    tracing::warn!(%error, reason, "failed to move a record to the dead letters; retrying later");
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
            self.service.store.count_dead_letter(&record.metadata.id, letter, self.service.now()).await?;
        }
        dead_letters::put(&self.connection, message, reason).await
    }

    /// Stores the record of a message; retries for as long as the cause of the failure is external. Sets
    /// `has_attempts` where it stored an error.
    async fn store(&self, message: &Message, has_attempts: &mut bool) -> Outcome {
        let queued = match message::decode(&message.payload) {
            Ok(queued) => queued,
            Err(error) => return Outcome::DeadLetter(error.to_string()),
        };
        let record = &queued.metadata;
        match self.crashed_too_often(message).await {
            Ok(None) => {}
            Ok(Some(reason)) => {
                return Outcome::DeadLetter(format!(
                    "segment {} of {}: {reason}",
                    record.id, record.asset_id
                ));
            }
            Err(error) => {
                tracing::warn!(%error, "failed to count the deliveries of a record; returning it to the queue");
                return Outcome::Redeliver(REDELIVERY_DELAY);
            }
        }
        let (mut wait, mut uncertain, mut is_excused) = (FIRST_WAIT, 0, false);
        let mut stop = self.stop.clone();
        loop {
            let error = match self.store_once(&queued).await {
                Ok(Some(_)) => return Outcome::Done,
                Ok(None) => {
                    tracing::info!(segment = %record.id, asset = %record.asset_id, "dropped a record whose asset was removed");
                    return Outcome::Done;
                }
                Err(error) => error,
            };
            let reason = format!("segment {} of {}: {error}", record.id, record.asset_id);
            match error.cause() {
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
                tracing::warn!(segment = %record.id, %error, "failed to store a record; retrying");
            }
            tokio::select! {
                _ = stop.wait_for(|stop| *stop) => return Outcome::Redeliver(DELAY_AFTER_STOP),
                () = tokio::time::sleep(wait) => {}
            }
            wait = (2 * wait).min(MAX_WAIT);
        }
    }

    /// Counts a delivery that begins; returns the reason if too many earlier ones ended without a worker that
    /// survived them.
    async fn crashed_too_often(&self, message: &Message) -> Result<Option<String>, ClusterError> {
        if deliveries(message) == 1 {
            return Ok(None);
        }
        let attempts = Attempts::begin(&self.connection, message).await?;
        let crashes = attempts.crashes();
        if crashes < i64::from(self.limits.max_deliveries) {
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
        ticket.grow(usize::try_from(record.metadata.raw.bytes).unwrap_or(usize::MAX))?;
        self.service.pipeline.process(record, ticket).await
    }

    /// Refreshes assets when they change. Missed notifications are made up for by the periodic upkeep.
    async fn watch_changes(self) {
        loop {
            match self.connection.client.subscribe(self.connection.changes_subject()).await {
                Err(error) => tracing::warn!(%error, "failed to subscribe to changes; retrying"),
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
