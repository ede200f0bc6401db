//! Records over MQTT 5: `flankwatch/{asset}/{point}/waveform`, a `WaveformBlock` each.
//!
//! A message is acknowledged (QoS 1) when its record is as safe as an upload that was answered with 201.
//! Until then the broker keeps it in the persistent session and sends it again after a lost connection; the
//! same record twice is one segment. Messages that can never be used are answered with a problem on
//! `flankwatch/{asset}/{point}/rejected`, and acknowledged when the broker has that.
//!
//! No more than [`MqttSettings::in_flight`] messages are unacknowledged at once (MQTT's receive maximum), so
//! that a full service holds no more than these: the rest waits at the broker.

mod connection;
mod delivery;
mod error;
mod message;
mod pending_refusals;
mod refusal;
mod settings;
mod tls;
mod topic;

pub use connection::MqttFeed;
pub use error::MqttError;
pub use settings::{MqttCredentials, MqttSettings, MqttTable};
