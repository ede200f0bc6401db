//! A received message that is not acknowledged yet.

use std::sync::Arc;

use rumqttc::v5::AsyncClient;
use rumqttc::v5::mqttbytes::v5::Publish;
use tokio::sync::OwnedSemaphorePermit;

use super::delivery::DeliveryOutcome;
use super::pending_rejections::PendingRejections;
use super::rejection::Rejection;
use super::topic;
use crate::service::{Feed, FeedCount, Service};

/// A received message that is not acknowledged yet. If it is dropped, the broker sends it again over the next
/// connection.
pub(super) struct Incoming {
    pub(super) service: Arc<Service>,
    pub(super) feed: Arc<Feed>,
    pub(super) client: AsyncClient,
    pub(super) rejections: Arc<PendingRejections>,
    pub(super) publish: Publish,
    /// Its place among the messages in memory.
    pub(super) _slot: OwnedSemaphorePermit,
}

impl Incoming {
    /// Acknowledges the message, or rejects it first.
    pub(super) async fn finish(self, outcome: DeliveryOutcome) {
        match outcome {
            DeliveryOutcome::Stored => {
                self.feed.count(FeedCount::Accepted);
                acknowledge(&self.client, &self.publish);
            }
            DeliveryOutcome::Rejected(rejection) => {
                self.feed.count(FeedCount::Refused);
                self.reject(rejection).await;
            }
            DeliveryOutcome::Stopped => {}
        }
    }

    /// Publishes the rejection of the message for its sender.
    async fn reject(self, rejection: Rejection) {
        let Self { service, client, rejections, mut publish, .. } = self;
        let topic = String::from_utf8_lossy(&publish.topic).into_owned();
        tracing::warn!(topic, reason = rejection.detail(), "rejected a message");
        let payload = std::mem::take(&mut publish.payload);
        let (received_at, of) = (service.now(), topic.clone());
        // Hashing the payload may block.
        let json = tokio::task::spawn_blocking(move || rejection.to_json(&of, received_at, &payload));
        if let Ok(json) = json.await
            && let Err(error) = rejections.send(&client, topic::rejected(&topic), json, publish)
        {
            // Usually the connection is lost. The message is not acknowledged, so the broker sends it again.
            tracing::debug!(%error, topic, "failed to send the rejection of a message");
        }
    }
}

/// Acknowledges a message. An error means that the connection is lost: the broker sends the message again.
pub(super) fn acknowledge(client: &AsyncClient, publish: &Publish) {
    let _ = client.try_ack(publish);
}
