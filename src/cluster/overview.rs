//! Overview of a cluster: the records in the queue and the workers that respond.

use std::time::Duration;

use async_nats::jetstream::consumer::Info;
use async_nats::jetstream::message::StreamMessage;
use async_nats::jetstream::stream::{LastRawMessageErrorKind, Stream};
use futures_util::StreamExt;
use futures_util::future::try_join_all;
use jiff::Timestamp;

use super::ClusterError;
use super::connection::{ANY_SUBJECT, Connection};
use super::consumers::consumers;
use super::rebalance::unowned;
use crate::service::{QueueOverview, WorkerOverview};

/// Time in which workers must respond.
const WORKER_TIMEOUT: Duration = Duration::from_millis(300);

/// Queries the queue, the dead letters and the workers.
pub(super) async fn query(connection: &Connection) -> Result<QueueOverview, ClusterError> {
    let (queue, dead_letters, workers) =
        tokio::join!(queue(connection), dead_letters(connection), workers(connection));
    let workers = workers?;
    let partitions_unowned = unowned(workers.iter().map(|worker| &worker.partitions));
    Ok(QueueOverview { dead_letters: dead_letters?, partitions_unowned, workers, ..queue? })
}

/// Computes the queue's numbers from the states of its stream and its consumers.
async fn queue(connection: &Connection) -> Result<QueueOverview, ClusterError> {
    let stream = connection.work().await?;
    let state = stream.cached_info().state.clone();
    let consumers = consumers(&stream).await?;
    let in_progress = consumers.iter().map(|consumer| consumer.num_ack_pending as u64).sum();
    let known: u64 = consumers.iter().map(waiting_or_in_progress).sum();
    let Some(first) = first_of(&stream, ANY_SUBJECT, state.first_sequence).await? else {
        return Ok(QueueOverview { in_progress, ..QueueOverview::default() });
    };
    // Messages up to a consumer's floor are acknowledged: those still stored are never delivered again. They
    // come to the front as the records before them are processed.
    let floor = consumers.iter().find(|consumer| delivers(consumer, &first.subject)).map_or(0, floor_of);
    if first.sequence > floor {
        let oldest_at = time_of(&first);
        return Ok(QueueOverview {
            records: state.messages,
            in_progress,
            oldest_at,
            ..QueueOverview::default()
        });
    }
    let busy = consumers.iter().filter(|consumer| waiting_or_in_progress(consumer) > 0);
    let oldest = try_join_all(busy.map(|consumer| {
        let subject = match consumer.config.filter_subject.as_str() {
            "" => ANY_SUBJECT,
            subject => subject,
        };
        first_of(&stream, subject, floor_of(consumer) + 1)
    }));
    let oldest_at = oldest.await?.iter().flatten().filter_map(time_of).min();
    let leftovers = state.messages.saturating_sub(known);
    let records = state.messages.saturating_sub(leftovers);
    Ok(QueueOverview { records, in_progress, oldest_at, leftovers, ..QueueOverview::default() })
}

fn waiting_or_in_progress(consumer: &Info) -> u64 {
    consumer.num_pending + consumer.num_ack_pending as u64
}

/// Returns the sequence number up to which a consumer's messages are acknowledged.
fn floor_of(consumer: &Info) -> u64 {
    consumer.ack_floor.stream_sequence
}

fn delivers(consumer: &Info, subject: &str) -> bool {
    [subject, ""].contains(&consumer.config.filter_subject.as_str())
}

/// Returns the first message of a subject from a sequence number on; `None` if there is none.
async fn first_of(stream: &Stream, subject: &str, from: u64) -> Result<Option<StreamMessage>, ClusterError> {
    match stream.get_first_raw_message_by_subject(subject, from.max(1)).await {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => Ok(None),
        Err(error) => Err(ClusterError::jetstream("read the state of the queue")(error.into())),
    }
}

fn time_of(message: &StreamMessage) -> Option<Timestamp> {
    Timestamp::from_nanosecond(message.time.unix_timestamp_nanos()).ok()
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
    let mut replies = client.subscribe(inbox.clone()).await.map_err(|error| failed()(error.into()))?;
    let published = client.publish_with_reply(connection.workers_subject(), inbox, "".into()).await;
    published.map_err(|error| failed()(error.into()))?;
    let mut workers = Vec::new();
    let collect = async {
        while let Some(reply) = replies.next().await {
            match serde_json::from_slice(&reply.payload) {
                Ok(worker) => workers.push(worker),
                // The server's notice that there are no responders.
                Err(_) if reply.payload.is_empty() => return,
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
            Err(error) => tracing::warn!(%error, "failed to subscribe to status queries; retrying"),
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
