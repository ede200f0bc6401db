//! Takes records from the partitions that a worker owns, in the order of the queue.
//!
//! Each partition has one record of the worker at most that waits for its turn. It asks for the next one when
//! that record is in progress. So a partition without records holds up no other, and one with many records
//! has no more turns than the others.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::Message;
use futures_util::StreamExt;
use futures_util::future::{try_join, try_join_all};
use tokio::sync::{Semaphore, mpsc, oneshot, watch};

use super::ClusterError;
use super::partition::Source;
use super::worker::Worker;

/// Time that one request for a record waits for a record.
const PULL_EXPIRY: Duration = Duration::from_secs(30);

/// Time between signs of life of the server while a request waits.
const HEARTBEAT: Duration = Duration::from_secs(5);

/// Time between two checks of the consumers. Until then, after a worker of a version without partitions has
/// changed them, records can come to two workers.
const CHECK_INTERVAL: Duration = Duration::from_secs(30);

/// The intake of a worker.
pub(super) struct Intake {
    pub(super) worker: Worker,
    /// The partitions that the worker owns.
    pub(super) owned: watch::Receiver<BTreeSet<u16>>,
    /// One for each record that may be in progress.
    pub(super) slots: Arc<Semaphore>,
    /// Closed once no record is waiting or in progress.
    pub(super) busy: mpsc::Sender<()>,
}

impl Intake {
    /// Takes records until a request fails; each one is processed in a task of its own.
    pub(super) async fn run(&self) -> Result<(), ClusterError> {
        self.worker.connection.prepare().await?;
        self.worker.connection.prepare_consumers().await?;
        let sources = Source::all(self.worker.connection.has_partitions());
        let sources = try_join_all(sources.map(|source| self.take_from(source)));
        try_join(sources, self.keep_consumers()).await.map(|_| ())
    }

    async fn keep_consumers(&self) -> Result<(), ClusterError> {
        loop {
            tokio::time::sleep(CHECK_INTERVAL).await;
            self.worker.connection.prepare_consumers().await?;
        }
    }

    /// Takes records of a source whenever the worker owns it.
    async fn take_from(&self, source: Source) -> Result<(), ClusterError> {
        let mut owned = self.owned.clone();
        // Ownership ends with the worker.
        while owned.wait_for(|owned| is_in(source, owned)).await.is_ok() {
            self.take_while_owned(source, &mut owned).await?;
        }
        Ok(())
    }

    async fn take_while_owned(
        &self,
        source: Source,
        owned: &mut watch::Receiver<BTreeSet<u16>>,
    ) -> Result<(), ClusterError> {
        let failed = ClusterError::jetstream;
        let consumer = self.worker.connection.consumer(source).await?;
        let requests =
            consumer.stream().max_messages_per_batch(1).expires(PULL_EXPIRY).heartbeat(HEARTBEAT).messages();
        let mut messages = requests.await.map_err(|error| failed("request records")(error.into()))?;
        while is_in(source, &owned.borrow()) {
            let message = tokio::select! {
                biased;
                message = messages.next() => message,
                _ = owned.wait_for(|owned| !is_in(source, owned)) => break,
            };
            let Some(message) = message else {
                return Err(failed("take a record")("the requests ended".into()));
            };
            self.start(message.map_err(|error| failed("take a record")(error.into()))?).await;
        }
        Ok(())
    }

    /// Waits until a record is in progress. Its task continues to wait if this future is dropped.
    async fn start(&self, message: Message) {
        let (started, has_started) = oneshot::channel();
        let (worker, slots, busy) = (self.worker.clone(), Arc::clone(&self.slots), self.busy.clone());
        tokio::spawn(async move {
            let _busy = busy;
            worker.process_in_slot(message, slots, started).await;
        });
        // An error if the record was returned to the queue.
        let _ = has_started.await;
    }
}

/// Whether a worker that owns these partitions takes records of a source.
fn is_in(source: Source, owned: &BTreeSet<u16>) -> bool {
    match source {
        Source::Partition(number) => owned.contains(&number),
        Source::Unpartitioned => true,
    }
}
