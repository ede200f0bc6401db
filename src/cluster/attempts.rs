//! Deliveries that say nothing against a record: the worker came back from them with an error of something
//! else. Only those from which no worker came back count towards the limit.
//!
//! JetStream counts every delivery. What is excused is kept in a stream beside the queue, one message for
//! each record that met an error.

use async_nats::jetstream::Message;
use async_nats::jetstream::stream::LastRawMessageErrorKind;
use serde::{Deserialize, Serialize};

use super::ClusterError;
use super::connection::Connection;

/// Longest error that is kept, in characters.
const MAX_ERROR: usize = 1000;

/// What is known of a record's earlier deliveries.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Attempts {
    /// Deliveries that a worker came back from.
    pub(super) excused: i64,
    /// The last of them.
    latest: i64,
    /// The last error; empty where there was none.
    pub(super) last_error: String,
}

impl Attempts {
    /// What is known of the record in a message.
    pub(super) async fn of(connection: &Connection, message: &Message) -> Result<Self, ClusterError> {
        let failed = ClusterError::jetstream("read what is known of a record");
        let Some(subject) = subject(connection, message) else {
            return Ok(Self::default());
        };
        let stream = match connection.jetstream.get_stream_no_info(connection.attempts_stream()).await {
            Ok(stream) => stream,
            Err(error) => return Err(failed(error.into())),
        };
        match stream.get_last_raw_message_by_subject(&subject).await {
            Ok(found) => Ok(serde_json::from_slice(&found.payload).unwrap_or_default()),
            Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => Ok(Self::default()),
            Err(error) => Err(failed(error.into())),
        }
    }

    /// Excuses the present delivery of a record, and keeps why.
    pub(super) async fn excuse(
        connection: &Connection,
        message: &Message,
        error: &str,
    ) -> Result<(), ClusterError> {
        let Some(subject) = subject(connection, message) else {
            return Ok(());
        };
        let (known, delivery) =
            (Self::of(connection, message).await?, message.info().map_or(1, |info| info.delivered));
        let known = Self {
            excused: known.excused + i64::from(known.latest < delivery),
            latest: delivery,
            last_error: error.chars().take(MAX_ERROR).collect(),
        };
        let failed =
            |error: async_nats::Error| ClusterError::jetstream("keep what is known of a record")(error);
        let payload = serde_json::to_vec(&known).map_err(|error| failed(error.into()))?;
        let sent = connection.jetstream.publish(subject, payload.into()).await;
        sent.map_err(|error| failed(error.into()))?.await.map_err(|error| failed(error.into()))?;
        Ok(())
    }

    /// Forgets a record that is done. What stays where this fails goes with its age.
    pub(super) async fn forget(connection: &Connection, message: &Message) {
        let Some(subject) = subject(connection, message) else {
            return;
        };
        let forgotten = async {
            let stream = connection.jetstream.get_stream_no_info(connection.attempts_stream()).await?;
            stream.purge().filter(subject).await?;
            Ok::<_, async_nats::Error>(())
        };
        if let Err(error) = forgotten.await {
            tracing::debug!(%error, "failed to forget what was known of a record");
        }
    }
}

/// Where what is known of a message of the queue is kept: under its place there.
fn subject(connection: &Connection, message: &Message) -> Option<String> {
    let info = message.info().ok()?;
    Some(format!("{}.{}", connection.attempts_subject(), info.stream_sequence))
}
