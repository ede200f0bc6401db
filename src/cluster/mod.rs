//! One service on several machines: stateless API nodes, workers, and NATS JetStream between them.
//!
//! ```text
//! API node ─ raw bytes ─▶ object store
//!          └ message ───▶ JetStream ─▶ worker ─ analyse, fold, commit ─▶ PostgreSQL
//!          ◀─ events ──── JetStream ◀─ publish ───┘
//! ```
//!
//! The settings require the feature `postgres`, everything else requires `nats`.
//!
//! [`service`](crate::service) processes the records; this module connects the processes.

#[cfg(feature = "nats")]
mod attempts;
#[cfg(feature = "nats")]
mod connection;
#[cfg(feature = "nats")]
mod consumers;
#[cfg(feature = "nats")]
mod dead_letters;
mod error;
#[cfg(feature = "nats")]
mod events;
#[cfg(feature = "nats")]
mod intake;
#[cfg(feature = "nats")]
mod member;
#[cfg(feature = "nats")]
mod message;
mod nats_settings;
#[cfg(feature = "nats")]
mod overview;
#[cfg(feature = "nats")]
mod ownership;
#[cfg(feature = "nats")]
mod partition;
#[cfg(feature = "nats")]
mod queue;
#[cfg(feature = "nats")]
mod rebalance;
mod settings;
#[cfg(feature = "nats")]
mod worker;

#[cfg(feature = "nats")]
pub use dead_letters::DeadLetter;
pub use error::ClusterError;
#[cfg(feature = "nats")]
pub use member::{Cluster, RunningWorker};
pub use nats_settings::{NatsCredentials, NatsSettings, WorkerLimits};
#[cfg(feature = "nats")]
pub use queue::Queue;
pub use settings::{ClusterSecrets, ClusterSettings, ClusterTable};
