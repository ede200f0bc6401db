//! Records that could not be stored, with the reason: kept until somebody puts them back or takes them away.

use async_nats::header::{HeaderMap, NATS_MESSAGE_ID};
use async_nats::jetstream::Message;

use super::ClusterError;
use super::connection::Connection;

/// Why a record is a dead letter.
const REASON: &str = "Flankwatch-Reason";

/// Keeps a message that will not be worked on again; it is safe once this returns.
pub(super) async fn put(connection: &Connection, message: &Message, reason: &str) -> Result<(), ClusterError> {
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
