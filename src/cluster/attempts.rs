//! Deliveries that do not count against a record: the worker survived them and reported an error. Only
//! deliveries that no worker survived count towards the limit.
//!
//! JetStream counts every delivery, also that of a record which only waits for its turn when its worker ends.
//! Those that began and those that are excused are counted in a separate stream, with one message for each
//! record that had an error or was delivered again.

use async_nats::jetstream::Message;
use async_nats::jetstream::stream::LastRawMessageErrorKind;
use serde::{Deserialize, Serialize};

use super::ClusterError;
use super::connection::Connection;

/// Maximum length of a stored error, in characters.
const MAX_ERROR: usize = 1000;

/// Earlier deliveries of a record.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Attempts {
    /// Number of deliveries that a worker survived.
    excused: i64,
    /// Number of deliveries after the first one for which a worker began.
    begun: i64,
    /// Delivery number of the last excused one.
    latest: i64,
    /// The last error; empty without one.
    pub(super) last_error: String,
}

impl Attempts {
    /// Reads the attempts of the record in a message.
    async fn load(connection: &Connection, message: &Message) -> Result<Self, ClusterError> {
        let failed = ClusterError::jetstream("read the attempts of a record");
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

    /// Counts that a worker begins with a record which was delivered before; returns the earlier attempts.
    pub(super) async fn begin(connection: &Connection, message: &Message) -> Result<Self, ClusterError> {
        let earlier = Self::load(connection, message).await?;
        Self { begun: earlier.begun + 1, ..earlier.clone() }.store(connection, message).await?;
        Ok(earlier)
    }

    /// Returns the number of deliveries that no worker survived. The first one counts in any case: nothing is
    /// stored when it begins.
    pub(super) fn crashes(&self) -> i64 {
        1 + self.begun - self.excused
    }

    /// Excuses the current delivery of a record and stores its error.
    pub(super) async fn excuse(
        connection: &Connection,
        message: &Message,
        error: &str,
    ) -> Result<(), ClusterError> {
        let (earlier, delivery) =
            (Self::load(connection, message).await?, message.info().map_or(1, |info| info.delivered));
        let attempts = Self {
            excused: earlier.excused + i64::from(earlier.latest < delivery),
            latest: delivery,
            last_error: error.chars().take(MAX_ERROR).collect(),
            ..earlier
        };
        attempts.store(connection, message).await
    }

    async fn store(&self, connection: &Connection, message: &Message) -> Result<(), ClusterError> {
        let Some(subject) = subject(connection, message) else {
            return Ok(());
        };
        let failed =
            |error: async_nats::Error| ClusterError::jetstream("store the attempts of a record")(error);
        let payload = serde_json::to_vec(self).map_err(|error| failed(error.into()))?;
        let sent = connection.jetstream.publish(subject, payload.into()).await;
        sent.map_err(|error| failed(error.into()))?.await.map_err(|error| failed(error.into()))?;
        Ok(())
    }

    /// Removes the attempts of a completed record. On failure they expire by age.
    pub(super) async fn remove(connection: &Connection, message: &Message) {
        let Some(subject) = subject(connection, message) else {
            return;
        };
        let removed = async {
            let stream = connection.jetstream.get_stream_no_info(connection.attempts_stream()).await?;
            stream.purge().filter(subject).await?;
            Ok::<_, async_nats::Error>(())
        };
        if let Err(error) = removed.await {
            tracing::debug!(%error, "failed to remove the attempts of a record");
        }
    }
}

/// Returns the subject of a record's attempts, which has the sequence number of its message in the queue.
fn subject(connection: &Connection, message: &Message) -> Option<String> {
    let info = message.info().ok()?;
    Some(format!("{}.{}", connection.attempts_subject(), info.stream_sequence))
}
