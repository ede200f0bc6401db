//! One service on several machines: API nodes that keep nothing, workers, and NATS JetStream between them.
//!
//! ```text
//! API node ─ raw bytes ─▶ object store
//!          └ message ───▶ JetStream ─▶ worker ─ analyse, fold, commit ─▶ PostgreSQL
//!          ◀─ events ──── JetStream ◀─ announce ──┘
//! ```
//!
//! The settings need the feature `postgres`, everything else needs `nats`.
//!
//! What is done with a record is the code of [`service`](crate::service); here is only what joins the
//! processes.

#[cfg(feature = "nats")]
mod attempts;
#[cfg(feature = "nats")]
mod connection;
#[cfg(feature = "nats")]
mod dead_letters;
mod error;
#[cfg(feature = "nats")]
mod events;
#[cfg(feature = "nats")]
mod fault;
#[cfg(feature = "nats")]
mod member;
#[cfg(feature = "nats")]
mod message;
mod nats_settings;
#[cfg(feature = "nats")]
mod overview;
#[cfg(feature = "nats")]
mod queue;
mod settings;
#[cfg(feature = "nats")]
mod worker;

#[cfg(feature = "nats")]
pub use dead_letters::DeadLetter;
pub use error::ClusterError;
#[cfg(feature = "nats")]
pub use events::Subscription;
#[cfg(feature = "nats")]
pub use member::{Cluster, RunningWorker};
pub use nats_settings::{NatsCredentials, NatsSettings, WorkerLimits};
#[cfg(feature = "nats")]
pub use queue::Queue;
pub use settings::{ClusterSecrets, ClusterSettings, ClusterTable};
