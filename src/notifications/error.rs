//! Why nobody can be notified.

use std::path::PathBuf;

use thiserror::Error;

use crate::service::ServiceError;
use crate::store::StoreError;

/// Why a notification cannot be sent, or never could be as the settings say.
#[derive(Debug, Error)]
pub enum NotificationError {
    /// A setting cannot be used.
    #[error("notifications.{field} is {value}, expected {expected}")]
    Setting {
        /// Which setting.
        field: String,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// A file that a setting names cannot be read.
    #[error("notifications.{field}: cannot read {path}: {source}", path = path.display())]
    File {
        /// Which setting.
        field: String,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The receiver of a webhook could not be reached, or did not answer.
    #[error("no answer: {0}")]
    Request(#[from] Box<ureq::Error>),
    /// The receiver of a webhook did not take it.
    #[error("answered with status {0}, expected 200 to 299")]
    Status(u16),
    /// A mail cannot be written.
    #[error("cannot write the mail: {0}")]
    Mail(#[from] lettre::error::Error),
    /// The mail server could not be reached, or did not take the mail.
    #[error("the mail server: {0}")]
    Smtp(#[from] lettre::transport::smtp::Error),
    /// The mail server took too long.
    #[error("the mail server did not take the mail within {0} s")]
    Slow(u64),
    /// What is to be told cannot be written as JSON.
    #[error("cannot write the body: {0}")]
    Body(#[from] serde_json::Error),
    /// The store cannot say whom it is about.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A thread was lost.
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
