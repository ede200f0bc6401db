//! Overview of a cluster: the records in the queue and the workers that respond.

use std::time::Duration;

use async_nats::jetstream::context::ConsumerInfoErrorKind;
use async_nats::jetstream::stream::LastRawMessageErrorKind;
use futures_util::StreamExt;
use jiff::Timestamp;

use super::ClusterError;
use super::connection::{CONSUMER, Connection};
use crate::service::{QueueOverview, WorkerOverview};

/// Time in which workers must respond.
const WORKER_TIMEOUT: Duration = Duration::from_millis(300);

/// Queries the queue, the dead letters and the workers.
pub(super) async fn query(connection: &Connection) -> Result<QueueOverview, ClusterError> {
    let (queue, dead_letters, workers) =
        tokio::join!(queue(connection), dead_letters(connection), workers(connection));
    Ok(QueueOverview { dead_letters: dead_letters?, workers: workers?, ..queue? })
}

/// Computes the queue's numbers from the states of its stream and its consumer.
async fn queue(connection: &Connection) -> Result<QueueOverview, ClusterError> {
    let failed = || ClusterError::jetstream("read the state of the queue");
    let stream = match connection.jetstream.get_stream(connection.work_stream()).await {
        Ok(stream) => stream,
        Err(error) => return Err(failed()(error.into())),
    };
    let state = stream.cached_info().state.clone();
    let (known, floor, in_work) = match stream.consumer_info(CONSUMER).await {
        Ok(info) => (
            info.num_pending + info.num_ack_pending as u64,
            info.ack_floor.stream_sequence,
            info.num_ack_pending as u64,
        ),
        // No worker has ever connected.
        Err(error) if error.kind() == ConsumerInfoErrorKind::NotFound => (state.messages, 0, 0),
        Err(error) => return Err(failed()(error.into())),
    };
    // Messages up to the floor are acknowledged: those still stored are never delivered again.
    let leftovers =
        if floor > 0 && state.first_sequence <= floor { state.messages.saturating_sub(known) } else { 0 };
    let records = state.messages.saturating_sub(leftovers);
    let oldest_at = if records == 0 {
        None
    } else {
        let from = state.first_sequence.max(floor + 1);
        match stream.get_first_raw_message_by_subject(&connection.work_subject(), from).await {
            Ok(oldest) => Timestamp::from_nanosecond(oldest.time.unix_timestamp_nanos()).ok(),
            // It was completed meanwhile.
            Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => None,
            Err(error) => return Err(failed()(error.into())),
        }
    };
    Ok(QueueOverview { records, in_work, oldest_at, leftovers, ..QueueOverview::default() })
}

async fn dead_letters(connection: &Connection) -> Result<u64, ClusterError> {
    match connection.jetstream.get_stream(connection.dead_stream()).await {
        Ok(stream) => Ok(stream.cached_info().state.messages),
        Err(error) => Err(ClusterError::jetstream("read the state of the dead letters")(error.into())),
    }
}

/// Collects the workers that respond in time.
async fn workers(connection: &Connection) -> Result<Vec<WorkerOverview>, ClusterError> {
    let failed = || ClusterError::jetstream("query the workers");
    let client = &connection.client;
    let inbox = client.new_inbox();
    let mut answers = client.subscribe(inbox.clone()).await.map_err(|error| failed()(error.into()))?;
    let published = client.publish_with_reply(connection.workers_subject(), inbox, "".into()).await;
    published.map_err(|error| failed()(error.into()))?;
    let mut workers = Vec::new();
    let collect = async {
        while let Some(answer) = answers.next().await {
            match serde_json::from_slice(&answer.payload) {
                Ok(worker) => workers.push(worker),
                // The server's notice that there are no responders.
                Err(_) if answer.payload.is_empty() => return,
                Err(error) => tracing::debug!(%error, "failed to read the response of a worker"),
            }
        }
    };
    // Workers that have not responded by then are missing from the overview.
    let _ = tokio::time::timeout(WORKER_TIMEOUT, collect).await;
    workers.sort_by(|one: &WorkerOverview, other| one.name.cmp(&other.name));
    Ok(workers)
}

/// Responds to status queries with the worker's overview; never returns.
pub(super) async fn respond(connection: Connection, overview: impl Fn() -> WorkerOverview) {
    loop {
        match connection.client.subscribe(connection.workers_subject()).await {
            Err(error) => tracing::warn!(%error, "failed to subscribe to status queries, retrying"),
            Ok(mut queries) => {
                while let Some(query) = queries.next().await {
                    let Some(to) = query.reply else { continue };
                    let response = serde_json::to_vec(&overview()).expect("a name and numbers serialise");
                    if let Err(error) = connection.client.publish(to, response.into()).await {
                        tracing::debug!(%error, "failed to respond to a status query");
                    }
                }
            }
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

/// Returns a unique name for a worker: the host name, if known, and a random number.
pub(super) fn worker_name() -> String {
    let host = std::env::var("HOSTNAME").ok().filter(|name| !name.is_empty());
    let number = getrandom::u32().unwrap_or_default();
    format!("{}-{number:08x}", host.as_deref().unwrap_or("worker"))
}
