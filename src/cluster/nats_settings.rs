//! The tables `cluster.nats` and `cluster.worker` of the settings file.

use std::path::PathBuf;
use std::time::Duration;

use axum::http::Uri;
use serde::Deserialize;

use super::error::at_least;
use crate::settings::{SettingError, host_and_port};

/// Settings of the connection to NATS and of the cluster's streams.
#[derive(Clone)]
pub struct NatsSettings {
    /// Addresses of the servers, `nats://host:4222` or `tls://host:4222`.
    pub urls: Vec<String>,
    /// Prefix of the names of all streams and subjects of this cluster.
    pub name: String,
    /// Credentials of the process.
    pub credentials: NatsCredentials,
    /// Certificates (PEM) to trust besides those of the system.
    pub ca: Option<PathBuf>,
    /// Number of servers that store each stream.
    pub replicas: usize,
    /// Maximum number of records in the queue; further ones are rejected while it is full.
    pub max_records: i64,
    /// Maximum size of the messages in the queue in bytes.
    pub max_bytes: i64,
    /// Number of events stored for clients that lost their connection.
    pub events_kept: i64,
    /// Time without progress of a worker after which its record is redelivered to another worker.
    pub ack_wait: Duration,
}

/// Credentials for NATS.
#[derive(Clone, Default)]
pub enum NatsCredentials {
    /// No credentials.
    #[default]
    None,
    /// User name and password.
    Password {
        /// The user name.
        user: String,
        /// The password.
        password: String,
    },
    /// A token.
    Token(String),
    /// A file with a JWT and a key.
    File(PathBuf),
}

impl NatsSettings {
    /// Returns the defaults for one server and a cluster's name.
    pub fn new(url: impl Into<String>, name: impl Into<String>) -> Self {
        Self {
            urls: vec![url.into()],
            name: name.into(),
            credentials: NatsCredentials::None,
            ca: None,
            replicas: 1,
            max_records: 1_000_000,
            max_bytes: 1 << 30,
            events_kept: 4096,
            ack_wait: Duration::from_secs(30),
        }
    }
}

/// Limits of a worker: the table `cluster.worker` of the settings file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkerLimits {
    /// Maximum number of records in progress at once.
    pub at_once: usize,
    /// Number of deliveries that no worker survived after which a record moves to the dead letters.
    pub max_deliveries: u32,
}

impl Default for WorkerLimits {
    fn default() -> Self {
        Self { at_once: 8 * std::thread::available_parallelism().map_or(2, usize::from), max_deliveries: 10 }
    }
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct NatsTable {
    urls: Vec<String>,
    user: Option<String>,
    credentials_file: Option<PathBuf>,
    ca: Option<PathBuf>,
    replicas: Option<usize>,
    max_records: Option<u64>,
    max_bytes: Option<u64>,
    events_kept: Option<u64>,
    ack_wait_s: Option<u64>,
}

impl NatsTable {
    pub(super) fn resolve(
        self,
        name: String,
        password: Option<String>,
        token: Option<String>,
    ) -> Result<NatsSettings, SettingError> {
        let expected = "addresses nats://host[:4222] or tls://host[:4222], with a port from 1 to 65535";
        if self.urls.is_empty() {
            return Err(SettingError::new("cluster.nats.urls", "missing", expected));
        }
        if self.urls.iter().any(|url| url.contains('@')) {
            // The URL is not repeated: it may contain a password. The client library would not use it.
            let expected = "no user in it: set user and FLANKWATCH_NATS_PASSWORD, FLANKWATCH_NATS_TOKEN or credentials_file";
            return Err(SettingError::new("cluster.nats.urls", "a URL with a user", expected));
        }
        let is_usable = |url: &str| {
            let uri: Option<Uri> = url.parse().ok();
            uri.is_some_and(|uri| {
                matches!(uri.scheme_str(), Some("nats" | "tls")) && host_and_port(&uri).is_some()
            })
        };
        if let Some(url) = self.urls.iter().find(|url| !is_usable(url)) {
            return Err(SettingError::new("cluster.nats.urls", url, expected));
        }
        let mut settings = NatsSettings::new(String::new(), name);
        settings.urls = self.urls;
        settings.ca = self.ca;
        settings.credentials = match (self.credentials_file, self.user, password, token) {
            (None, None, None, None) => NatsCredentials::None,
            (Some(path), None, None, None) => NatsCredentials::File(path),
            (None, Some(user), Some(password), None) => NatsCredentials::Password { user, password },
            (None, None, None, Some(token)) => NatsCredentials::Token(token),
            (None, Some(user), None, None) => {
                let expected = "the user's password in FLANKWATCH_NATS_PASSWORD";
                return Err(SettingError::new("cluster.nats.user", user, expected));
            }
            (_, None, Some(_), _) => {
                let expected = "the user of FLANKWATCH_NATS_PASSWORD";
                return Err(SettingError::new("cluster.nats.user", "missing", expected));
            }
            _ => {
                let expected =
                    "one of credentials_file, user with FLANKWATCH_NATS_PASSWORD, FLANKWATCH_NATS_TOKEN";
                return Err(SettingError::new("cluster.nats", "given several credentials", expected));
            }
        };
        if let Some(replicas) = self.replicas {
            if !(1..=5).contains(&replicas) {
                return Err(SettingError::new("cluster.nats.replicas", replicas, "1 to 5"));
            }
            settings.replicas = replicas;
        }
        let count = |field, given: u64| {
            i64::try_from(at_least(field, given, 1)?)
                .map_err(|_| SettingError::new(field, given, "less than 2^63"))
        };
        if let Some(max_records) = self.max_records {
            settings.max_records = count("cluster.nats.max_records", max_records)?;
        }
        if let Some(max_bytes) = self.max_bytes {
            settings.max_bytes = count("cluster.nats.max_bytes", max_bytes)?;
        }
        if let Some(kept) = self.events_kept {
            settings.events_kept = count("cluster.nats.events_kept", kept)?;
        }
        if let Some(wait) = self.ack_wait_s {
            settings.ack_wait = Duration::from_secs(at_least("cluster.nats.ack_wait_s", wait, 2)?);
        }
        Ok(settings)
    }
}

impl WorkerLimits {
    pub(super) fn check(self) -> Result<Self, SettingError> {
        at_least("cluster.worker.at_once", self.at_once, 1)?;
        at_least("cluster.worker.max_deliveries", self.max_deliveries, 1)?;
        Ok(self)
    }
}
