//! The connection to the broker, with reconnects.

use std::sync::Arc;
use std::time::{Duration, Instant};

use rumqttc::Outgoing;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Filter, Packet, Publish, RetainForwardRule, SubscribeReasonCode};
use rumqttc::v5::{AsyncClient, Event, EventLoop};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::{JoinHandle, JoinSet};

use super::delivery::{DeliveryOutcome, deliver};
use super::error::MqttError;
use super::incoming::{Incoming, acknowledge};
use super::message::Message;
use super::pending_rejections::PendingRejections;
use super::settings::MqttSettings;
use super::stream_blocks::StreamBlocks;
use super::topic::{self, Content};
use crate::service::{Feed, FeedCount, Service};

/// First and longest wait before a reconnect.
const FIRST_WAIT: Duration = Duration::from_millis(250);
const MAX_WAIT: Duration = Duration::from_secs(30);

/// A connection that lasted this long was not ended by another client with the same identifier.
const STABLE_AFTER: Duration = Duration::from_secs(10);

/// Number of shorter connections in a row after which such a client is suspected.
const SUSPICIOUS: u32 = 3;

/// Capacity of the client library's request queue: an acknowledgement and a rejection for every message that
/// a broker can send unacknowledged. Adding a request must never wait, as the library may be waiting for us.
const MAX_REQUESTS: usize = 2 * u16::MAX as usize + 8;

/// Interval at which a stopping service checks whether the broker has all rejections.
const STOP_POLL_INTERVAL: Duration = Duration::from_millis(10);

/// A feed of records from a broker, which runs in the background until it is stopped or dropped.
pub struct MqttFeed {
    feed: Arc<Feed>,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

/// How a connection ended.
enum End {
    /// The service stops.
    Stopped,
    /// It was lost, or could not be established.
    Lost(String),
}

impl MqttFeed {
    /// Starts to connect and to take records, in the background.
    ///
    /// # Errors
    /// A file of the settings cannot be read or is invalid.
    pub fn start(settings: MqttSettings, service: Arc<Service>) -> Result<Self, MqttError> {
        settings.options()?;
        if let Some(share) = &settings.share {
            tracing::warn!(
                share,
                "mqtt.share is set: when Mosquitto 2.0.11 restarts, it loses the queued messages of a shared subscription; \
                 omit it unless the broker is known to keep them"
            );
        }
        let feed = service.feeds.add("mqtt");
        let (stop, stopped) = watch::channel(false);
        let task = tokio::spawn(keep_connected(settings, service, Arc::clone(&feed), stopped));
        Ok(Self { feed, stop, task })
    }

    /// Stops taking messages, finishes those in progress within `grace`, and disconnects from the broker,
    /// which keeps the rest.
    pub async fn stop(mut self, grace: Duration) {
        // An error means that the task has ended already.
        let _ = self.stop.send(true);
        if !self.feed.is_connected() {
            self.task.abort();
        }
        if tokio::time::timeout(grace, &mut self.task).await.is_err() {
            tracing::warn!("failed to finish all messages within the grace period; the broker keeps them");
            self.task.abort();
        }
        self.feed.lost("stopped".to_owned());
    }
}

async fn keep_connected(
    settings: MqttSettings,
    service: Arc<Service>,
    feed: Arc<Feed>,
    mut stop: watch::Receiver<bool>,
) {
    let mut wait = FIRST_WAIT;
    let (mut connections, mut short) = (0_u64, 0);
    while !*stop.borrow() {
        let (before, began) = (connections, Instant::now());
        let end = match settings.options() {
            Ok(options) => {
                // A new client for each connection: the broker sends unacknowledged messages again.
                let (client, events) = AsyncClient::new(options, MAX_REQUESTS);
                let connection = Connection::new(&settings, &service, &feed, client, stop.clone());
                connection.run(events, &mut connections).await
            }
            Err(error) => End::Lost(error.to_string()),
        };
        let End::Lost(mut reason) = end else { return };
        if connections > before {
            short += 1;
            if began.elapsed() >= STABLE_AFTER {
                (wait, short) = (FIRST_WAIT, 0);
            } else if short >= SUSPICIOUS {
                let id = settings.client_id();
                reason += &format!("; if another service uses mqtt.client_id {id:?} too, give each its own");
            }
            tracing::warn!(
                broker = settings.broker(),
                reason,
                "the connection to the MQTT broker ended: connecting again"
            );
        } else {
            tracing::warn!(
                broker = settings.broker(),
                reason,
                "failed to connect to the MQTT broker; retrying"
            );
        }
        feed.lost(reason);
        tokio::select! {
            () = tokio::time::sleep(jitter(wait)) => {}
            _ = stop.wait_for(|stop| *stop) => return,
        }
        wait = (2 * wait).min(MAX_WAIT);
    }
}

/// Returns a random time between half of the wait and all of it, so that nodes don't reconnect to a restarted
/// broker all at once.
fn jitter(wait: Duration) -> Duration {
    let random = getrandom::u32().unwrap_or(u32::MAX);
    wait.mul_f64(0.5 + 0.5 * f64::from(random) / f64::from(u32::MAX))
}

struct Connection<'a> {
    settings: &'a MqttSettings,
    service: &'a Arc<Service>,
    feed: &'a Arc<Feed>,
    client: AsyncClient,
    stop: watch::Receiver<bool>,
    /// One permit for each message in memory.
    slots: Arc<Semaphore>,
    /// Whether messages were dropped for lack of a slot: the broker sends them again over the next
    /// connection.
    has_dropped: bool,
    rejections: Arc<PendingRejections>,
    streams: StreamBlocks,
    /// Aborted with the connection, without which they could not acknowledge.
    deliveries: JoinSet<()>,
}

