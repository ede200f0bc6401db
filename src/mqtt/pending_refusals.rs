//! The refusals that are under way to the broker. A message is acknowledged only when the broker has its
//! refusal.

use std::collections::{HashMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{PubAck, PubAckReason, Publish, PublishProperties};
use rumqttc::v5::{AsyncClient, ClientError};

use super::refusal::MEDIA_TYPE;

/// Refusals that the broker does not have yet. The client library names a packet only when it is sent, in the
/// order in which packets were given to it.
#[derive(Default)]
pub(super) struct PendingRefusals(Mutex<UnderWay>);

#[derive(Default)]
struct UnderWay {
    /// The refused messages, without their payloads.
    to_send: VecDeque<Publish>,
    sent: HashMap<u16, Publish>,
}

impl PendingRefusals {
    /// Gives a refusal to the client; its order is that of the calls.
    ///
    /// Error: the connection is gone, and the broker will send the message again.
    pub(super) fn send(
        &self,
        client: &AsyncClient,
        topic: String,
        letter: Vec<u8>,
        refused: Publish,
    ) -> Result<(), Box<ClientError>> {
        let properties = PublishProperties {
            content_type: Some(MEDIA_TYPE.to_owned()),
            // By this a device knows which of its messages is meant.
            correlation_data: refused
                .properties
                .as_ref()
                .and_then(|properties| properties.correlation_data.clone()),
            ..PublishProperties::default()
        };
        let mut under_way = self.under_way();
        client
            .try_publish_with_properties(topic, QoS::AtLeastOnce, false, letter, properties)
            .map_err(Box::new)?;
        under_way.to_send.push_back(refused);
        Ok(())
    }

    /// The client sent the next packet under this name.
    pub(super) fn sent(&self, packet_id: u16) {
        let mut under_way = self.under_way();
        if let Some(refused) = under_way.to_send.pop_front() {
            under_way.sent.insert(packet_id, refused);
        }
    }

    /// The broker answered: the message that can be acknowledged now, and why the broker did not take its
    /// refusal, if so.
    pub(super) fn answered(&self, answer: &PubAck) -> Option<(Publish, Option<PubAckReason>)> {
        let refused = self.under_way().sent.remove(&answer.pkid)?;
        let is_taken = matches!(answer.reason, PubAckReason::Success | PubAckReason::NoMatchingSubscribers);
        Some((refused, (!is_taken).then_some(answer.reason)))
    }

    /// Whether the broker has all of them.
    pub(super) fn is_empty(&self) -> bool {
        let under_way = self.under_way();
        under_way.to_send.is_empty() && under_way.sent.is_empty()
    }

    fn under_way(&self) -> MutexGuard<'_, UnderWay> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
