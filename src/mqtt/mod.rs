//! Records and streams over MQTT 5: a `WaveformBlock` per message, as a record on
//! `flankwatch/{asset}/{point}/waveform`, or as the next samples of a stream on
//! `flankwatch/{asset}/{point}/samples`.
//!
//! A message is acknowledged (QoS 1) when its record is as durable as an upload answered with 201, or when
//! its samples are in the journal of the stream. Until then the broker keeps it in the persistent session and
//! sends it again after a lost connection; a record sent twice is one segment. A message that can never be
//! used is rejected: a problem is published on `flankwatch/{asset}/{point}/rejected`, and the message is
//! acknowledged once the broker has the problem.
//!
//! At most [`MqttSettings::in_flight`] messages are unacknowledged at once (MQTT's receive maximum). A busy
//! service holds no more than these in memory; the rest stays at the broker.

mod connection;
mod delivery;
mod error;
mod incoming;
mod message;
mod pending_rejections;
mod rejection;
mod settings;
mod stream_blocks;
mod tls;
mod topic;

pub use connection::MqttFeed;
pub use error::MqttError;
pub use settings::{MqttCredentials, MqttSettings, MqttTable};
