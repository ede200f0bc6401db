//! The connection to the broker: made, kept, made again.

use std::sync::Arc;
use std::time::Duration;

use rumqttc::Outgoing;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Filter, Packet, Publish, RetainForwardRule, SubscribeReasonCode};
use rumqttc::v5::{AsyncClient, Event, EventLoop};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::{JoinHandle, JoinSet};

use super::delivery::{Delivered, deliver};
use super::error::MqttError;
use super::message::Message;
use super::pending_refusals::PendingRefusals;
use super::refusal::Refusal;
use super::settings::MqttSettings;
use super::topic;
use crate::service::{Feed, FeedCount, Service};

/// Waits before the next connection: the first and the longest.
const FIRST_WAIT: Duration = Duration::from_millis(250);
const MAX_WAIT: Duration = Duration::from_secs(30);

/// What may be on the way to the client library: an acknowledgement and a refusal of every message that a
/// broker can send unacknowledged. Giving it one never waits, because the library may wait for us meanwhile.
const MAX_REQUESTS: usize = 2 * u16::MAX as usize + 8;

/// How often a service that stops looks whether the broker has all refusals.
const LOOK_AGAIN: Duration = Duration::from_millis(10);

/// Records that come from a broker for as long as this is kept.
pub struct MqttFeed {
    feed: Arc<Feed>,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

/// Why a connection ended.
enum End {
    /// The service stops.
    Stopped,
    /// It is lost, or could not be made.
    Lost(String),
}

impl MqttFeed {
    /// Begins to take records in the background; connecting may take as long as it needs.
    ///
    /// Errors: a file that the settings name cannot be used.
    pub fn start(settings: MqttSettings, service: Arc<Service>) -> Result<Self, MqttError> {
        settings.options()?;
        if let Some(share) = &settings.share {
            tracing::warn!(
                share,
                "mqtt.share is set: Mosquitto 2.0.11 loses what a shared subscription has waiting when the broker is started again; \
                 leave it out where the broker is not known to keep it"
            );
        }
        let feed = service.feeds.add("mqtt");
        let (stop, stopped) = watch::channel(false);
        let task = tokio::spawn(keep_connected(settings, service, Arc::clone(&feed), stopped));
        Ok(Self { feed, stop, task })
    }

    /// Takes no more messages, ends within `grace` what was begun, and says goodbye to the broker, which
    /// keeps the rest.
    pub async fn stop(mut self, grace: Duration) {
        // An error says that the task has ended by itself.
        let _ = self.stop.send(true);
        if !self.feed.is_connected() {
            self.task.abort();
        }
        if tokio::time::timeout(grace, &mut self.task).await.is_err() {
            tracing::warn!("failed to end all messages within the time of grace: the broker keeps them");
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
    let mut connections = 0_u64;
    while !*stop.borrow() {
        let before = connections;
        let end = match settings.options() {
            Ok(options) => {
                // Made anew each time: what was under way on the connection before, the broker sends again.
                let (client, events) = AsyncClient::new(options, MAX_REQUESTS);
                let connection = Connection::new(&settings, &service, &feed, client, stop.clone());
                connection.run(events, &mut connections).await
            }
            Err(error) => End::Lost(error.to_string()),
        };
        let End::Lost(reason) = end else { return };
        if connections > before {
            wait = FIRST_WAIT;
        }
        tracing::warn!(broker = settings.broker(), reason, "failed to connect to the MQTT broker");
        feed.lost(reason);
        tokio::select! {
            () = tokio::time::sleep(spread(wait)) => {}
            _ = stop.wait_for(|stop| *stop) => return,
        }
        wait = (2 * wait).min(MAX_WAIT);
    }
}

/// Half of the wait to all of it by chance, so that not all nodes come back to a restarted broker at once.
fn spread(wait: Duration) -> Duration {
    let chance = getrandom::u32().unwrap_or(u32::MAX);
    wait.mul_f64(0.5 + 0.5 * f64::from(chance) / f64::from(u32::MAX))
}

struct Connection<'a> {
    settings: &'a MqttSettings,
    service: &'a Arc<Service>,
    feed: &'a Arc<Feed>,
    client: AsyncClient,
    stop: watch::Receiver<bool>,
    /// One for each message that is held in memory.
    places: Arc<Semaphore>,
    /// Messages came for which there was no place: they come again over the next connection.
    has_left_behind: bool,
    refusals: Arc<PendingRefusals>,
    /// Ends with the connection: nobody could acknowledge for them any more.
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
            places: Arc::new(Semaphore::new(settings.in_flight.into())),
            has_left_behind: false,
            refusals: Arc::default(),
            deliveries: JoinSet::new(),
        }
    }

