//! Errors of notifications.

use thiserror::Error;

use crate::service::ServiceError;
use crate::settings::SettingError;
use crate::store::StoreError;

/// Errors of the notification settings and of sending a notification.
#[derive(Debug, Error)]
pub enum NotificationError {
    /// A setting cannot be used.
    #[error(transparent)]
    Setting(#[from] SettingError),
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
