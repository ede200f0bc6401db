//! Errors of a cluster's processes.

use std::path::PathBuf;

use thiserror::Error;

use crate::service::ServiceError;
use crate::store::StoreError;

/// Errors of a cluster's processes.
#[derive(Debug, Error)]
pub enum ClusterError {
    /// A setting is invalid.
    #[error("{field} is {value}, expected {expected}")]
    Setting {
        /// Name of the setting.
        field: String,
        /// Value of the setting.
        value: String,
        /// Description of a valid value.
        expected: String,
    },
    /// A setting requires a feature that the program was built without.
    #[error("{field} requires the feature `{feature}`, and this program was built without it")]
    WithoutFeature {
        /// Name of the setting.
        field: &'static str,
        /// The feature.
        feature: &'static str,
    },
    /// A credentials file cannot be read.
    #[error("failed to read {path}: {source}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
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
) -> Result<T, ClusterError> {
    if value < min {
        return Err(invalid(field, value, &format!("at least {min}")));
    }
    Ok(value)
}

/// The error for an invalid setting.
pub(super) fn invalid(field: &str, value: impl ToString, expected: &str) -> ClusterError {
    ClusterError::Setting { field: field.to_owned(), value: value.to_string(), expected: expected.to_owned() }
}
