//! Live events: every process publishes them and every API node shows them; a JetStream stream orders them.
//!
//! A process that cannot reach NATS buffers its events. When the buffer is full, the oldest are dropped and
//! an event reports the loss.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use async_nats::jetstream::consumer::{DeliverPolicy, OrderedPullConsumer, pull};
use async_nats::jetstream::stream::Stream;
use futures_util::StreamExt;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::mpsc;

use super::ClusterError;
use super::connection::Connection;
use crate::service::{LiveEvent, NumberedEvent, SharedEvents};

/// Maximum number of events buffered while NATS is unavailable.
const MAX_WAITING: usize = 4096;

/// Number of events sent before their acknowledgements are awaited.
const BATCH: usize = 256;

/// Timeout for reading earlier events at the start.
const BACKLOG_TIMEOUT: Duration = Duration::from_secs(5);

/// Interval of checks whether the stream was created anew.
const CHECK_INTERVAL: Duration = Duration::from_secs(5);

/// Publishes this process's events until its last sender is dropped.
pub(super) async fn publish(connection: Connection, mut events: Receiver<LiveEvent>) {
    let mut waiting: VecDeque<LiveEvent> = VecDeque::new();
    let mut lost = 0;
    let mut is_over = false;
    while !(is_over && waiting.is_empty()) {
        if waiting.is_empty() {
            match events.recv().await {
                Ok(event) => waiting.push_back(event),
                Err(RecvError::Lagged(count)) => waiting.push_back(LiveEvent::Lost(count)),
                Err(RecvError::Closed) => is_over = true,
            }
        }
        // Adds the events that arrived meanwhile.
        collect(&mut events, &mut waiting);
        while waiting.len() > MAX_WAITING {
            lost += match waiting.pop_front() {
                Some(LiveEvent::Lost(count)) => count,
                _ => 1,
            };
        }
        if lost > 0 {
            waiting.push_front(LiveEvent::Lost(std::mem::take(&mut lost)));
        }
        if let Err(error) = send(&connection, &mut waiting).await {
            tracing::debug!(%error, waiting = waiting.len(), "failed to publish events; retrying");
            if is_over {
                return;
            }
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
    }
}

/// Takes the events sent so far, and the number of those lost in between.
fn collect(events: &mut Receiver<LiveEvent>, waiting: &mut VecDeque<LiveEvent>) {
    loop {
        match events.try_recv() {
            Ok(event) => waiting.push_back(event),
            Err(TryRecvError::Lagged(count)) => waiting.push_back(LiveEvent::Lost(count)),
            Err(TryRecvError::Empty | TryRecvError::Closed) => return,
        }
    }
}

/// Sends the waiting events; those that are not acknowledged stay.
async fn send(connection: &Connection, waiting: &mut VecDeque<LiveEvent>) -> Result<(), ClusterError> {
    let failed = || ClusterError::jetstream("publish events");
    while !waiting.is_empty() {
        if let Some(fault) = connection.fault() {
            return Err(failed()(fault.into()));
        }
        let mut sent = Vec::new();
        for event in waiting.iter().take(BATCH) {
            let payload = serde_json::to_vec(event).map_err(|error| failed()(error.into()))?;
            let published = connection.jetstream.publish(connection.events_subject(), payload.into()).await;
            sent.push(published.map_err(|error| failed()(error.into()))?);
        }
        for acknowledgement in sent {
            acknowledgement.await.map_err(|error| failed()(error.into()))?;
            waiting.pop_front();
        }
    }
    Ok(())
}

/// Subscribes to the events of all processes. Where NATS does not answer, events arrive once it does.
pub(super) async fn subscribe(connection: Connection) -> SharedEvents {
    let (sender, receiver) = mpsc::channel(1024);
    let read = tokio::time::timeout(BACKLOG_TIMEOUT, read_backlog(&connection)).await;
    let (run, backlog, messages) = match read {
        Ok(Ok(read)) => read,
        Ok(Err(error)) => {
            tracing::warn!(%error, "failed to read earlier events");
            (Arc::from("0"), Vec::new(), None)
        }
        Err(_) => {
            tracing::warn!("failed to read earlier events: NATS does not answer");
            (Arc::from("0"), Vec::new(), None)
        }
    };
    let after = backlog.last().map_or(0, |event| event.number);
    tokio::spawn(forward(connection, Arc::clone(&run), messages, after, sender));
    SharedEvents { run, backlog, receiver }
}

/// The run, the backlog and the messages after it.
type Backlog = (Arc<str>, Vec<NumberedEvent>, Option<pull::Ordered>);

async fn read_backlog(connection: &Connection) -> Result<Backlog, ClusterError> {
    let mut stream = events(connection).await?;
    let info = stream
        .info()
        .await
        .map_err(|error| ClusterError::jetstream("read the state of the events")(error.into()))?;
    let (last, stored) = (info.state.last_sequence, info.state.messages);
    let run = run_of(&stream);
    let mut messages = consume(&stream, 0).await?;
    let (mut backlog, mut number) = (Vec::new(), 0);
    while stored > 0 && number < last {
        match messages.next().await {
            Some(Ok(message)) => {
                // Counted even where the event cannot be read.
                number = message.info().map_or(last, |info| info.stream_sequence);
                backlog.extend(read(&run, &message));
            }
            Some(Err(error)) => return Err(ClusterError::jetstream("read the events")(error.into())),
            None => break,
        }
    }
    Ok((run, backlog, Some(messages)))
}

/// Forwards events after number `after` to `sender` until it is closed; subscribes again after errors, and to
/// a stream that was created anew from its first event on.
async fn forward(
    connection: Connection,
    mut run: Arc<str>,
    mut messages: Option<pull::Ordered>,
    mut after: u64,
    sender: mpsc::Sender<NumberedEvent>,
) {
    let mut check = tokio::time::interval(CHECK_INTERVAL);
    loop {
        let Some(current) = &mut messages else {
            let subscribed = async {
                let stream = events(&connection).await?;
                let found = run_of(&stream);
                if found != run {
                    (run, after) = (found, 0);
                }
                consume(&stream, after).await
            };
            match subscribed.await {
                Ok(new) => messages = Some(new),
                Err(error) => {
                    tracing::debug!(%error, "failed to subscribe to events; retrying");
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
            }
            continue;
        };
        let next = tokio::select! {
            next = current.next() => next,
            _ = check.tick() => {
                // A consumer goes on with the new stream by itself, but waits for the numbers of the old one.
                if events(&connection).await.is_ok_and(|stream| run_of(&stream) != run) {
                    messages = None;
                }
                continue;
            }
            () = sender.closed() => return,
        };
        match next {
            Some(Ok(message)) => {
                let Some(event) = read(&run, &message) else { continue };
                after = event.number;
                if sender.send(event).await.is_err() {
                    return;
                }
            }
            Some(Err(error)) => {
                tracing::debug!(%error, "failed to read events; subscribing again");
                messages = None;
            }
            None => messages = None,
        }
    }
}

async fn events(connection: &Connection) -> Result<Stream, ClusterError> {
    let stream = connection.jetstream.get_stream(connection.events_stream()).await;
    stream.map_err(|error| ClusterError::jetstream("find the events")(error.into()))
}

/// Identifies a stream: one created anew under its name is another one.
fn run_of(stream: &Stream) -> Arc<str> {
    format!("{:x}", stream.cached_info().created.unix_timestamp_nanos()).into()
}

async fn consume(stream: &Stream, after: u64) -> Result<pull::Ordered, ClusterError> {
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

/// Reads an event of the stream; `None` where a node of another version sent it.
fn read(run: &Arc<str>, message: &async_nats::jetstream::Message) -> Option<NumberedEvent> {
    let number = message.info().ok()?.stream_sequence;
    let event = serde_json::from_slice(&message.payload)
        .inspect_err(|error| tracing::debug!(number, %error, "failed to read an event of another node"))
        .ok()?;
    Some(NumberedEvent { run: Arc::clone(run), number, event })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::AssetId;

    #[test]
    fn events_lost_before_they_were_taken_are_counted() {
        let (sender, mut events) = tokio::sync::broadcast::channel(2);
        for _ in 0..5 {
            sender.send(LiveEvent::AssetChanged(AssetId::new("pump").unwrap())).unwrap();
        }
        let mut waiting = VecDeque::new();
        collect(&mut events, &mut waiting);
        assert_eq!(waiting.len(), 3);
        assert!(matches!(waiting[0], LiveEvent::Lost(3)), "{:?}", waiting[0]);
    }
}
