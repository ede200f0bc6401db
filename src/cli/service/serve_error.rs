//! Errors of the commands that run the service.

use std::path::PathBuf;

use thiserror::Error;

use crate::http::StartError;
#[cfg(feature = "mqtt")]
use crate::mqtt::MqttError;
use crate::notifications::NotificationError;
use crate::settings::SettingError;

/// Errors that keep the service from starting or running.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The settings file cannot be read.
    #[error("failed to read the settings file {path}: {source}", path = path.display())]
    ConfigFile {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The settings file is invalid.
    #[error("settings file {path}: {source}", path = path.display())]
    Config {
        /// The file.
        path: PathBuf,
        /// The parser's error, with the position.
        source: Box<toml::de::Error>,
    },
    /// A setting cannot be used.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// The process could not start the runtime, write its output or wait for signals.
    #[error("failed to start: {0}")]
    Process(#[from] std::io::Error),
    /// The service could not be started, or stopped by itself.
    #[error(transparent)]
    Service(#[from] StartError),
    /// The settings file has no table `cluster`.
    #[cfg(feature = "nats")]
    #[error(
        "settings file: the table cluster is missing, expected cluster.database, cluster.nats and cluster.objects"
    )]
    NoClusterTable,
    /// The process could not join the cluster.
    #[cfg(feature = "postgres")]
    #[error(transparent)]
    Cluster(#[from] crate::cluster::ClusterError),
    /// The notification settings are invalid.
    #[error(transparent)]
    Notifications(#[from] NotificationError),
    /// The MQTT settings are invalid.
    #[cfg(feature = "mqtt")]
    #[error(transparent)]
    Mqtt(#[from] MqttError),
}
