//! A worker: takes records from the queue, has them analysed and stored, and only then acknowledges them.

use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::consumer::{AckPolicy, PullConsumer, pull};
use async_nats::jetstream::{AckKind, Message};
use futures_util::StreamExt;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use super::connection::Connection;
use super::dead_letters;
use super::{ClusterError, message};
use crate::asset::AssetId;
use crate::service::{Accepted, QueuedRecord, Service, ServiceError};

/// The consumer that all workers share.
const CONSUMER: &str = "workers";

/// How long one question for records waits for some.
const ASKED_FOR: Duration = Duration::from_secs(2);

/// Waits between two tries of a record that something away holds up.
const FIRST_WAIT: Duration = Duration::from_millis(200);
const LONGEST_WAIT: Duration = Duration::from_secs(5);

/// When a record that may be at fault itself is tried again.
const TRIED_AGAIN: Duration = Duration::from_secs(10);

/// What one worker does.
#[derive(Debug, Clone)]
pub struct WorkerLimits {
    /// Records worked on at once.
    pub at_once: usize,
    /// A record that was given out so often without being finished goes to the dead letters.
    pub max_deliveries: u32,
}

impl Default for WorkerLimits {
    fn default() -> Self {
        Self {
            at_once: 8 * std::thread::available_parallelism().map_or(2, usize::from),
            max_deliveries: 10,
        }
    }
}

/// A worker's parts; a clone is another handle to the same ones.
#[derive(Clone)]
pub(super) struct Worker {
    connection: Connection,
    service: Arc<Service>,
    limits: WorkerLimits,
    stop: watch::Receiver<bool>,
}

/// How a record that could not be stored is to be treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// Something else is away: it is held until that is back.
    Elsewhere,
    /// Perhaps the record's own: it is given out again, but not for ever.
    Doubtful,
    /// The record's own: it never will be.
    Own,
}

impl Worker {
    pub(super) fn new(connection: Connection, service: Arc<Service>, mut limits: WorkerLimits, stop: watch::Receiver<bool>) -> Self {
        // More than that would be refused, and held.
        limits.at_once = limits.at_once.min(service.workers.queue().1).max(1);
        Self {
            connection,
            service,
            limits,
            stop,
        }
    }

