//! What waits in the queue, and which workers answer when they are asked.

use std::time::Duration;

use async_nats::jetstream::context::ConsumerInfoErrorKind;
use async_nats::jetstream::stream::LastRawMessageErrorKind;
use futures_util::StreamExt;
use jiff::Timestamp;

use super::ClusterError;
use super::connection::{CONSUMER, Connection};
use crate::service::{QueueOverview, WorkerOverview};

/// How long workers have to answer.
const WORKERS_ANSWER: Duration = Duration::from_millis(300);

/// Looks at the queue and asks for workers.
pub(super) async fn look(connection: &Connection) -> Result<QueueOverview, ClusterError> {
    let (queue, dead_letters, workers) =
        tokio::join!(queue(connection), dead_letters(connection), workers(connection));
    Ok(QueueOverview { dead_letters: dead_letters?, workers: workers?, ..queue? })
}

/// What waits, by what the stream holds and how far its consumer is.
async fn queue(connection: &Connection) -> Result<QueueOverview, ClusterError> {
    let failed = || ClusterError::jetstream("look at the queue");
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
        // No worker has ever asked.
        Err(error) if error.kind() == ConsumerInfoErrorKind::NotFound => (state.messages, 0, 0),
        Err(error) => return Err(failed()(error.into())),
    };
    // Messages up to the floor are acknowledged: what is still there of them is given to nobody.
    let leftovers =
        if floor > 0 && state.first_sequence <= floor { state.messages.saturating_sub(known) } else { 0 };
    let records = state.messages.saturating_sub(leftovers);
    let oldest_at = if records == 0 {
        None
    } else {
        let from = state.first_sequence.max(floor + 1);
        match stream.get_first_raw_message_by_subject(&connection.work_subject(), from).await {
            Ok(oldest) => Timestamp::from_nanosecond(oldest.time.unix_timestamp_nanos()).ok(),
            // It was done meanwhile.
            Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => None,
            Err(error) => return Err(failed()(error.into())),
        }
    };
    Ok(QueueOverview { records, in_work, oldest_at, leftovers, ..QueueOverview::default() })
}

async fn dead_letters(connection: &Connection) -> Result<u64, ClusterError> {
    match connection.jetstream.get_stream(connection.dead_stream()).await {
        Ok(stream) => Ok(stream.cached_info().state.messages),
        Err(error) => Err(ClusterError::jetstream("look at the dead letters")(error.into())),
    }
}

/// Those that answer in time.
async fn workers(connection: &Connection) -> Result<Vec<WorkerOverview>, ClusterError> {
    let failed = || ClusterError::jetstream("ask for workers");
    let client = &connection.client;
    let inbox = client.new_inbox();
    let mut answers = client.subscribe(inbox.clone()).await.map_err(|error| failed()(error.into()))?;
    let asked = client.publish_with_reply(connection.workers_subject(), inbox, "".into()).await;
    asked.map_err(|error| failed()(error.into()))?;
    let mut workers = Vec::new();
    let collect = async {
        while let Some(answer) = answers.next().await {
            match serde_json::from_slice(&answer.payload) {
                Ok(worker) => workers.push(worker),
                // The server says that nobody listens.
                Err(_) if answer.payload.is_empty() => return,
                Err(error) => tracing::debug!(%error, "failed to read what a worker says of itself"),
            }
        }
    };
    // Who has not answered by then counts as gone.
    let _ = tokio::time::timeout(WORKERS_ANSWER, collect).await;
    workers.sort_by(|one: &WorkerOverview, other| one.name.cmp(&other.name));
    Ok(workers)
}

/// Answers for a worker whenever somebody asks; never returns.
pub(super) async fn answer(connection: Connection, tell: impl Fn() -> WorkerOverview) {
    loop {
        match connection.client.subscribe(connection.workers_subject()).await {
            Err(error) => tracing::warn!(%error, "failed to listen for who asks for workers: trying again"),
            Ok(mut asked) => {
                while let Some(question) = asked.next().await {
                    let Some(to) = question.reply else { continue };
                    // A name and numbers always serialise into memory.
                    let answer = serde_json::to_vec(&tell()).expect("plain fields are JSON");
                    if let Err(error) = connection.client.publish(to, answer.into()).await {
                        tracing::debug!(%error, "failed to answer who asks for workers");
                    }
                }
            }
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

/// A name for a worker that no other one has: the machine's, where it is known, and a number by chance.
pub(super) fn worker_name() -> String {
    let machine = std::env::var("HOSTNAME").ok().filter(|name| !name.is_empty());
    let number = getrandom::u32().unwrap_or_default();
    format!("{}-{number:08x}", machine.as_deref().unwrap_or("worker"))
}