impl<'a> Connection<'a> {
    fn new(
        settings: &'a MqttSettings,
        service: &'a Arc<Service>,
        feed: &'a Arc<Feed>,
        client: AsyncClient,
        stop: watch::Receiver<bool>,
    ) -> Self {
        Self {
            settings,
            service,
            feed,
            client,
            stop,
            slots: Arc::new(Semaphore::new(settings.in_flight.into())),
            has_dropped: false,
            rejections: Arc::default(),
            streams: StreamBlocks::default(),
            deliveries: JoinSet::new(),
        }
    }

    /// Runs until the connection is lost or the service stops. `connections` counts successful subscriptions.
    async fn run(mut self, mut events: EventLoop, connections: &mut u64) -> End {
        self.disconnect_when_stopped();
        loop {
            // Not cancelled by a `select!`: a partly written packet would be lost.
            let event = match events.poll().await {
                Ok(event) => event,
                Err(error) => return End::Lost(error.to_string()),
            };
            match event {
                Event::Incoming(Packet::ConnAck(ack)) => {
                    if ack.session_present {
                        // The session's messages arrive before the acknowledgement of the subscription.
                        self.feed.connected();
                    }
                    if let Err(error) = self.subscribe().await {
                        return End::Lost(error);
                    }
                }
                Event::Incoming(Packet::SubAck(ack)) => {
                    if let Some(code) = ack
                        .return_codes
                        .iter()
                        .find(|code| !matches!(code, SubscribeReasonCode::Success(QoS::AtLeastOnce)))
                    {
                        let filters = topic::filters(self.settings).join(" and ");
                        return End::Lost(format!(
                            "the broker rejected the subscription to {filters} with QoS 1: {code:?}"
                        ));
                    }
                    *connections += 1;
                    if *connections > 1 {
                        self.feed.count(FeedCount::Reconnected);
                    }
                    tracing::info!(broker = self.settings.broker(), "connected to the MQTT broker");
                    self.feed.connected();
                }
                Event::Incoming(Packet::Publish(publish)) => self.receive(publish).await,
                Event::Outgoing(Outgoing::Publish(packet_id)) => self.rejections.sent(packet_id),
                Event::Incoming(Packet::PubAck(ack)) => {
                    if let Some((publish, error)) = self.rejections.acknowledged(&ack) {
                        if let Some(reason) = error {
                            let topic = String::from_utf8_lossy(&publish.topic);
                            tracing::error!(%topic, ?reason, "failed to publish the rejection of a message");
                        }
                        acknowledge(&self.client, &publish);
                    }
                }
                Event::Outgoing(Outgoing::Disconnect) if *self.stop.borrow() => return End::Stopped,
                Event::Outgoing(Outgoing::Disconnect) => {
                    return End::Lost("reconnecting to receive dropped messages again".to_owned());
                }
                _ => {}
            }
            if self.has_dropped && self.slots.available_permits() == usize::from(self.settings.in_flight) {
                // All other messages are acknowledged. An error means that a disconnect is already pending.
                let _ = self.client.try_disconnect();
            }
            while let Some(ended) = self.deliveries.try_join_next() {
                if ended.is_err() {
                    return End::Lost("a message handler panicked".to_owned());
                }
            }
        }
    }

    async fn subscribe(&self) -> Result<(), String> {
        let filters = topic::filters(self.settings).map(|topics| {
            let mut filter = Filter::new(topics, QoS::AtLeastOnce);
            // A retained message was received when the subscription was first made.
            filter.retain_forward_rule = RetainForwardRule::OnNewSubscribe;
            filter
        });
        self.client.subscribe_many(filters).await.map_err(|error| error.to_string())
    }

