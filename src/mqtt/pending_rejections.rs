//! Rejections that the broker has not acknowledged. A rejected message is acknowledged only after its
//! rejection.

use std::collections::{HashMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{PubAck, PubAckReason, Publish, PublishProperties};
use rumqttc::v5::{AsyncClient, ClientError};

use super::rejection::MEDIA_TYPE;

/// Rejections that the broker has not acknowledged. The client library assigns a packet its identifier only
/// when it sends it, in the order of the requests.
#[derive(Default)]
pub(super) struct PendingRejections(Mutex<Pending>);

/// The rejected messages, without their payloads.
#[derive(Default)]
struct Pending {
    /// Messages whose rejection is queued in the client, in order.
    queued: VecDeque<Publish>,
    /// Messages whose rejection is sent, by its packet identifier.
    sent: HashMap<u16, Publish>,
}

impl PendingRejections {
    /// Queues a rejection in the client.
    ///
    /// # Errors
    /// The connection is lost; the broker will send the message again.
    pub(super) fn send(
        &self,
        client: &AsyncClient,
        topic: String,
        payload: Vec<u8>,
        rejected: Publish,
    ) -> Result<(), Box<ClientError>> {
        let properties = PublishProperties {
            content_type: Some(MEDIA_TYPE.to_owned()),
            // By this a device recognises its message.
            correlation_data: rejected
                .properties
                .as_ref()
                .and_then(|properties| properties.correlation_data.clone()),
            ..PublishProperties::default()
        };
        // Locked before the request, so that the order of `queued` is that of the requests.
        let mut pending = self.lock();
        client
            .try_publish_with_properties(topic, QoS::AtLeastOnce, false, payload, properties)
            .map_err(Box::new)?;
        pending.queued.push_back(rejected);
        Ok(())
    }

    /// Records that the client has sent the next queued rejection under this packet identifier.
    pub(super) fn sent(&self, packet_id: u16) {
        let mut pending = self.lock();
        if let Some(rejected) = pending.queued.pop_front() {
            pending.sent.insert(packet_id, rejected);
        }
    }

    /// Handles an acknowledgement of the broker. Returns the rejected message, which can be acknowledged now,
    /// and the broker's reason if it did not accept the rejection.
    pub(super) fn acknowledged(&self, ack: &PubAck) -> Option<(Publish, Option<PubAckReason>)> {
        let rejected = self.lock().sent.remove(&ack.pkid)?;
        let is_accepted = matches!(ack.reason, PubAckReason::Success | PubAckReason::NoMatchingSubscribers);
        Some((rejected, (!is_accepted).then_some(ack.reason)))
    }

    /// Whether the broker has acknowledged all rejections.
    pub(super) fn is_empty(&self) -> bool {
        let pending = self.lock();
        pending.queued.is_empty() && pending.sent.is_empty()
    }

    fn lock(&self) -> MutexGuard<'_, Pending> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
