//! What happens, told by every process and shown by every API node: a stream of JetStream gives it one order.
//!
//! A process that cannot reach NATS keeps what it has to tell, up to a bound; beyond it the oldest is given up, and that is told instead.

use std::collections::VecDeque;
use std::time::Duration;

use async_nats::header::HeaderMap;
use async_nats::jetstream::consumer::{DeliverPolicy, OrderedPullConsumer, pull};
use async_nats::jetstream::stream::Stream;
use futures_util::StreamExt;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;

use super::ClusterError;
use super::connection::Connection;
use crate::asset::AssetId;
use crate::ingest::{Announcement, LiveEvent, NumberedEvent};

const KIND: &str = "Flankwatch-Kind";
const ASSET: &str = "Flankwatch-Asset";

/// Events that wait for NATS.
const MOST_KEPT_BACK: usize = 4096;

/// Events sent before the first of them is acknowledged.
const SENT_AT_ONCE: usize = 256;

/// How long what happened before is waited for at the start.
const BACKLOG_TIMEOUT: Duration = Duration::from_secs(5);

/// How an announcement is put into words, and how it is told that some were not.
#[derive(Clone, Copy)]
pub struct Words {
    /// The words for an announcement.
    pub of: fn(&Announcement) -> Vec<LiveEvent>,
    /// The words for so many events that are not told.
    pub lost: fn(u64) -> LiveEvent,
}

/// What all processes tell, from now on and shortly before.
pub struct Heard {
    /// Tells this order from others.
    pub run: String,
    /// What happened before.
    pub backlog: Vec<NumberedEvent>,
    /// What happens from then on.
    pub receiver: mpsc::Receiver<NumberedEvent>,
}

/// Tells what this process announces, until nobody announces any more.
pub(super) async fn tell(connection: Connection, mut announcements: Receiver<Announcement>, words: Words) {
    let mut waiting: VecDeque<LiveEvent> = VecDeque::new();
    let mut lost = 0;
    let mut is_over = false;
    while !(is_over && waiting.is_empty()) {
        if waiting.is_empty() {
            is_over = !take(announcements.recv().await, words, &mut waiting);
        }
        // What came meanwhile goes with it.
        while let Ok(announcement) = announcements.try_recv() {
            waiting.extend((words.of)(&announcement));
        }
        while waiting.len() > MOST_KEPT_BACK {
            waiting.pop_front();
            lost += 1;
        }
        if lost > 0 {
            waiting.push_front((words.lost)(std::mem::take(&mut lost)));
        }
        if let Err(error) = send(&connection, &mut waiting).await {
            tracing::debug!(%error, waiting = waiting.len(), "events wait for NATS");
            if is_over {
                return;
            }
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
    }
}

/// Takes one announcement; false where there will be no more.
fn take(received: Result<Announcement, RecvError>, words: Words, waiting: &mut VecDeque<LiveEvent>) -> bool {
    match received {
        Ok(announcement) => waiting.extend((words.of)(&announcement)),
        Err(RecvError::Lagged(count)) => waiting.push_back((words.lost)(count)),
        Err(RecvError::Closed) => return false,
    }
    true
}

/// Sends what waits; what is not acknowledged stays.
async fn send(connection: &Connection, waiting: &mut VecDeque<LiveEvent>) -> Result<(), ClusterError> {
    let failed = || ClusterError::jetstream("tell what happened");
    while !waiting.is_empty() {
        if let Some(fault) = connection.fault() {
            return Err(failed()(fault.into()));
        }
        let mut sent = Vec::new();
        for event in waiting.iter().take(SENT_AT_ONCE) {
            let mut headers = HeaderMap::new();
            headers.insert(KIND, event.kind.as_str());
            if let Some(asset) = &event.asset {
                headers.insert(ASSET, asset.as_str());
            }
            let payload = event.data.clone().into();
            let told = connection
                .jetstream
                .publish_with_headers(connection.events_subject(), headers, payload)
                .await;
            sent.push(told.map_err(|error| failed()(error.into()))?);
        }
        for acknowledgement in sent {
            acknowledgement.await.map_err(|error| failed()(error.into()))?;
            waiting.pop_front();
        }
    }
    Ok(())
}

/// Hears what all processes tell. Where NATS does not answer now, it is heard when it does.
pub(super) async fn hear(connection: Connection) -> Heard {
    let (sender, receiver) = mpsc::channel(1024);
    let first = tokio::time::timeout(BACKLOG_TIMEOUT, begin(&connection)).await;
    let (run, backlog, begun) = match first {
        Ok(Ok(begun)) => begun,
        Ok(Err(error)) => {
            tracing::warn!(%error, "what happened before is not known");
            (String::from("0"), Vec::new(), None)
        }
        Err(_) => {
            tracing::warn!("what happened before is not known: NATS does not answer");
            (String::from("0"), Vec::new(), None)
        }
    };
    let after = backlog.last().map_or(0, |event| event.number);
    tokio::spawn(go_on(connection, begun, after, sender));
    Heard { run, backlog, receiver }
}

type Begun = (String, Vec<NumberedEvent>, Option<pull::Ordered>);

async fn begin(connection: &Connection) -> Result<Begun, ClusterError> {
    let mut stream = events(connection).await?;
    let info = stream
        .info()
        .await
        .map_err(|error| ClusterError::jetstream("look at the events")(error.into()))?;
    let (run, last, held) = (
        format!("{:x}", info.created.unix_timestamp_nanos()),
        info.state.last_sequence,
        info.state.messages,
    );
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

async fn go_on(connection: Connection, begun: Option<pull::Ordered>, mut after: u64, sender: mpsc::Sender<NumberedEvent>) {
    let mut told = begun;
    loop {
        let Some(following) = &mut told else {
            let again = async { follow(&events(&connection).await?, after).await };
            match again.await {
                Ok(following) => told = Some(following),
                Err(error) => {
                    tracing::debug!(%error, "events not heard yet");
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
                tracing::debug!(%error, "events are heard again");
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

fn read(message: &async_nats::jetstream::Message) -> Option<NumberedEvent> {
    let number = message.info().ok()?.stream_sequence;
    let headers = message.headers.as_ref()?;
    let kind = headers.get(KIND)?.as_str().to_owned();
    let asset = headers.get(ASSET).and_then(|asset| AssetId::new(asset.as_str()).ok());
    let data = String::from_utf8(message.payload.to_vec()).ok()?;
    Some(NumberedEvent {
        number,
        event: LiveEvent { kind, asset, data },
    })
}
