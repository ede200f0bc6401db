//! The connection to NATS, and the streams that the processes of a cluster share.

use std::time::Duration;

use async_nats::connection::State;
use async_nats::jetstream::stream::{Config as StreamConfig, DiscardPolicy, RetentionPolicy, StorageType};
use async_nats::jetstream::{self, Context, ContextBuilder};
use async_nats::{Client, ConnectOptions, Event};

use super::{ClusterError, NatsCredentials, NatsSettings};
use crate::settings::SettingError;

/// The pattern of all subjects of a stream.
pub(super) const ANY_SUBJECT: &str = ">";

/// Timeout of JetStream requests.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum number of unacknowledged messages of one process.
const MAX_UNACKNOWLEDGED: usize = 1024;

/// Time in which JetStream detects duplicates: a record enqueued again within it is not queued twice.
const DUPLICATE_WINDOW: Duration = Duration::from_secs(600);

/// Time after which the attempts of a record expire.
const ATTEMPTS_MAX_AGE: Duration = Duration::from_secs(30 * 24 * 3600);

impl NatsSettings {
    async fn options(&self) -> Result<ConnectOptions, ClusterError> {
        let mut options = ConnectOptions::new()
            .name(format!("flankwatch {}", env!("CARGO_PKG_VERSION")))
            // Wait for a server that is down; requests meanwhile fail by their own timeout.
            .retry_on_initial_connect()
            .max_reconnects(None)
            .reconnect_delay_callback(|attempts| Duration::from_millis(100 << attempts.min(5)))
            .ping_interval(Duration::from_secs(5))
            .event_callback(|event| async move {
                match event {
                    Event::Connected => tracing::info!("connected to NATS"),
                    Event::Disconnected => tracing::warn!("connection to NATS lost"),
                    event => tracing::debug!(%event, "NATS"),
                }
            });
        options = match &self.credentials {
            NatsCredentials::None => options,
            NatsCredentials::Password { user, password } => {
                options.user_and_password(user.clone(), password.clone())
            }
            NatsCredentials::Token(token) => options.token(token.clone()),
            NatsCredentials::File(path) => {
                let read = options.credentials_file(path).await;
                let field = "cluster.nats.credentials_file".to_owned();
                read.map_err(|source| SettingError::File { field, path: path.clone(), source })?
            }
        };
        if let Some(ca) = &self.ca {
            options = options.add_root_certificates(ca.clone());
        }
        Ok(options)
    }
}

/// A connection to NATS and the names of the cluster's streams. Clones share the connection.
#[derive(Clone)]
pub(super) struct Connection {
    pub(super) client: Client,
    pub(super) jetstream: Context,
    settings: NatsSettings,
}

impl Connection {
    /// Connects to NATS. Where no server answers, the client keeps trying in the background.
    pub(super) async fn open(settings: NatsSettings) -> Result<Self, ClusterError> {
        let connected = settings.options().await?.connect(settings.urls.clone()).await;
        let client =
            connected.map_err(|source| ClusterError::Connect { urls: settings.urls.join(", "), source })?;
        let jetstream = ContextBuilder::new()
            .timeout(RESPONSE_TIMEOUT)
            .max_ack_inflight(MAX_UNACKNOWLEDGED)
            .build(client.clone());
        Ok(Self { client, jetstream, settings })
    }

