//! Records that could not be stored, with the reason: kept until somebody puts them back or takes them away.

use async_nats::header::{HeaderMap, NATS_MESSAGE_ID};
use async_nats::jetstream::Message;
use async_nats::jetstream::message::StreamMessage;
use async_nats::jetstream::stream::{LastRawMessageErrorKind, RawMessageErrorKind, Stream};
use jiff::Timestamp;
use serde::Serialize;

use super::connection::Connection;
use super::{ClusterError, message};
use crate::service::QueuedRecord;

/// Why a record is a dead letter.
const REASON: &str = "Flankwatch-Reason";

/// Keeps a message that will not be worked on again; it is safe once this returns.
pub(super) async fn put(
    connection: &Connection,
    message: &Message,
    reason: &str,
) -> Result<(), ClusterError> {
    tracing::error!(reason, "put a record among the dead letters");
    let mut headers = HeaderMap::new();
    headers.insert(REASON, one_line(reason));
    // Its place in the queue is its name: a worker that dies before it acknowledges puts it here once.
    if let Ok(info) = message.info() {
        headers.insert(NATS_MESSAGE_ID, info.stream_sequence.to_string());
    }
    let failed = |error: async_nats::Error| ClusterError::jetstream("keep a dead letter")(error);
    let sent = connection
        .jetstream
        .publish_with_headers(connection.dead_subject(), headers, message.payload.clone())
        .await;
    let kept = sent.map_err(|error| failed(error.into()))?.await;
    kept.map_err(|error| failed(error.into()))?;
    Ok(())
}

/// A header's value ends with its line.
fn one_line(reason: &str) -> String {
    reason.chars().map(|c| if c.is_control() { ' ' } else { c }).take(1000).collect()
}

/// A record that could not be stored, as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DeadLetter {
    /// Its number among the dead letters, never given out again.
    pub number: u64,
    /// Why it could not be stored: the last error.
    pub reason: String,
    /// When it was put there, by the clock of the queue's server.
    pub put_at: Timestamp,
    /// Bytes of its message.
    pub message_bytes: usize,
    /// The record; none where its message cannot be read.
    pub record: Option<QueuedRecord>,
}

/// All dead letters in the order in which they were put there.
pub(super) async fn list(connection: &Connection) -> Result<Vec<DeadLetter>, ClusterError> {
    let (stream, subject) = (stream(connection).await?, connection.dead_subject());
    let mut letters = Vec::new();
    let mut next = stream.cached_info().state.first_sequence.max(1);
    loop {
        match stream.get_first_raw_message_by_subject(&subject, next).await {
            Ok(found) => {
                next = found.sequence + 1;
                letters.push(letter_of(&found));
            }
            Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => return Ok(letters),
            Err(error) => return Err(ClusterError::jetstream("read the dead letters")(error.into())),
        }
    }
}

/// Puts a dead letter's record back into the queue, and takes the letter away once the queue has it.
pub(super) async fn retry(connection: &Connection, number: u64) -> Result<(), ClusterError> {
    let failed = || ClusterError::jetstream("put a dead letter back into the queue");
    let stream = stream(connection).await?;
    let letter = message(&stream, number).await?;
    // Under no name: the queue may remember the record's as one that it had.
    let sent = connection.jetstream.publish(connection.work_subject(), letter.payload).await;
    sent.map_err(|error| failed()(error.into()))?.await.map_err(|error| failed()(error.into()))?;
    delete(&stream, number).await
}

/// Takes a dead letter away for good.
pub(super) async fn drop_letter(connection: &Connection, number: u64) -> Result<(), ClusterError> {
    let stream = stream(connection).await?;
    message(&stream, number).await?;
    delete(&stream, number).await
}

/// One dead letter.
pub(super) async fn letter(connection: &Connection, number: u64) -> Result<DeadLetter, ClusterError> {
    Ok(letter_of(&message(&stream(connection).await?, number).await?))
}

async fn stream(connection: &Connection) -> Result<Stream, ClusterError> {
    let found = connection.jetstream.get_stream(connection.dead_stream()).await;
    found.map_err(|error| ClusterError::jetstream("find the dead letters")(error.into()))
}

async fn message(stream: &Stream, number: u64) -> Result<StreamMessage, ClusterError> {
    match stream.get_raw_message(number).await {
        Ok(found) => Ok(found),
        Err(error) if error.kind() == RawMessageErrorKind::NoMessageFound => Err(ClusterError::Setting {
            field: "dead letter".to_owned(),
            value: number.to_string(),
            expected: "a number that `flankwatch dead-letters list` shows".to_owned(),
        }),
        Err(error) => Err(ClusterError::jetstream("read a dead letter")(error.into())),
    }
}

async fn delete(stream: &Stream, number: u64) -> Result<(), ClusterError> {
    let deleted = stream.delete_message(number).await;
    deleted.map(|_| ()).map_err(|error| ClusterError::jetstream("remove a dead letter")(error.into()))
}

fn letter_of(message: &StreamMessage) -> DeadLetter {
    DeadLetter {
        number: message.sequence,
        reason: message.headers.get(REASON).map(ToString::to_string).unwrap_or_default(),
        put_at: Timestamp::from_nanosecond(message.time.unix_timestamp_nanos()).unwrap_or_default(),
        message_bytes: message.payload.len(),
        record: message::decode(&message.payload).ok(),
    }
}
