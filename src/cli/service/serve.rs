//! `flankwatch serve`: runs the service.

use std::fs;
use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr};
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use serde::Deserialize;

use super::serve_error::ServeError;
#[cfg(feature = "postgres")]
use crate::cluster::{ClusterSettings, ClusterTable};
use crate::http::{ServiceConfig, TlsFiles, start};
#[cfg(feature = "mqtt")]
use crate::mqtt::{MqttFeed, MqttTable};
use crate::notifications::{NotificationError, NotificationSettings, NotificationsTable, Notifier};
use crate::service::{OldResults, RawQuotas, SystemClock};
use crate::settings::SettingError;

/// Arguments of `flankwatch serve`.
#[derive(Debug, Clone, Default, Args)]
pub(in crate::cli) struct ServeArgs {
    /// Settings file (TOML); command-line options override it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Address to listen on; port 0 picks a free port [default: 127.0.0.1:8600].
    #[arg(long, value_name = "ADDR", value_parser = socket_address)]
    pub listen: Option<SocketAddr>,
    /// Data folder: database, raw recordings, libraries [default: ./flankwatch-data].
    #[arg(long, value_name = "DIR")]
    pub data_dir: Option<PathBuf>,
    /// Folder of the recordings that the API may replay [default: recordings in the data folder].
    #[arg(long, value_name = "DIR")]
    pub replay_dir: Option<PathBuf>,
    /// TLS certificate (PEM); requires --tls-key.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_certificate: Option<PathBuf>,
    /// Private key (PEM) of the TLS certificate.
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    pub tls_key: Option<PathBuf>,
    /// Disable authentication: anyone who can reach the address has full access.
    #[arg(long)]
    pub insecure_no_tokens: bool,
    /// Host name by which a reverse proxy on this machine exposes the service; required without tokens;
    /// repeatable.
    #[arg(long, value_name = "NAME")]
    pub host_name: Vec<String>,
    #[command(flatten)]
    pub mqtt: super::mqtt::MqttArgs,
}

/// Parses an address to listen on.
pub(super) fn socket_address(text: &str) -> Result<SocketAddr, String> {
    text.parse()
        .map_err(|_| "expected an IP address and a port such as 127.0.0.1:8600 or [::]:8600".to_owned())
}

/// The settings file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct ConfigFile {
    listen: Option<SocketAddr>,
    data_dir: Option<PathBuf>,
    replay_dir: Option<PathBuf>,
    tls_certificate: Option<PathBuf>,
    tls_key: Option<PathBuf>,
    insecure_no_tokens: bool,
    host_names: Vec<String>,
    limits: LimitsTable,
    retention: RetentionTable,
    notifications: NotificationsTable,
    #[cfg(feature = "mqtt")]
    mqtt: Option<MqttTable>,
    #[cfg(not(feature = "mqtt"))]
    mqtt: Option<toml::Table>,
    #[cfg(feature = "postgres")]
    cluster: Option<ClusterTable>,
    #[cfg(not(feature = "postgres"))]
    cluster: Option<toml::Table>,
}

/// The settings after options, file and defaults are merged.
pub(in crate::cli) struct Resolved {
    pub(in crate::cli) service: ServiceConfig,
    notifications: NotificationsTable,
    #[cfg(feature = "postgres")]
    pub(in crate::cli) cluster: Option<ClusterSettings>,
    #[cfg(feature = "mqtt")]
    mqtt: Option<MqttTable>,
}

/// The table `retention` of the settings file: quotas of raw recordings, the time that they stay in
/// quarantine, and the thinning of old results.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RetentionTable {
    raw_bytes: Option<u64>,
    raw_bytes_per_asset: Option<u64>,
    quarantine_days: Option<u32>,
    full_results_days: Option<NonZeroU32>,
    old_results_interval_s: Option<NonZeroU32>,
}

/// Interval of the old results that are kept, in seconds.
const OLD_RESULTS_INTERVAL_S: u32 = 3600;

/// The table `limits` of the settings file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct LimitsTable {
    record_bytes: Option<usize>,
    recording_bytes: Option<u64>,
    uploads_at_once: Option<u32>,
    bytes_at_once: Option<usize>,
    requests_at_once: Option<usize>,
    recordings_at_once: Option<usize>,
    workers: Option<usize>,
    simulation_threads: Option<usize>,
    body_timeout_s: Option<u64>,
    body_idle_s: Option<u64>,
    body_bytes_per_s: Option<u64>,
    request_timeout_s: Option<u64>,
    grace_s: Option<u64>,
    connections: Option<usize>,
    header_bytes: Option<usize>,
    header_timeout_s: Option<u64>,
    write_timeout_s: Option<u64>,
    requests_per_s: Option<NonZeroU32>,
    streams: Option<usize>,
    events_kept: Option<usize>,
    start_time_ahead_s: Option<u64>,
}

