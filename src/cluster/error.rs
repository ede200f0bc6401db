//! Errors of a cluster's processes.

use thiserror::Error;

use crate::service::ServiceError;
use crate::settings::SettingError;
use crate::store::StoreError;

/// Errors of a cluster's processes.
#[derive(Debug, Error)]
pub enum ClusterError {
    /// A setting cannot be used.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// No NATS server can be reached, or it rejects the connection.
    #[cfg(feature = "nats")]
    #[error("failed to connect to NATS at {urls}: {source}")]
    Connect {
        /// Addresses of the servers.
        urls: String,
        /// The client's error.
        source: async_nats::ConnectError,
    },
    /// A JetStream request failed.
    #[cfg(feature = "nats")]
    #[error("NATS: failed to {action}: {source}")]
    JetStream {
        /// The action that failed.
        action: &'static str,
        /// The client's error.
        source: async_nats::Error,
    },
    /// A message of the queue cannot be read.
    #[error("the message cannot be read: {0}")]
    Message(String),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The service could not be started, or failed.
    #[error(transparent)]
    Ingest(#[from] ServiceError),
}

#[cfg(feature = "nats")]
impl ClusterError {
    /// Returns a closure for `map_err` on JetStream requests; `action` completes "failed to …".
    pub(super) fn jetstream(action: &'static str) -> impl FnOnce(async_nats::Error) -> Self {
        move |source| Self::JetStream { action, source }
    }
}

/// Returns the value if it is at least `min`.
pub(super) fn at_least<T: PartialOrd + std::fmt::Display>(
    field: &str,
    value: T,
    min: T,
) -> Result<T, SettingError> {
    if value < min {
        return Err(SettingError::new(field, value, format!("at least {min}")));
    }
    Ok(value)
}
