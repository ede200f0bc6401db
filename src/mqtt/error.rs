//! Errors of the MQTT settings.

use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::settings::SettingError;

/// Errors of the MQTT settings and of the files they name.
#[derive(Debug, Error)]
pub enum MqttError {
    /// A setting cannot be used.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// Certificates or a key are invalid.
    #[error("mqtt.{field}: cannot use {path} for TLS: {reason}", path = path.display())]
    Tls {
        /// Setting that names the file.
        field: &'static str,
        /// The file.
        path: PathBuf,
        /// The underlying error.
        reason: String,
    },
    /// The system has no certificate authorities.
    #[error("the system has no certificate authorities ({0}), expected some or mqtt.ca_file")]
    NoAuthorities(String),
}

impl MqttError {
    pub(super) fn tls(field: &'static str, path: &Path, reason: impl ToString) -> Self {
        Self::Tls { field, path: path.to_path_buf(), reason: reason.to_string() }
    }
}