impl ServeArgs {
    /// Merges the options with the settings file and the defaults, in this precedence.
    pub(in crate::cli) fn resolve(&self) -> Result<Resolved, ServeError> {
        let file = match &self.config {
            Some(path) => ConfigFile::read(path)?,
            None => ConfigFile::default(),
        };
        let default_listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 8600));
        let mut config = ServiceConfig::new(
            self.listen.or(file.listen).unwrap_or(default_listen),
            self.data_dir.clone().or(file.data_dir).unwrap_or_else(|| PathBuf::from("flankwatch-data")),
        );
        config.replay_dir = self.replay_dir.clone().or(file.replay_dir);
        let certificate = self.tls_certificate.clone().or(file.tls_certificate);
        config.tls = match (certificate, self.tls_key.clone().or(file.tls_key)) {
            (Some(certificate), Some(key)) => Some(TlsFiles { certificate, key }),
            (None, None) => None,
            (Some(_), None) => return Err(without_its_pair("tls_key").into()),
            (None, Some(_)) => return Err(without_its_pair("tls_certificate").into()),
        };
        config.insecure_no_tokens = self.insecure_no_tokens || file.insecure_no_tokens;
        config.host_names = if self.host_name.is_empty() { file.host_names } else { self.host_name.clone() };
        file.limits.apply(&mut config);
        config.work.quotas = RawQuotas {
            bytes: file.retention.raw_bytes,
            bytes_per_asset: file.retention.raw_bytes_per_asset,
        };
        config.work.old_results = file.retention.full_results_days.map(|days| {
            let interval_s =
                file.retention.old_results_interval_s.map_or(OLD_RESULTS_INTERVAL_S, NonZeroU32::get);
            OldResults {
                age: Duration::from_secs(u64::from(days.get()) * 24 * 3600),
                interval: Duration::from_secs(u64::from(interval_s)),
            }
        });
        if let Some(days) = file.retention.quarantine_days {
            config.work.quarantined_for = Duration::from_secs(u64::from(days) * 24 * 3600);
        }
        #[cfg(not(feature = "postgres"))]
        if file.cluster.is_some() {
            let field = "the table cluster of the settings file";
            return Err(SettingError::WithoutFeature { field, feature: "cluster" }.into());
        }
        #[cfg(not(feature = "mqtt"))]
        if file.mqtt.is_some() {
            let field = "the table mqtt of the settings file";
            return Err(SettingError::WithoutFeature { field, feature: "mqtt" }.into());
        }
        Ok(Resolved {
            #[cfg(feature = "postgres")]
            cluster: file.cluster.map(super::shared_store::resolve).transpose()?,
            #[cfg(feature = "mqtt")]
            mqtt: file.mqtt,
            notifications: file.notifications,
            service: config,
        })
    }
}

impl Resolved {
    /// Takes the notification settings, resolves their secrets from the environment and passes the recipients
    /// to the service, which queues notifications for them.
    pub(super) fn notifications(&mut self) -> Result<NotificationSettings, NotificationError> {
        let secret = |name: &str| std::env::var(format!("FLANKWATCH_SECRET_{name}")).ok();
        let settings = std::mem::take(&mut self.notifications)
            .resolve(|name| secret(name).filter(|value| !value.is_empty()))?;
        self.service.recipients = settings.recipients();
        Ok(settings)
    }
}

impl ConfigFile {
    fn read(path: &Path) -> Result<Self, ServeError> {
        let text = fs::read_to_string(path)
            .map_err(|source| ServeError::ConfigFile { path: path.to_path_buf(), source })?;
        toml::from_str(&text)
            .map_err(|source| ServeError::Config { path: path.to_path_buf(), source: Box::new(source) })
    }
}

fn without_its_pair(field: &str) -> SettingError {
    let expected = "both tls_certificate and tls_key or neither";
    SettingError::new(format!("settings file: {field}"), "missing", expected)
}

