//! The queue between API nodes and workers: a JetStream work-queue stream.

use std::collections::HashSet;
use std::time::Duration;

use async_nats::jetstream::context::{PublishAckFuture, PublishError, PublishErrorKind};
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::stream::LastRawMessageErrorKind;
use futures_util::future::BoxFuture;
use sha2::{Digest, Sha256};

use super::ClusterError;
use super::connection::{ANY_SUBJECT, Connection};
use super::partition::Source;
use super::{message, overview};
use crate::asset::AssetId;
use crate::service::{PartHealth, QueueOverview, QueuedRecord, ServiceError, WorkQueue};

const FULL: ServiceError = ServiceError::Busy { what: "the workers' queue is full", retry_after_s: 5 };

const UNREACHABLE: ServiceError =
    ServiceError::Busy { what: "the workers' queue cannot be reached", retry_after_s: 2 };

/// Timeout of the health check.
const HEALTH_TIMEOUT: Duration = Duration::from_secs(3);

/// Upper bound of the usual size of a message in the queue.
const MESSAGE_BYTES: u64 = 512;

/// The queue, and the notifications of changed assets.
pub struct Queue {
    connection: Connection,
    /// Whether this process enqueues records: only then is a full queue a fault.
    is_producer: bool,
}

impl Queue {
    pub(super) fn new(connection: Connection, is_producer: bool) -> Self {
        Self { connection, is_producer }
    }

    async fn publish(&self, record: &QueuedRecord) -> Result<PublishAckFuture, ServiceError> {
        let payload = message::encode(record).map_err(|error| ServiceError::Field {
            field: "record",
            value: error.to_string(),
            expected: "one that fits into a message".into(),
        })?;
        let message = PublishMessage::build().payload(payload).message_id(message_id(record));
        let subject =
            Source::subject_of(&record.metadata.asset_id, &record.metadata.channel, &self.connection);
        let sent = self.connection.jetstream.send_publish(subject, message).await;
        sent.map_err(|error| busy(&error))
    }
}

/// Returns the ID by which JetStream detects a duplicate of a record. It differs for an asset created again
/// under the same name, and for a record that has become a dead letter since.
fn message_id(record: &QueuedRecord) -> String {
    let mut hash = Sha256::new();
    hash.update(record.metadata.id.0.as_bytes());
    hash.update(record.asset_created_at.as_nanosecond().to_le_bytes());
    if record.dead_letters > 0 {
        hash.update(record.dead_letters.to_le_bytes());
    }
    hex::encode(&hash.finalize()[..16])
}

fn busy(error: &PublishError) -> ServiceError {
    // A full stream has no error kind of its own, only a message.
    if error.kind() == PublishErrorKind::Other && error.to_string().contains("maximum") {
        return FULL;
    }
    tracing::warn!(%error, "failed to enqueue a record");
    UNREACHABLE
}

impl WorkQueue for Queue {
    fn enqueue<'a>(&'a self, records: &'a [QueuedRecord]) -> BoxFuture<'a, Result<(), ServiceError>> {
        Box::pin(async move {
            // Without a connection the client would buffer the records and send them long after the response.
            if self.connection.fault().is_some() {
                return Err(UNREACHABLE);
            }
            let mut acknowledgements = Vec::with_capacity(records.len());
            for record in records {
                acknowledgements.push(self.publish(record).await?);
            }
            for acknowledgement in acknowledgements {
                match acknowledgement.await {
                    Ok(acknowledged) => {
                        tracing::trace!(acknowledged.sequence, acknowledged.duplicate, "queued")
                    }
                    Err(error) => {
                        if error.kind() == PublishErrorKind::StreamNotFound {
                            self.connection.prepare().await.map_err(|error| {
                                tracing::error!(%error, "failed to create the missing queue");
                                UNREACHABLE
                            })?;
                        }
                        return Err(busy(&error));
                    }
                }
            }
            Ok(())
        })
    }

    fn objects_waiting(&self) -> BoxFuture<'_, Result<HashSet<String>, ServiceError>> {
        Box::pin(async move {
            let connection = &self.connection;
            let mut objects = HashSet::new();
            for stream in [connection.work_stream(), connection.dead_stream()] {
                let found = objects_of(connection, stream).await.map_err(|error| {
                    tracing::warn!(%error, "failed to scan the queue");
                    UNREACHABLE
                })?;
                objects.extend(found);
            }
            Ok(objects)
        })
    }

    fn notify_changed(&self, asset: &AssetId) {
        let (client, subject) = (self.connection.client.clone(), self.connection.changes_subject());
        let asset = asset.to_string();
        tokio::spawn(async move {
            if let Err(error) = client.publish(subject, asset.into()).await {
                tracing::debug!(%error, "failed to notify the workers of a change");
            }
        });
    }

    fn overview(&self) -> BoxFuture<'_, Result<QueueOverview, ServiceError>> {
        Box::pin(async {
            overview::query(&self.connection).await.map_err(|error| {
                tracing::debug!(%error, "failed to query the queue");
                UNREACHABLE
            })
        })
    }

    fn health(&self) -> BoxFuture<'_, Vec<PartHealth>> {
        Box::pin(async {
            let fault = match self.connection.fault() {
                Some(fault) => Some(fault.to_owned()),
                None => {
                    let checked = tokio::time::timeout(HEALTH_TIMEOUT, self.queue_fault()).await;
                    checked.unwrap_or_else(|_| Some("does not answer".to_owned()))
                }
            };
            vec![PartHealth { part: "queue_server", fault }]
        })
    }
}

/// Returns the raw objects of the records in a stream.
async fn objects_of(connection: &Connection, stream: String) -> Result<HashSet<String>, ClusterError> {
    let failed = ClusterError::jetstream("scan a stream");
    let stream = match connection.jetstream.get_stream(stream).await {
        Ok(stream) => stream,
        Err(error) => return Err(failed(error.into())),
    };
    let mut objects = HashSet::new();
    let mut next = stream.cached_info().state.first_sequence.max(1);
    loop {
        let found = match stream.get_first_raw_message_by_subject(ANY_SUBJECT, next).await {
            Ok(found) => found,
            Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => return Ok(objects),
            Err(error) => return Err(failed(error.into())),
        };
        next = found.sequence + 1;
        if let Ok(record) = message::decode(&found.payload) {
            objects.insert(record.metadata.raw.sha256);
        }
    }
}

impl Queue {
    /// Returns why the queue cannot take records; `None` if it can.
    async fn queue_fault(&self) -> Option<String> {
        match self.connection.work_state().await {
            // The stream may be missing: creating it gives the reason where that fails.
            Err(_) => self.connection.prepare().await.err().map(|error| error.to_string()),
            Ok(state) => {
                let settings = self.connection.settings();
                let (max_records, max_bytes) = (settings.max_records, settings.max_bytes);
                if self.is_producer && state.messages >= max_records.unsigned_abs() {
                    return Some(format!("full: {} of {max_records} records", state.messages));
                }
                if self.is_producer && state.bytes.saturating_add(MESSAGE_BYTES) > max_bytes.unsigned_abs() {
                    return Some(format!("full: {} of {max_bytes} bytes of messages", state.bytes));
                }
                let written = self.connection.check_writable().await;
                written.err().map(|error| error.to_string())
            }
        }
    }
}
