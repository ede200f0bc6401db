//! What can go wrong between the processes of a cluster.

use std::path::PathBuf;

use thiserror::Error;

use crate::service::ServiceError;
use crate::store::StoreError;

/// Why a process cannot be a part of a cluster.
#[derive(Debug, Error)]
pub enum ClusterError {
    /// A setting cannot be used.
    #[error("{field} is {value}, expected {expected}")]
    Setting {
        /// Which setting.
        field: String,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// The program cannot use what a setting asks for.
    #[error("{field} needs a program with the feature `{feature}`, and this one was built without it")]
    WithoutFeature {
        /// Which setting.
        field: &'static str,
        /// The feature.
        feature: &'static str,
    },
    /// A file with credentials cannot be read.
    #[error("cannot read {path}: {source}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// No NATS server can be reached, or it refuses.
    #[cfg(feature = "nats")]
    #[error("cannot connect to NATS at {urls}: {source}")]
    Connect {
        /// Where it was tried.
        urls: String,
        /// Why not.
        source: async_nats::ConnectError,
    },
    /// JetStream refused or failed.
    #[cfg(feature = "nats")]
    #[error("NATS cannot {action}: {source}")]
    JetStream {
        /// What was tried.
        action: &'static str,
        /// Why not.
        source: async_nats::Error,
    },
    /// A message of the queue cannot be read.
    #[error("the message cannot be read: {0}")]
    Message(String),
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The path of records cannot be started.
    #[error(transparent)]
    Ingest(#[from] ServiceError),
}

#[cfg(feature = "nats")]
impl ClusterError {
    /// An error of JetStream while `action` was tried.
    pub(super) fn jetstream(action: &'static str) -> impl FnOnce(async_nats::Error) -> Self {
        move |source| Self::JetStream { action, source }
    }
}
