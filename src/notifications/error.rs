//! Errors of notifications.

use std::path::PathBuf;

use thiserror::Error;

use crate::service::ServiceError;
use crate::store::StoreError;

/// Errors of the notification settings and of sending a notification.
#[derive(Debug, Error)]
pub enum NotificationError {
    /// A setting is invalid.
    #[error("notifications.{field} is {value}, expected {expected}")]
    Setting {
        /// Name of the setting.
        field: String,
        /// Value of the setting.
        value: String,
        /// Description of a valid value.
        expected: String,
    },
    /// A file of the settings cannot be read.
    #[error("notifications.{field}: failed to read {path}: {source}", path = path.display())]
    File {
        /// Name of the setting.
        field: String,
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The receiver of a webhook could not be reached or did not respond.
    #[error("the webhook request failed: {0}")]
    Request(#[from] Box<ureq::Error>),
    /// The receiver of a webhook rejected it.
    #[error("the webhook was answered with status {0}, expected 200 to 299")]
    Status(u16),
    /// An e-mail cannot be composed.
    #[error("failed to compose the e-mail: {0}")]
    Mail(#[from] lettre::error::Error),
    /// The mail server could not be reached or rejected the e-mail.
    #[error("the mail server failed: {0}")]
    Smtp(#[from] lettre::transport::smtp::Error),
    /// The mail server took too long.
    #[error("the mail server did not accept the e-mail within {0} s")]
    Timeout(u64),
    /// The body of a webhook cannot be serialised.
    #[error("failed to serialise the body: {0}")]
    Body(#[from] serde_json::Error),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A blocking task failed.
    #[error(transparent)]
    Service(#[from] ServiceError),
}

impl NotificationError {
    pub(super) fn setting(
        field: impl Into<String>,
        value: impl ToString,
        expected: impl Into<String>,
    ) -> Self {
        Self::Setting { field: field.into(), value: value.to_string(), expected: expected.into() }
    }
}
