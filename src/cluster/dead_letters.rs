//! Dead letters: records that could not be stored, kept with the reason until they are retried or dropped.

use async_nats::header::{HeaderMap, NATS_MESSAGE_ID};
use async_nats::jetstream::Message;
use async_nats::jetstream::message::StreamMessage;
use async_nats::jetstream::stream::{LastRawMessageErrorKind, RawMessageErrorKind, Stream};
use jiff::Timestamp;
use serde::Serialize;

use super::connection::Connection;
use super::partition::Source;
use super::{ClusterError, message};
use crate::settings::SettingError;
use crate::store::RecordMetadata;

/// Header with the reason why a record is a dead letter.
const REASON: &str = "Flankwatch-Reason";

/// Stores a message as a dead letter; it is durable once this returns.
pub(super) async fn put(
    connection: &Connection,
    message: &Message,
    reason: &str,
) -> Result<(), ClusterError> {
    tracing::error!(reason, "moving a record to the dead letters");
    let mut headers = HeaderMap::new();
    headers.insert(REASON, one_line(reason));
    // Deduplicates by the sequence number in the queue: a worker that dies before it acknowledges stores one
    // dead letter only.
    if let Ok(info) = message.info() {
        headers.insert(NATS_MESSAGE_ID, info.stream_sequence.to_string());
    }
    let failed = |error: async_nats::Error| ClusterError::jetstream("store a dead letter")(error);
    let sent = connection
        .jetstream
        .publish_with_headers(connection.dead_subject(), headers, message.payload.clone())
        .await;
    let acknowledged = sent.map_err(|error| failed(error.into()))?.await;
    acknowledged.map_err(|error| failed(error.into()))?;
    Ok(())
}

/// Replaces control characters, which a header value cannot have, and truncates to 1000 characters.
fn one_line(reason: &str) -> String {
    reason.chars().map(|c| if c.is_control() { ' ' } else { c }).take(1000).collect()
}

/// A record that could not be stored.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DeadLetter {
    /// Number of the dead letter, never reused.
    pub number: u64,
    /// The last error.
    pub reason: String,
    /// Time when it became a dead letter, by the NATS server's clock.
    pub put_at: Timestamp,
    /// Size of the message in bytes.
    pub message_bytes: usize,
    /// The record; `None` where the message cannot be read.
    pub record: Option<RecordMetadata>,
}

/// Lists all dead letters, oldest first.
pub(super) async fn list(connection: &Connection) -> Result<Vec<DeadLetter>, ClusterError> {
    let (stream, subject) = (stream(connection).await?, connection.dead_subject());
    let mut letters = Vec::new();
    let mut next = stream.cached_info().state.first_sequence.max(1);
    loop {
        match stream.get_first_raw_message_by_subject(&subject, next).await {
            Ok(found) => {
                next = found.sequence + 1;
                letters.push(dead_letter(&found));
            }
            Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => return Ok(letters),
            Err(error) => return Err(ClusterError::jetstream("read the dead letters")(error.into())),
        }
    }
}

/// Puts a dead letter's record back into the queue; removes the dead letter once the record is queued.
pub(super) async fn retry(connection: &Connection, number: u64) -> Result<(), ClusterError> {
    let failed = || ClusterError::jetstream("put a dead letter back into the queue");
    let stream = stream(connection).await?;
    let letter = message(&stream, number).await?;
    // Without a message ID: the queue may still reject the record's own as a duplicate.
    let subject = Source::subject_of_message(&letter.payload, connection);
    let sent = connection.jetstream.publish(subject, letter.payload).await;
    sent.map_err(|error| failed()(error.into()))?.await.map_err(|error| failed()(error.into()))?;
    delete(&stream, number).await
}

/// Deletes a dead letter.
pub(super) async fn remove(connection: &Connection, number: u64) -> Result<(), ClusterError> {
    let stream = stream(connection).await?;
    message(&stream, number).await?;
    delete(&stream, number).await
}

/// Returns one dead letter.
pub(super) async fn get(connection: &Connection, number: u64) -> Result<DeadLetter, ClusterError> {
    Ok(dead_letter(&message(&stream(connection).await?, number).await?))
}

async fn stream(connection: &Connection) -> Result<Stream, ClusterError> {
    let found = connection.jetstream.get_stream(connection.dead_stream()).await;
    found.map_err(|error| ClusterError::jetstream("find the dead letters")(error.into()))
}

async fn message(stream: &Stream, number: u64) -> Result<StreamMessage, ClusterError> {
    match stream.get_raw_message(number).await {
        Ok(found) => Ok(found),
        Err(error) if error.kind() == RawMessageErrorKind::NoMessageFound => {
            let expected = "a number listed by `flankwatch dead-letters list`";
            Err(SettingError::new("dead letter", number, expected).into())
        }
        Err(error) => Err(ClusterError::jetstream("read a dead letter")(error.into())),
    }
}

async fn delete(stream: &Stream, number: u64) -> Result<(), ClusterError> {
    let deleted = stream.delete_message(number).await;
    deleted.map(|_| ()).map_err(|error| ClusterError::jetstream("remove a dead letter")(error.into()))
}

fn dead_letter(message: &StreamMessage) -> DeadLetter {
    DeadLetter {
        number: message.sequence,
        reason: message.headers.get(REASON).map(ToString::to_string).unwrap_or_default(),
        put_at: Timestamp::from_nanosecond(message.time.unix_timestamp_nanos()).unwrap_or_default(),
        message_bytes: message.payload.len(),
        record: message::decode(&message.payload).ok().map(|queued| queued.metadata),
    }
}
