//! Live events, published by every process and shown by every API node: a stream of JetStream gives them one
//! order.
//!
//! A process that cannot reach NATS keeps its events, up to a bound; beyond it the oldest are lost, and an
//! event says so.

use std::collections::VecDeque;
use std::time::Duration;

use async_nats::jetstream::consumer::{DeliverPolicy, OrderedPullConsumer, pull};
use async_nats::jetstream::stream::Stream;
use futures_util::StreamExt;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;

use super::ClusterError;
use super::connection::Connection;
use crate::service::{LiveEvent, NumberedEvent};

/// Events that wait for NATS.
const MAX_WAITING: usize = 4096;

/// Events sent before the first of them is acknowledged.
const SENT_AT_ONCE: usize = 256;

/// How long what happened before is waited for at the start.
const BACKLOG_TIMEOUT: Duration = Duration::from_secs(5);

/// What all processes publish, from now on and shortly before.
pub struct Subscription {
    /// Identifies this order of events.
    pub run: String,
    /// What happened before.
    pub backlog: Vec<NumberedEvent>,
    /// What happens from then on.
    pub receiver: mpsc::Receiver<NumberedEvent>,
}

/// Publishes what this process announces, until nobody announces any more.
pub(super) async fn publish(connection: Connection, mut announced: Receiver<LiveEvent>) {
    let mut waiting: VecDeque<LiveEvent> = VecDeque::new();
    let mut lost = 0;
    let mut is_over = false;
    while !(is_over && waiting.is_empty()) {
        if waiting.is_empty() {
            match announced.recv().await {
                Ok(event) => waiting.push_back(event),
                Err(RecvError::Lagged(count)) => waiting.push_back(LiveEvent::Lost(count)),
                Err(RecvError::Closed) => is_over = true,
            }
        }
        // What came meanwhile goes with it.
        while let Ok(event) = announced.try_recv() {
            waiting.push_back(event);
        }
        while waiting.len() > MAX_WAITING {
            waiting.pop_front();
            lost += 1;
        }
        if lost > 0 {
            waiting.push_front(LiveEvent::Lost(std::mem::take(&mut lost)));
        }
        if let Err(error) = send(&connection, &mut waiting).await {
            tracing::debug!(%error, waiting = waiting.len(), "failed to publish events: trying again");
            if is_over {
                return;
            }
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
    }
}

/// Sends what waits; what is not acknowledged stays.
async fn send(connection: &Connection, waiting: &mut VecDeque<LiveEvent>) -> Result<(), ClusterError> {
    let failed = || ClusterError::jetstream("publish events");
    while !waiting.is_empty() {
        if let Some(fault) = connection.fault() {
            return Err(failed()(fault.into()));
        }
        let mut sent = Vec::new();
        for event in waiting.iter().take(SENT_AT_ONCE) {
            let payload = serde_json::to_vec(event).map_err(|error| failed()(error.into()))?;
            let told = connection.jetstream.publish(connection.events_subject(), payload.into()).await;
            sent.push(told.map_err(|error| failed()(error.into()))?);
        }
        for acknowledgement in sent {
            acknowledgement.await.map_err(|error| failed()(error.into()))?;
            waiting.pop_front();
        }
    }
    Ok(())
}

/// Subscribes to what all processes publish. Where NATS does not answer now, events come when it does.
pub(super) async fn subscribe(connection: Connection) -> Subscription {
    let (sender, receiver) = mpsc::channel(1024);
    let first = tokio::time::timeout(BACKLOG_TIMEOUT, begin(&connection)).await;
    let (run, backlog, begun) = match first {
        Ok(Ok(begun)) => begun,
        Ok(Err(error)) => {
            tracing::warn!(%error, "failed to read earlier events");
            (String::from("0"), Vec::new(), None)
        }
        Err(_) => {
            tracing::warn!("failed to read earlier events: NATS does not answer");
            (String::from("0"), Vec::new(), None)
        }
    };
    let after = backlog.last().map_or(0, |event| event.number);
    tokio::spawn(go_on(connection, begun, after, sender));
    Subscription { run, backlog, receiver }
}

type Begun = (String, Vec<NumberedEvent>, Option<pull::Ordered>);

async fn begin(connection: &Connection) -> Result<Begun, ClusterError> {
    let mut stream = events(connection).await?;
    let info =
        stream.info().await.map_err(|error| ClusterError::jetstream("look at the events")(error.into()))?;
    let (run, last, held) =
        (format!("{:x}", info.created.unix_timestamp_nanos()), info.state.last_sequence, info.state.messages);
    let mut told = follow(&stream, 0).await?;
    let mut backlog = Vec::new();
    while held > 0 && backlog.last().is_none_or(|event: &NumberedEvent| event.number < last) {
        match told.next().await {
            Some(Ok(message)) => backlog.extend(read(&message)),
            Some(Err(error)) => return Err(ClusterError::jetstream("read the events")(error.into())),
            None => break,
        }
    }
    Ok((run, backlog, Some(told)))
}

async fn go_on(
    connection: Connection,
    begun: Option<pull::Ordered>,
    mut after: u64,
    sender: mpsc::Sender<NumberedEvent>,
) {
    let mut told = begun;
    loop {
        let Some(following) = &mut told else {
            let again = async { follow(&events(&connection).await?, after).await };
            match again.await {
                Ok(following) => told = Some(following),
                Err(error) => {
                    tracing::debug!(%error, "failed to subscribe to events: trying again");
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
            }
            continue;
        };
        let next = tokio::select! {
            next = following.next() => next,
            () = sender.closed() => return,
        };
        match next {
            Some(Ok(message)) => {
                let Some(event) = read(&message) else { continue };
                after = event.number;
                if sender.send(event).await.is_err() {
                    return;
                }
            }
            Some(Err(error)) => {
                tracing::debug!(%error, "failed to read events: subscribing again");
                told = None;
            }
            None => told = None,
        }
    }
}

async fn events(connection: &Connection) -> Result<Stream, ClusterError> {
    let stream = connection.jetstream.get_stream(connection.events_stream()).await;
    stream.map_err(|error| ClusterError::jetstream("find the events")(error.into()))
}

async fn follow(stream: &Stream, after: u64) -> Result<pull::Ordered, ClusterError> {
    let failed = ClusterError::jetstream("follow the events");
    let config = pull::OrderedConfig {
        deliver_policy: if after == 0 {
            DeliverPolicy::All
        } else {
            DeliverPolicy::ByStartSequence { start_sequence: after + 1 }
        },
        ..pull::OrderedConfig::default()
    };
    let consumer: OrderedPullConsumer = match stream.create_consumer(config).await {
        Ok(consumer) => consumer,
        Err(error) => return Err(failed(error.into())),
    };
    consumer.messages().await.map_err(|error| failed(error.into()))
}

/// An event of the stream; none where a node of another version sent it.
fn read(message: &async_nats::jetstream::Message) -> Option<NumberedEvent> {
    let number = message.info().ok()?.stream_sequence;
    let event = serde_json::from_slice(&message.payload)
        .inspect_err(|error| tracing::debug!(number, %error, "failed to read an event of another node"))
        .ok()?;
    Some(NumberedEvent { number, event })
}