    /// Works until it is told to stop, and then ends what it has begun.
    pub(super) async fn run(self) {
        while let Err(error) = self.service.resume().await {
            tracing::warn!(%error, "failed to resume: trying again");
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
        let changes = tokio::spawn(self.clone().follow_changes());
        let turns = Arc::new(Semaphore::new(self.limits.at_once));
        let mut stop = self.stop.clone();
        while !*stop.borrow() {
            let worked = tokio::select! {
                _ = stop.wait_for(|stop| *stop) => break,
                worked = self.work(&turns) => worked,
            };
            if let Err(error) = worked {
                tracing::warn!(%error, "failed to take records from the queue: trying again");
                tokio::select! {
                    _ = stop.wait_for(|stop| *stop) => break,
                    () = tokio::time::sleep(Duration::from_secs(1)) => {}
                }
            }
        }
        // All turns are back when everything that was begun is done.
        let all = u32::try_from(self.limits.at_once).unwrap_or(u32::MAX);
        let _ = turns.acquire_many(all).await;
        changes.abort();
    }

    /// Takes records until something fails.
    async fn work(&self, turns: &Arc<Semaphore>) -> Result<(), ClusterError> {
        let failed = ClusterError::jetstream;
        self.connection.prepare().await?;
        let stream = self.connection.jetstream.get_stream(self.connection.work_stream()).await;
        let stream = stream.map_err(|error| failed("find the queue")(error.into()))?;
        let config = pull::Config {
            durable_name: Some(CONSUMER.to_owned()),
            ack_policy: AckPolicy::Explicit,
            ack_wait: self.connection.settings().ack_wait,
            // How often is too often is judged by the worker, which keeps the record.
            max_deliver: -1,
            max_ack_pending: -1,
            ..pull::Config::default()
        };
        let consumer: PullConsumer = match stream.create_consumer(config).await {
            Ok(consumer) => consumer,
            Err(error) => return Err(failed("make the consumer")(error.into())),
        };
        loop {
            let first = Arc::clone(turns).acquire_owned().await;
            let Ok(first) = first else { return Ok(()) };
            let mut free = vec![first];
            while let Ok(more) = Arc::clone(turns).try_acquire_owned() {
                free.push(more);
            }
            let asked = consumer.batch().max_messages(free.len()).expires(ASKED_FOR).messages().await;
            let mut messages = asked.map_err(|error| failed("ask for records")(error.into()))?;
            while let Some(message) = messages.next().await {
                let message = message.map_err(failed("take a record"))?;
                let Some(turn) = free.pop() else {
                    // More than were asked for; it comes again.
                    continue;
                };
                tokio::spawn(self.clone().treat(message, turn));
            }
        }
    }

    async fn treat(self, message: Message, turn: OwnedSemaphorePermit) {
        let _turn = turn;
        let treated = tokio::select! {
            treated = self.store(&message) => treated,
            () = keep_alive(&message, self.connection.settings().ack_wait / 3) => return,
        };
        let kind = match treated {
            Ok(()) => AckKind::Ack,
            Err((Fault::Own, reason)) => match self.give_up(&message, &reason).await {
                Ok(()) => AckKind::Ack,
                Err(error) => {
                    tracing::warn!(%error, reason, "failed to put a record among the dead letters: trying again later");
                    AckKind::Nak(Some(TRIED_AGAIN))
                }
            },
            Err((Fault::Doubtful, reason)) => {
                tracing::warn!(reason, "failed to store a record: giving it back to the queue");
                AckKind::Nak(Some(TRIED_AGAIN))
            }
            Err((Fault::Elsewhere, _)) => AckKind::Nak(None),
        };
        // Where the acknowledgement is lost the record comes again, and is found stored.
        if let Err(error) = message.double_ack_with(kind).await {
            tracing::debug!(%error, "failed to confirm an acknowledgement");
        }
    }

    /// Puts a message among the dead letters, so that its record, sent again, is not taken for the one that
    /// lies there.
    async fn give_up(&self, message: &Message, reason: &str) -> Result<(), ClusterError> {
        // Before it lies there: who sees it there may send its record again at once.
        if let (Ok(record), Ok(info)) = (message::decode(&message.payload), message.info()) {
            let letter = i64::try_from(info.stream_sequence).unwrap_or(i64::MAX);
            self.service.store.count_dead_letter(&record.id, letter, self.service.now()).await?;
        }
        dead_letters::put(&self.connection, message, reason).await
    }

    /// Has the record of a message stored; holds it as long as something else is away.
    async fn store(&self, message: &Message) -> Result<(), (Fault, String)> {
        let record = message::decode(&message.payload).map_err(|error| (Fault::Own, error.to_string()))?;
        let delivered = message.info().map_or(1, |info| info.delivered);
        if delivered > i64::from(self.limits.max_deliveries) {
            let reason = format!(
                "given out {} times and never finished: it may be what ends its workers",
                delivered - 1
            );
            return Err((Fault::Own, reason));
        }
        let mut wait = FIRST_WAIT;
        let mut stop = self.stop.clone();
        loop {
            let error = match self.store_once(&record).await {
                Ok(Some(_)) => return Ok(()),
                Ok(None) => {
                    tracing::info!(segment = %record.id, asset = %record.asset_id, "dropped a record whose asset was removed");
                    return Ok(());
                }
                Err(error) => error,
            };
            let fault = fault_of(&error);
            if fault != Fault::Elsewhere {
                return Err((fault, format!("segment {} of {}: {error}", record.id, record.asset_id)));
            }
            if wait == FIRST_WAIT {
                tracing::warn!(segment = %record.id, %error, "failed to store a record: holding it");
            }
            tokio::select! {
                _ = stop.wait_for(|stop| *stop) => return Err((fault, error.to_string())),
                () = tokio::time::sleep(wait) => {}
            }
            wait = (2 * wait).min(LONGEST_WAIT);
        }
    }

    async fn store_once(&self, record: &QueuedRecord) -> Result<Option<Accepted>, ServiceError> {
        let mut ticket = self.service.workers.admit()?;
        ticket.grow(usize::try_from(record.raw.bytes).unwrap_or(usize::MAX))?;
        self.service.pipeline.process(record, ticket).await
    }

    /// Looks at assets that somebody changed. What is not heard here is found by looking at what is left to
    /// be done from time to time.
    async fn follow_changes(self) {
        loop {
            match self.connection.client.subscribe(self.connection.changes_subject()).await {
                Err(error) => tracing::warn!(%error, "failed to subscribe to changes: trying again"),
                Ok(mut heard) => {
                    while let Some(changed) = heard.next().await {
                        let name = String::from_utf8_lossy(&changed.payload).into_owned();
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

/// Says again and again that a message is worked on; never returns.
async fn keep_alive(message: &Message, every: Duration) {
    loop {
        tokio::time::sleep(every).await;
        if let Err(error) = message.ack_with(AckKind::Progress).await {
            tracing::debug!(%error, "failed to extend the time of a record");
        }
    }
}

fn fault_of(error: &ServiceError) -> Fault {
    match error {
        ServiceError::Busy { .. } | ServiceError::DescriptionChanged(_) => Fault::Elsewhere,
        ServiceError::Store(error) if error.is_unavailable() || error.is_conflict() => Fault::Elsewhere,
        ServiceError::Recording(_) | ServiceError::Field { .. } | ServiceError::QueuedOtherwise { .. } => Fault::Own,
        _ => Fault::Doubtful,
    }
}