    /// Handles a record in a task of its own, and a block in the task of its stream.
    ///
    /// Where no slot is free it waits for one, and no further packet is read meanwhile. That happens only if
    /// the broker exceeds the receive maximum: with messages at QoS 0, or with those of a session (seen with
    /// Mosquitto 2.0.11). The connection would not survive a long wait, so the message is dropped after a
    /// timeout.
    async fn receive(&mut self, publish: Publish) {
        if *self.stop.borrow() {
            return;
        }
        self.feed.count(FeedCount::Received);
        if publish.dup {
            self.feed.count(FeedCount::Repeated);
        }
        let Some(slot) = self.acquire_slot().await else {
            self.has_dropped |= publish.qos == QoS::AtLeastOnce;
            return;
        };
        let message = Message::read(self.settings, &publish);
        let is_block = message.as_ref().is_ok_and(|message| message.content == Content::Block);
        if self.has_dropped && is_block {
            // Its predecessor may be among the dropped ones, and would count as lost.
            return;
        }
        let incoming = Incoming {
            service: Arc::clone(self.service),
            feed: Arc::clone(self.feed),
            client: self.client.clone(),
            rejections: Arc::clone(&self.rejections),
            publish,
            _slot: slot,
        };
        let stop = self.stop.clone();
        match message {
            Ok(message) if is_block => {
                self.streams.pass(message, incoming, stop, &mut self.deliveries);
            }
            Ok(message) => {
                self.deliveries.spawn(async move {
                    let outcome = deliver(&incoming.service, &incoming.feed, &message, stop).await;
                    incoming.finish(outcome).await;
                });
            }
            Err(rejection) => {
                self.deliveries.spawn(incoming.finish(DeliveryOutcome::Rejected(rejection)));
            }
        }
    }

    async fn acquire_slot(&self) -> Option<OwnedSemaphorePermit> {
        let slots = Arc::clone(&self.slots);
        if self.has_dropped {
            return slots.try_acquire_owned().ok();
        }
        let wait = self.settings.keep_alive / 2;
        tokio::time::timeout(wait, slots.acquire_owned()).await.ok()?.ok()
    }

    fn disconnect_when_stopped(&mut self) {
        let (mut stop, client) = (self.stop.clone(), self.client.clone());
        let (slots, rejections) = (Arc::clone(&self.slots), Arc::clone(&self.rejections));
        let all = u32::from(self.settings.in_flight);
        self.deliveries.spawn(async move {
            // An error means that the feed was dropped without a stop.
            if stop.wait_for(|stop| *stop).await.is_ok() && slots.acquire_many(all).await.is_ok() {
                while !rejections.is_empty() {
                    tokio::time::sleep(STOP_POLL_INTERVAL).await;
                }
                let _ = client.try_disconnect();
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mqtt::settings::{MqttCredentials, MqttTable};
    use crate::service::{Role, ServiceFolders, SystemClock};
    use crate::store::Store;

    fn publish(topic: &str) -> Publish {
        Publish::new(topic, QoS::AtLeastOnce, "{}", None)
    }

    #[tokio::test]
    async fn a_block_after_a_dropped_message_is_dropped_too() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().into()).await.unwrap();
        let folders = ServiceFolders::in_data_folder(folder.path());
        let clock = Arc::new(SystemClock);
        let service =
            Service::new(store, folders, &Default::default(), Default::default(), clock, Role::Standalone);
        let service = service.unwrap();
        let table: MqttTable = toml::from_str("url = \"mqtt://127.0.0.1:1\"\nin_flight = 1").unwrap();
        let mut settings = table.resolve(MqttCredentials::default(), 1 << 20).unwrap();
        let (client, _events) = AsyncClient::new(settings.options().unwrap(), 8);
        settings.keep_alive = Duration::from_millis(20);
        let (_stop, stopped) = watch::channel(false);
        let feed = service.feeds.add("mqtt");
        let mut connection = Connection::new(&settings, &service, &feed, client, stopped);

        let slot = connection.acquire_slot().await;
        connection.receive(publish("flankwatch/pump/in/samples")).await;
        assert!(connection.has_dropped);
        drop(slot);
        connection.receive(publish("flankwatch/pump/in/samples")).await;
        assert!(connection.deliveries.is_empty());
        connection.receive(publish("flankwatch/pump/in/waveform")).await;
        assert_eq!(connection.deliveries.len(), 1);
        service.store.close().await;
    }
}
