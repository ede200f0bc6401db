//! A worker: takes records from the queue, has them analysed and stored, and only then acknowledges them.

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
use super::fault::Fault;
use super::{ClusterError, WorkerLimits, message, overview};
use crate::asset::AssetId;
use crate::service::{Accepted, QueuedRecord, Service, ServiceError, WorkerOverview};

/// How long one question for records waits for some.
const ASKED_FOR: Duration = Duration::from_secs(2);

/// Waits between two tries of a record that something away holds up.
const FIRST_WAIT: Duration = Duration::from_millis(200);
const MAX_WAIT: Duration = Duration::from_secs(5);

/// When a record that could not be dealt with is given out again.
const TRIED_AGAIN: Duration = Duration::from_secs(10);

/// When a record that a stopping worker held is given out again: not to that worker, whose last question for
/// records may still stand.
const AFTER_STOP: Duration = Duration::from_secs(1);

/// How often a record is tried that may be at fault itself.
const DOUBTFUL_TRIES: u32 = 5;

/// A worker's parts; a clone is another handle to the same ones.
#[derive(Clone)]
pub(super) struct Worker {
    connection: Connection,
    service: Arc<Service>,
    limits: WorkerLimits,
    stop: watch::Receiver<bool>,
    /// Records that it works on.
    in_work: Arc<AtomicU64>,
}

/// What became of a record.
#[derive(Debug)]
enum Outcome {
    /// It is stored, or its asset is gone.
    Stored,
    /// It can never be stored, for this reason.
    GivenUp(String),
    /// It could not be stored now: another delivery follows, after this wait.
    GivenBack(Duration),
}

impl Worker {
    pub(super) fn new(
        connection: Connection,
        service: Arc<Service>,
        mut limits: WorkerLimits,
        stop: watch::Receiver<bool>,
    ) -> Self {
        // More than that would be refused, and held.
        limits.at_once = limits.at_once.min(service.workers.queue().1).max(1);
        Self { connection, service, limits, stop, in_work: Arc::default() }
    }

