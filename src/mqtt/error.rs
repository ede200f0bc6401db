//! Why there can be no connection to a broker.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why MQTT cannot be spoken as the settings say.
#[derive(Debug, Error)]
pub enum MqttError {
    /// A setting cannot be used.
    #[error("mqtt.{field} is {value}, expected {expected}")]
    Setting {
        /// Which setting.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// A file cannot be read.
    #[error("mqtt.{field}: cannot read {path}: {source}", path = path.display())]
    File {
        /// Which setting names it.
        field: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Certificates or a key cannot be used.
    #[error("mqtt.{field}: cannot use {path} for TLS: {reason}", path = path.display())]
    Tls {
        /// Which setting names it.
        field: &'static str,
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The system has no certificate authorities.
    #[error("no certificate authority is known to the system ({0}), expected some or mqtt.ca_file")]
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
