//! Errors of the MQTT settings.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// Errors of the MQTT settings and of the files they name.
#[derive(Debug, Error)]
pub enum MqttError {
    /// A setting is invalid.
    #[error("mqtt.{field} is {value}, expected {expected}")]
    Setting {
        /// Name of the setting.
        field: &'static str,
        /// Value of the setting.
        value: String,
        /// Description of a valid value.
        expected: &'static str,
    },
    /// A file cannot be read.
    #[error("mqtt.{field}: failed to read {path}: {source}", path = path.display())]
    File {
        /// Setting that names the file.
        field: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
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
    pub(super) fn setting(field: &'static str, value: impl ToString, expected: &'static str) -> Self {
        Self::Setting { field, value: value.to_string(), expected }
    }

    pub(super) fn tls(field: &'static str, path: &Path, reason: impl ToString) -> Self {
        Self::Tls { field, path: path.to_path_buf(), reason: reason.to_string() }
    }
}