    /// Waits for the connection; fails if there is none within [`RESPONSE_TIMEOUT`].
    pub(super) async fn wait_until_connected(&self) -> Result<(), ClusterError> {
        let connected = async {
            while self.fault().is_some() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        tokio::time::timeout(RESPONSE_TIMEOUT, connected).await.map_err(|_| {
            let urls = self.settings.urls.join(", ");
            ClusterError::jetstream("connect")(format!("no server answers at {urls}").into())
        })?;
        if !self.has_partitions() {
            let version = self.client.server_info().version;
            tracing::warn!(
                version,
                "NATS servers before 2.11 can lose acknowledged records when they are killed; update this one"
            );
        }
        Ok(())
    }

    /// Creates missing streams and updates the limits of existing ones to the settings.
    pub(super) async fn prepare(&self) -> Result<(), ClusterError> {
        let settings = &self.settings;
        let common = StreamConfig {
            storage: StorageType::File,
            num_replicas: settings.replicas,
            ..StreamConfig::default()
        };
        let work = StreamConfig {
            name: self.work_stream(),
            subjects: vec![self.work_subject(), format!("{}.*", self.work_subject())],
            retention: RetentionPolicy::WorkQueue,
            // A full queue rejects new records: acknowledged records are never dropped for them.
            discard: DiscardPolicy::New,
            max_messages: settings.max_records,
            max_bytes: settings.max_bytes,
            duplicate_window: DUPLICATE_WINDOW,
            ..common.clone()
        };
        let dead = StreamConfig {
            name: self.dead_stream(),
            subjects: vec![self.dead_subject()],
            retention: RetentionPolicy::Limits,
            duplicate_window: DUPLICATE_WINDOW,
            ..common.clone()
        };
        let events = StreamConfig {
            name: self.events_stream(),
            subjects: vec![self.events_subject()],
            retention: RetentionPolicy::Limits,
            discard: DiscardPolicy::Old,
            max_messages: settings.events_kept,
            ..common.clone()
        };
        let attempts = StreamConfig {
            name: self.attempts_stream(),
            subjects: vec![format!("{}.*", self.attempts_subject())],
            retention: RetentionPolicy::Limits,
            discard: DiscardPolicy::Old,
            max_messages: settings.max_records,
            max_messages_per_subject: 1,
            max_age: ATTEMPTS_MAX_AGE,
            ..common
        };
        for stream in [work, dead, events, attempts] {
            let created = self.jetstream.create_or_update_stream(stream).await;
            created.map_err(|error| ClusterError::jetstream("create a stream")(error.into()))?;
        }
        Ok(())
    }

    /// Returns why NATS is unavailable; `None` while it is connected.
    pub(super) fn fault(&self) -> Option<&'static str> {
        (self.client.connection_state() != State::Connected).then_some("not connected")
    }

    /// Whether the queue has partitions: from version 2.11 of the server on, the earliest that keeps all
    /// messages with them when it is killed, of those tested.
    pub(super) fn has_partitions(&self) -> bool {
        self.client.is_server_compatible(2, 11, 0)
    }

    /// Writes a small message to JetStream's file storage, which fails where the disk is full.
    pub(super) async fn check_writable(&self) -> Result<(), ClusterError> {
        let failed = || ClusterError::jetstream("write");
        let sent = self.jetstream.publish(format!("{}.probe", self.attempts_subject()), "".into()).await;
        sent.map_err(|error| failed()(error.into()))?.await.map_err(|error| failed()(error.into()))?;
        Ok(())
    }

    /// Returns the current state of the queue's stream.
    pub(super) async fn work_state(&self) -> Result<jetstream::stream::State, ClusterError> {
        let failed = ClusterError::jetstream("read the state of the queue");
        match self.jetstream.get_stream(self.work_stream()).await {
            Ok(stream) => Ok(stream.cached_info().state.clone()),
            Err(error) => Err(failed(error.into())),
        }
    }

    pub(super) fn settings(&self) -> &NatsSettings {
        &self.settings
    }

    pub(super) fn work_stream(&self) -> String {
        format!("{}_work", self.settings.name)
    }

    /// Subject of unpartitioned records, and prefix of the subjects of partitions.
    pub(super) fn work_subject(&self) -> String {
        format!("{}.work", self.settings.name)
    }

    pub(super) fn dead_stream(&self) -> String {
        format!("{}_dead", self.settings.name)
    }

    pub(super) fn dead_subject(&self) -> String {
        format!("{}.dead", self.settings.name)
    }

    pub(super) fn attempts_stream(&self) -> String {
        format!("{}_attempts", self.settings.name)
    }

    pub(super) fn attempts_subject(&self) -> String {
        format!("{}.attempts", self.settings.name)
    }

    pub(super) fn events_stream(&self) -> String {
        format!("{}_events", self.settings.name)
    }

    pub(super) fn events_subject(&self) -> String {
        format!("{}.events", self.settings.name)
    }

    /// Subject on which workers respond with their status.
    pub(super) fn workers_subject(&self) -> String {
        format!("{}.workers", self.settings.name)
    }

    pub(super) fn changes_subject(&self) -> String {
        format!("{}.changes", self.settings.name)
    }
}