    /// Works until the connection is lost or the service stops. `connections` counts those that could be
    /// used.
    async fn run(mut self, mut events: EventLoop, connections: &mut u64) -> End {
        self.say_goodbye_when_stopped();
        loop {
            // Never left half-way: a packet that is being written would be lost.
            let event = match events.poll().await {
                Ok(event) => event,
                Err(error) => return End::Lost(error.to_string()),
            };
            match event {
                Event::Incoming(Packet::ConnAck(answer)) => {
                    if answer.session_present {
                        // What the session kept comes before the answer to the subscription.
                        self.feed.connected();
                    }
                    if let Err(error) = self.subscribe().await {
                        return End::Lost(error);
                    }
                }
                Event::Incoming(Packet::SubAck(answer)) => {
                    if let Some(code) = answer
                        .return_codes
                        .iter()
                        .find(|code| !matches!(code, SubscribeReasonCode::Success(QoS::AtLeastOnce)))
                    {
                        let filter = topic::filter(self.settings);
                        return End::Lost(format!(
                            "the broker refused the subscription to {filter} with QoS 1: {code:?}"
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
                Event::Outgoing(Outgoing::Publish(packet_id)) => self.refusals.sent(packet_id),
                Event::Incoming(Packet::PubAck(answer)) => {
                    if let Some((publish, untaken)) = self.refusals.answered(&answer) {
                        if let Some(reason) = untaken {
                            let topic = String::from_utf8_lossy(&publish.topic);
                            tracing::error!(%topic, ?reason, "the broker rejected the refusal of a message");
                        }
                        acknowledge(&self.client, &publish);
                    }
                }
                Event::Outgoing(Outgoing::Disconnect) if *self.stop.borrow() => return End::Stopped,
                Event::Outgoing(Outgoing::Disconnect) => {
                    return End::Lost("messages that found no place are asked for again".to_owned());
                }
                _ => {}
            }
            if self.has_left_behind && self.places.available_permits() == usize::from(self.settings.in_flight)
            {
                // What was taken is acknowledged first. An error says that this was asked for before.
                let _ = self.client.try_disconnect();
            }
            while let Some(ended) = self.deliveries.try_join_next() {
                if ended.is_err() {
                    return End::Lost("a message could not be dealt with: a fault of the program".to_owned());
                }
            }
        }
    }

    async fn subscribe(&self) -> Result<(), String> {
        let mut filter = Filter::new(topic::filter(self.settings), QoS::AtLeastOnce);
        // A kept message was seen when the subscription was made.
        filter.retain_forward_rule = RetainForwardRule::OnNewSubscribe;
        self.client.subscribe_many([filter]).await.map_err(|error| error.to_string())
    }

    /// Deals with a message beside the others.
    ///
    /// Where all places are taken it waits for one, and nothing further is read meanwhile. Only a broker that
    /// sends more than it was told to lets it wait: messages at QoS 0, or what a session kept (seen with
    /// Mosquitto 2.0.11). The connection would not outlive a long wait, so the message is left behind then.
    async fn receive(&mut self, publish: Publish) {
        if *self.stop.borrow() {
            return;
        }
        self.feed.count(FeedCount::Received);
        if publish.dup {
            self.feed.count(FeedCount::Repeated);
        }
        let Some(place) = self.place().await else {
            self.has_left_behind |= publish.qos == QoS::AtLeastOnce;
            return;
        };
        let (service, feed, client) = (self.service.clone(), Arc::clone(self.feed), self.client.clone());
        let (refusals, stop) = (Arc::clone(&self.refusals), self.stop.clone());
        let message = Message::read(self.settings, &publish);
        self.deliveries.spawn(async move {
            let delivered = match &message {
                Ok(message) => deliver(&service, &feed, message, stop).await,
                Err(refusal) => Delivered::Refused(refusal.clone()),
            };
            match delivered {
                Delivered::Safe => {
                    feed.count(FeedCount::Accepted);
                    acknowledge(&client, &publish);
                }
                Delivered::Refused(refusal) => {
                    feed.count(FeedCount::Refused);
                    refuse(&service, &client, &refusals, refusal, publish).await;
                }
                Delivered::LeftBehind => {}
            }
            drop(place);
        });
    }

    async fn place(&self) -> Option<OwnedSemaphorePermit> {
        let places = Arc::clone(&self.places);
        if self.has_left_behind {
            return places.try_acquire_owned().ok();
        }
        let wait = self.settings.keep_alive / 2;
        tokio::time::timeout(wait, places.acquire_owned()).await.ok()?.ok()
    }

    fn say_goodbye_when_stopped(&mut self) {
        let (mut stop, client) = (self.stop.clone(), self.client.clone());
        let (places, refusals) = (Arc::clone(&self.places), Arc::clone(&self.refusals));
        let all = u32::from(self.settings.in_flight);
        self.deliveries.spawn(async move {
            // An error says that nobody is left who could ask for it.
            if stop.wait_for(|stop| *stop).await.is_ok() && places.acquire_many(all).await.is_ok() {
                while !refusals.is_empty() {
                    tokio::time::sleep(LOOK_AGAIN).await;
                }
                let _ = client.try_disconnect();
            }
        });
    }
}

/// Tells the sender that its message cannot be used.
async fn refuse(
    service: &Arc<Service>,
    client: &AsyncClient,
    refusals: &PendingRefusals,
    refusal: Refusal,
    mut publish: Publish,
) {
    let topic = String::from_utf8_lossy(&publish.topic).into_owned();
    tracing::warn!(topic, reason = refusal.detail(), "refused a message");
    let payload = std::mem::take(&mut publish.payload);
    let (received_at, of) = (service.now(), topic.clone());
    // The payload's hash takes its time.
    let letter = tokio::task::spawn_blocking(move || refusal.letter(&of, received_at, &payload));
    if let Ok(letter) = letter.await
        && let Err(error) = refusals.send(client, topic::rejected(&topic), letter, publish)
    {
        // Most often the connection is gone. Not acknowledged, the message comes again.
        tracing::debug!(%error, topic, "failed to send the refusal of a message");
    }
}

/// Acknowledges a message. An error says that the connection is gone: the broker sends the message again.
fn acknowledge(client: &AsyncClient, publish: &Publish) {
    let _ = client.try_ack(publish);
}