impl LimitsTable {
    fn apply(&self, config: &mut ServiceConfig) {
        fn set<T: Copy>(setting: &mut T, given: Option<T>) {
            if let Some(given) = given {
                *setting = given;
            }
        }
        set(&mut config.http.record_bytes, self.record_bytes);
        set(&mut config.http.recording_bytes, self.recording_bytes);
        set(&mut config.http.uploads_at_once, self.uploads_at_once.map(|n| n.max(1)));
        set(&mut config.http.body_timeout, self.body_timeout_s.map(Duration::from_secs));
        set(&mut config.http.body_idle, self.body_idle_s.map(Duration::from_secs));
        set(&mut config.http.body_bytes_per_s, self.body_bytes_per_s);
        set(&mut config.http.request_timeout, self.request_timeout_s.map(Duration::from_secs));
        set(&mut config.http.grace, self.grace_s.map(Duration::from_secs));
        set(&mut config.http.connections, self.connections.map(|n| n.max(1)));
        // The HTTP library's minimum.
        set(&mut config.http.header_bytes, self.header_bytes.map(|n| n.max(8192)));
        set(&mut config.http.header_timeout, self.header_timeout_s.map(Duration::from_secs));
        set(&mut config.http.write_timeout, self.write_timeout_s.map(Duration::from_secs));
        set(&mut config.http.requests_per_s, self.requests_per_s);
        set(&mut config.work.streams_at_once, self.streams.map(|n| n.max(1)));
        set(&mut config.http.events_kept, self.events_kept);
        set(&mut config.work.start_time_ahead, self.start_time_ahead_s.map(Duration::from_secs));
        set(&mut config.work.bytes_at_once, self.bytes_at_once);
        set(&mut config.work.requests_at_once, self.requests_at_once.map(|n| n.max(1)));
        set(&mut config.work.recordings_at_once, self.recordings_at_once.map(|n| n.max(1)));
        set(&mut config.work.workers, self.workers.map(|n| n.max(1)));
        set(&mut config.work.simulation_threads, self.simulation_threads.map(|n| n.max(1)));
    }
}

/// Runs the service until Ctrl-C or SIGTERM.
pub(in crate::cli) fn run(args: &ServeArgs) -> Result<(), ServeError> {
    let mut resolved = args.resolve()?;
    let notifications = resolved.notifications()?;
    #[cfg(all(feature = "postgres", not(feature = "nats")))]
    if resolved.cluster.is_some() {
        let field = "serving with the table cluster of the settings file";
        return Err(SettingError::WithoutFeature { field, feature: "nats" }.into());
    }
    #[cfg(not(feature = "mqtt"))]
    args.mqtt.refuse()?;
    #[cfg(feature = "mqtt")]
    let mqtt = args.mqtt.resolve(resolved.mqtt, resolved.service.http.record_bytes)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let ended = runtime.block_on(async {
        let grace = resolved.service.http.grace;
        #[cfg(feature = "nats")]
        let service = match resolved.cluster {
            Some(cluster) => tokio::select! {
                started = super::node::start_api(resolved.service, cluster) => started?,
                stopped = shutdown_signal() => return Ok(stopped?),
            },
            None => start(resolved.service, Arc::new(SystemClock)).await?,
        };
        #[cfg(not(feature = "nats"))]
        let service = start(resolved.service, Arc::new(SystemClock)).await?;
        #[cfg(feature = "mqtt")]
        let mqtt = mqtt.map(|settings| MqttFeed::start(settings, service.service().clone())).transpose()?;
        let notifier = Notifier::start(notifications, service.service());
        let mut out = std::io::stdout();
        writeln!(out, "listening on {}", service.url())?;
        out.flush()?;
        shutdown_signal().await?;
        tracing::info!("stopping");
        #[cfg(feature = "mqtt")]
        if let Some(mqtt) = mqtt {
            mqtt.stop(grace).await;
        }
        notifier.stop(grace).await;
        service.stop().await?;
        Ok(())
    });
    // Don't wait for a recording that is still being read: it can be read again.
    runtime.shutdown_timeout(Duration::from_secs(1));
    ended
}

/// Waits for Ctrl-C or, on Unix, SIGTERM.
pub(super) async fn shutdown_signal() -> std::io::Result<()> {
    #[cfg(unix)]
    {
        let mut terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())?;
        tokio::select! {
            interrupted = tokio::signal::ctrl_c() => interrupted,
            _ = terminate.recv() => Ok(()),
        }
    }
    #[cfg(not(unix))]
    tokio::signal::ctrl_c().await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_override_the_settings_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flankwatch.toml");
        fs::write(
            &path,
            "listen = \"127.0.0.1:1\"\ndata_dir = \"d\"\n[limits]\nrecord_bytes = 1000\nuploads_at_once = 3\n[retention]\nraw_bytes = 5\n",
        )
        .unwrap();
        let args = ServeArgs {
            config: Some(path),
            listen: Some("127.0.0.1:2".parse().unwrap()),
            ..ServeArgs::default()
        };
        let config = args.resolve().unwrap().service;
        assert_eq!(config.listen.port(), 2);
        assert_eq!(config.data_dir, PathBuf::from("d"));
        assert_eq!((config.http.record_bytes, config.http.uploads_at_once), (1000, 3));
        assert_eq!((config.work.quotas.bytes, config.work.quotas.bytes_per_asset), (Some(5), None));
    }

    #[test]
    fn an_unknown_key_is_rejected_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flankwatch.toml");
        fs::write(&path, "[limits]\nrecord_byte = 1\n").unwrap();
        let args = ServeArgs { config: Some(path), ..ServeArgs::default() };
        let error = args.resolve().map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("record_byte") && error.contains("flankwatch.toml"), "{error}");
    }
}
