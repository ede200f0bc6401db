//! `flankwatch serve`: runs the service.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr};
use std::num::NonZeroU32;
use std::ops::RangeInclusive;
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

/// The table `limits` of the settings file: how each given limit is set, and to what.
#[derive(Debug, Default, Deserialize)]
#[serde(try_from = "BTreeMap<String, u64>")]
struct LimitsTable(Vec<(SetLimit, u64)>);

type SetLimit = fn(&mut ServiceConfig, u64);

/// Ranges of limits. The bounds above keep sums and products of limits from overflowing.
const BYTES: RangeInclusive<u64> = 1..=1 << 50;
const COUNT: RangeInclusive<u64> = 1..=u32::MAX as u64;
const SECONDS: RangeInclusive<u64> = 1..=1_000_000_000;
const SECONDS_OR_NONE: RangeInclusive<u64> = 0..=1_000_000_000;

/// The least that the memory of records is counted in, and the HTTP library's minimum of a request's head.
const AT_LEAST_1_KIB: RangeInclusive<u64> = 1024..=1 << 50;
const AT_LEAST_8_KIB: RangeInclusive<u64> = 8192..=1 << 50;

/// Key, range and effect of each limit.
const LIMITS: [(&str, RangeInclusive<u64>, SetLimit); 21] = [
    ("record_bytes", BYTES, |config, n| config.http.record_bytes = n as usize),
    ("recording_bytes", BYTES, |config, n| config.http.recording_bytes = n),
    ("uploads_at_once", COUNT, |config, n| config.http.uploads_at_once = n as u32),
    ("bytes_at_once", AT_LEAST_1_KIB, |config, n| config.work.bytes_at_once = n as usize),
    ("requests_at_once", COUNT, |config, n| config.work.requests_at_once = n as usize),
    ("recordings_at_once", COUNT, |config, n| config.work.recordings_at_once = n as usize),
    ("workers", COUNT, |config, n| config.work.workers = n as usize),
    ("simulation_threads", COUNT, |config, n| config.work.simulation_threads = n as usize),
    ("connections", COUNT, |config, n| config.http.connections = n as usize),
    ("header_bytes", AT_LEAST_8_KIB, |config, n| config.http.header_bytes = n as usize),
    ("header_timeout_s", SECONDS, |config, n| config.http.header_timeout = Duration::from_secs(n)),
    ("body_timeout_s", SECONDS, |config, n| config.http.body_timeout = Duration::from_secs(n)),
    ("request_timeout_s", SECONDS, |config, n| config.http.request_timeout = Duration::from_secs(n)),
    ("write_timeout_s", SECONDS, |config, n| config.http.write_timeout = Duration::from_secs(n)),
    ("body_idle_s", SECONDS, |config, n| config.http.body_idle = Duration::from_secs(n)),
    ("body_bytes_per_s", 0..=u32::MAX as u64, |config, n| config.http.body_bytes_per_s = n),
    ("requests_per_s", COUNT, |config, n| {
        config.http.requests_per_s = NonZeroU32::new(n as u32).unwrap_or(NonZeroU32::MIN);
    }),
    ("streams", COUNT, |config, n| config.work.streams_at_once = n as usize),
    ("events_kept", COUNT, |config, n| config.http.events_kept = n as usize),
    ("grace_s", SECONDS_OR_NONE, |config, n| config.http.grace = Duration::from_secs(n)),
    ("start_time_ahead_s", SECONDS_OR_NONE, |config, n| {
        config.work.start_time_ahead = Duration::from_secs(n)
    }),
];

impl TryFrom<BTreeMap<String, u64>> for LimitsTable {
    type Error = SettingError;

    fn try_from(given: BTreeMap<String, u64>) -> Result<Self, SettingError> {
        let limit = |(key, number): (String, u64)| {
            let wrong = |expected| SettingError::new(format!("limits.{key}"), number, expected);
            let Some((_, range, set)) = LIMITS.iter().find(|(known, ..)| *known == key) else {
                return Err(wrong(format!("one of the keys {}", LIMITS.map(|(known, ..)| known).join(", "))));
            };
            if !range.contains(&number) {
                return Err(wrong(format!("a whole number from {} to {}", range.start(), range.end())));
            }
            Ok((*set, number))
        };
        given.into_iter().map(limit).collect::<Result<_, _>>().map(Self)
    }
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
        file.limits.0.iter().for_each(|(set, number)| set(&mut config, *number));
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

    /// Resolves a settings file.
    fn resolved(text: &str) -> Result<ServiceConfig, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flankwatch.toml");
        fs::write(&path, text).unwrap();
        let args = ServeArgs { config: Some(path), ..ServeArgs::default() };
        args.resolve().map(|resolved| resolved.service).map_err(|error| error.to_string())
    }

    #[test]
    fn an_unknown_key_is_rejected_by_name() {
        for (text, key) in [("[limits]\nrecord_byte = 1\n", "limits.record_byte is 1"), ("port = 1", "port")]
        {
            let error = resolved(text).unwrap_err();
            assert!(error.contains(key) && error.contains("flankwatch.toml"), "{error}");
        }
    }

    #[test]
    fn every_limit_is_checked_at_the_start() {
        for (key, range, _) in LIMITS {
            for wrong in range.start().checked_sub(1).into_iter().chain([range.end() + 1]) {
                let error = resolved(&format!("[limits]\n{key} = {wrong}\n")).unwrap_err();
                let named =
                    format!("limits.{key} is {wrong}, expected a whole number from {}", range.start());
                assert!(error.contains(&named), "{error}");
            }
            resolved(&format!("[limits]\n{key} = {}\n", range.start())).unwrap();
            resolved(&format!("[limits]\n{key} = {}\n", range.end())).unwrap();
        }
        let may_be_0 = LIMITS.iter().filter(|(_, range, _)| range.contains(&0)).map(|(key, ..)| *key);
        assert_eq!(may_be_0.collect::<Vec<_>>(), ["body_bytes_per_s", "grace_s", "start_time_ahead_s"]);
    }
}