    /// Works until it is told to stop, and then ends what it has begun.
    pub(super) async fn run(self) {
        while let Err(error) = self.service.resume().await {
            tracing::warn!(%error, "failed to resume: trying again");
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
        let changes = tokio::spawn(self.clone().follow_changes());
        let turns = Arc::new(Semaphore::new(self.limits.at_once));
        let answers = tokio::spawn(self.answer());
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
        answers.abort();
    }

    /// Tells of this worker whoever asks.
    fn answer(&self) -> impl Future<Output = ()> + use<> {
        let (service, in_work, at_once) =
            (Arc::clone(&self.service), Arc::clone(&self.in_work), self.limits.at_once);
        let name = overview::worker_name();
        overview::answer(self.connection.clone(), move || WorkerOverview {
            name: name.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            in_work: in_work.load(Ordering::Relaxed),
            at_once: at_once as u64,
            stored: service.tally.stored(),
        })
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
                let worker = self.clone();
                tokio::spawn(async move {
                    let in_work = Arc::clone(&worker.in_work);
                    in_work.fetch_add(1, Ordering::Relaxed);
                    worker.treat(message, turn).await;
                    in_work.fetch_sub(1, Ordering::Relaxed);
                });
            }
        }
    }

    async fn treat(self, message: Message, turn: OwnedSemaphorePermit) {
        let _turn = turn;
        // A record that was never given out before, and met no error, is not noted anywhere.
        let mut is_noted = deliveries(&message) > 1;
        let treated = tokio::select! {
            treated = self.store(&message, &mut is_noted) => treated,
            () = keep_alive(&message, self.connection.settings().ack_wait / 3) => return,
        };
        let kind = match treated {
            Outcome::Stored => AckKind::Ack,
            Outcome::GivenUp(reason) => match self.give_up(&message, &reason).await {
                Ok(()) => AckKind::Ack,
                Err(error) => {
                    tracing::warn!(%error, reason, "failed to put a record among the dead letters: trying again later");
                    self.excuse(&message, &reason).await;
                    AckKind::Nak(Some(TRIED_AGAIN))
                }
            },
            Outcome::GivenBack(wait) => AckKind::Nak(Some(wait)),
        };
        let is_done = matches!(kind, AckKind::Ack);
        // Where the acknowledgement is lost the record comes again, and is found stored.
        if let Err(error) = message.double_ack_with(kind).await {
            tracing::debug!(%error, "failed to confirm an acknowledgement");
        } else if is_done && is_noted {
            Attempts::forget(&self.connection, &message).await;
        }
    }

    /// Notes that this delivery says nothing against the record. Where that cannot be noted it counts as one
    /// from which no worker came back.
    async fn excuse(&self, message: &Message, error: &str) {
        if let Err(error) = Attempts::excuse(&self.connection, message, error).await {
            tracing::warn!(%error, "failed to note the error of a record");
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
    /// `is_noted` becomes true where an error was noted with it.
    async fn store(&self, message: &Message, is_noted: &mut bool) -> Outcome {
        let record = match message::decode(&message.payload) {
            Ok(record) => record,
            Err(error) => return Outcome::GivenUp(error.to_string()),
        };
        match self.crashed_too_often(message).await {
            Ok(None) => {}
            Ok(Some(reason)) => {
                return Outcome::GivenUp(format!("segment {} of {}: {reason}", record.id, record.asset_id));
            }
            Err(error) => {
                tracing::warn!(%error, "failed to count the deliveries of a record: giving it back to the queue");
                return Outcome::GivenBack(TRIED_AGAIN);
            }
        }
        let (mut wait, mut doubted, mut is_excused) = (FIRST_WAIT, 0, false);
        let mut stop = self.stop.clone();
        loop {
            let error = match self.store_once(&record).await {
                Ok(Some(_)) => return Outcome::Stored,
                Ok(None) => {
                    tracing::info!(segment = %record.id, asset = %record.asset_id, "dropped a record whose asset was removed");
                    return Outcome::Stored;
                }
                Err(error) => error,
            };
            let reason = format!("segment {} of {}: {error}", record.id, record.asset_id);
            match Fault::from(&error) {
                Fault::Own => return Outcome::GivenUp(reason),
                Fault::Doubtful => {
                    doubted += 1;
                    if doubted == DOUBTFUL_TRIES {
                        return Outcome::GivenUp(format!("{reason} (tried {doubted} times)"));
                    }
                }
                Fault::Elsewhere => {}
            }
            if !is_excused {
                (is_excused, *is_noted) = (true, true);
                // Before anybody can learn of it and end this worker.
                self.excuse(message, &reason).await;
                tracing::warn!(segment = %record.id, %error, "failed to store a record: holding it");
            }
            tokio::select! {
                _ = stop.wait_for(|stop| *stop) => return Outcome::GivenBack(AFTER_STOP),
                () = tokio::time::sleep(wait) => {}
            }
            wait = (2 * wait).min(MAX_WAIT);
        }
    }

    /// Why a record is not tried again: it was given out too often without a worker coming back from it.
    async fn crashed_too_often(&self, message: &Message) -> Result<Option<String>, ClusterError> {
        let (before, most) = (deliveries(message) - 1, i64::from(self.limits.max_deliveries));
        if before < most {
            return Ok(None);
        }
        let known = Attempts::of(&self.connection, message).await?;
        let crashes = before - known.excused;
        if crashes < most {
            return Ok(None);
        }
        let last = if known.last_error.is_empty() {
            String::new()
        } else {
            format!("; its last error: {}", known.last_error)
        };
        Ok(Some(format!(
            "given out {crashes} times and never finished: it may be what ends its workers{last}"
        )))
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

/// How often a message was given out, this time included.
fn deliveries(message: &Message) -> i64 {
    message.info().map_or(1, |info| info.delivered)
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
