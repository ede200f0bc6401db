//! The table `cluster` of the settings file.

use std::path::PathBuf;
use std::time::Duration;

use axum::http::Uri;
use serde::Deserialize;

use super::error::at_least;
use super::nats_settings::NatsTable;
use super::{NatsSettings, WorkerLimits};
use crate::settings::{SettingError, host_and_port};
use crate::store::{BucketCredentials, BucketSettings, ObjectsSettings, SharedSettings};

/// Maximum length of a cluster's name in bytes; the name is the prefix of stream names.
const MAX_NAME: usize = 64;

/// The table `cluster`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClusterTable {
    /// The cluster's name.
    name: Option<String>,
    database: DatabaseTable,
    nats: NatsTable,
    objects: ObjectsTable,
    worker: WorkerLimits,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct DatabaseTable {
    url: Option<String>,
    write_connections: Option<u32>,
    read_connections: Option<u32>,
    connect_timeout_s: Option<u64>,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct ObjectsTable {
    bucket: Option<String>,
    folder: Option<PathBuf>,
    endpoint: Option<String>,
    region: Option<String>,
    prefix: Option<String>,
    orphan_age_s: Option<u64>,
}

/// Secrets of the environment, for those who do not write them into a file.
#[derive(Clone, Default)]
pub struct ClusterSecrets {
    /// Address of the database with name and password; overrides that of the file.
    pub database_url: Option<String>,
    /// Password of the NATS user.
    pub nats_password: Option<String>,
    /// Token for NATS.
    pub nats_token: Option<String>,
    /// Access key ID of the object store.
    pub s3_access_key_id: Option<String>,
    /// Secret access key of the object store.
    pub s3_secret_access_key: Option<String>,
}

/// Settings of a cluster's process.
#[derive(Clone)]
pub struct ClusterSettings {
    /// The store that all processes share.
    pub store: SharedSettings,
    /// The connection to NATS and the streams.
    pub nats: NatsSettings,
    /// Limits of a worker.
    pub worker: WorkerLimits,
}

impl ClusterTable {
    /// Resolves the table with the secrets of the environment.
    ///
    /// # Errors
    /// [`SettingError`] with the field, its value and what was expected.
    pub fn resolve(self, secrets: ClusterSecrets) -> Result<ClusterSettings, SettingError> {
        let name = self.name.unwrap_or_else(|| "flankwatch".to_owned());
        let is_valid =
            |name: &str| name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte));
        if name.is_empty() || name.len() > MAX_NAME || !is_valid(&name) {
            return Err(SettingError::new(
                "cluster.name",
                name,
                "1 to 64 characters of a-z, A-Z, 0-9, - and _",
            ));
        }
        let objects = self.objects.resolve(&secrets)?;
        let mut store = self.database.resolve(secrets.database_url, objects)?;
        if let Some(age) = self.objects.orphan_age_s {
            // Younger objects may belong to records in the queue.
            store.orphan_age = Duration::from_secs(at_least("cluster.objects.orphan_age_s", age, 3600)?);
        }
        let nats = self.nats.resolve(name, secrets.nats_password, secrets.nats_token)?;
        Ok(ClusterSettings { store, nats, worker: self.worker.check()? })
    }
}

impl DatabaseTable {
    fn resolve(
        self,
        secret_url: Option<String>,
        objects: ObjectsSettings,
    ) -> Result<SharedSettings, SettingError> {
        let missing = "postgres://user:password@host/name, here or in FLANKWATCH_DATABASE_URL";
        let url = secret_url.or(self.url);
        let url = url.ok_or_else(|| SettingError::new("cluster.database.url", "missing", missing))?;
        let is_postgres = url.starts_with("postgres://") || url.starts_with("postgresql://");
        if !is_postgres {
            // Only the scheme is repeated: the rest may contain a password.
            let scheme = url.split("://").next().unwrap_or_default();
            return Err(SettingError::new(
                "cluster.database.url",
                format!("{scheme}://…"),
                "postgres://user:password@host/name",
            ));
        }
        let uri: Option<Uri> = url.parse().ok();
        if uri.is_some_and(|uri| uri.authority().is_some() && host_and_port(&uri).is_none()) {
            // A URL without a host names a socket.
            let expected = "postgres://user:password@host[:port]/name, with a port from 1 to 65535";
            return Err(SettingError::new("cluster.database.url", "a URL with an invalid port", expected));
        }
        let mut settings = SharedSettings::new(url, objects);
        if let Some(connections) = self.write_connections {
            settings.write_connections = at_least("cluster.database.write_connections", connections, 1)?;
        }
        if let Some(connections) = self.read_connections {
            settings.read_connections = at_least("cluster.database.read_connections", connections, 1)?;
        }
        if let Some(timeout) = self.connect_timeout_s {
            settings.connect_timeout =
                Duration::from_secs(at_least("cluster.database.connect_timeout_s", timeout, 1)?);
        }
        Ok(settings)
    }
}

impl ObjectsTable {
    fn resolve(&self, secrets: &ClusterSecrets) -> Result<ObjectsSettings, SettingError> {
        let lacks = |field, expected| Err(SettingError::new(field, "missing", expected));
        let credentials = match (&secrets.s3_access_key_id, &secrets.s3_secret_access_key) {
            (Some(id), Some(secret)) => {
                Some(BucketCredentials { access_key_id: id.clone(), secret_access_key: secret.clone() })
            }
            (None, None) => None,
            (Some(_), None) => {
                let expected = "the secret of FLANKWATCH_S3_ACCESS_KEY_ID";
                return lacks("FLANKWATCH_S3_SECRET_ACCESS_KEY", expected);
            }
            (None, Some(_)) => {
                let expected = "the key of FLANKWATCH_S3_SECRET_ACCESS_KEY";
                return lacks("FLANKWATCH_S3_ACCESS_KEY_ID", expected);
            }
        };
        match (&self.bucket, &self.folder) {
            (Some(bucket), None) => {
                self.check_bucket(bucket)?;
                in_bucket(BucketSettings {
                    bucket: bucket.clone(),
                    endpoint: self.endpoint.clone(),
                    region: self.region.clone().unwrap_or_else(|| "us-east-1".to_owned()),
                    credentials,
                    prefix: self.prefix.clone().unwrap_or_default(),
                })
            }
            (None, Some(folder)) => {
                let of_bucket = [
                    ("cluster.objects.endpoint", &self.endpoint),
                    ("cluster.objects.region", &self.region),
                    ("cluster.objects.prefix", &self.prefix),
                ];
                match of_bucket.into_iter().find_map(|(field, value)| Some((field, value.as_ref()?))) {
                    Some((field, value)) => Err(SettingError::new(
                        field,
                        value,
                        "no value with cluster.objects.folder, only with a bucket",
                    )),
                    None => Ok(ObjectsSettings::Folder(folder.clone())),
                }
            }
            (None, None) => lacks("cluster.objects", "a bucket, or a folder that every process can access"),
            (Some(_), Some(_)) => {
                Err(SettingError::new("cluster.objects", "a bucket and a folder", "only one of them"))
            }
        }
    }
}

impl ObjectsTable {
    /// The client library panics on such values, or uses another address.
    fn check_bucket(&self, bucket: &str) -> Result<(), SettingError> {
        let is_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
        if bucket.is_empty() || !bucket.chars().all(is_name) {
            let expected = "a name of letters, digits, '.', '-' and '_'";
            return Err(SettingError::new("cluster.objects.bucket", bucket, expected));
        }
        if let Some(endpoint) = &self.endpoint {
            let url: Option<Uri> = endpoint.parse().ok();
            let is_usable = url.is_some_and(|url| {
                matches!(url.scheme_str(), Some("http" | "https"))
                    && host_and_port(&url).is_some()
                    && url.query().is_none()
            });
            if !is_usable {
                let expected = "http://host[:port] or https://host[:port], with a port from 1 to 65535";
                return Err(SettingError::new("cluster.objects.endpoint", endpoint, expected));
            }
        }
        let prefix = self.prefix.as_deref().unwrap_or_default();
        if prefix.starts_with('/') || prefix.split('/').any(|level| matches!(level, "." | "..")) {
            let expected = "the first levels of names, without a leading '/', '.' or '..'";
            return Err(SettingError::new("cluster.objects.prefix", prefix, expected));
        }
        Ok(())
    }
}

#[cfg(feature = "s3")]
fn in_bucket(settings: BucketSettings) -> Result<ObjectsSettings, SettingError> {
    Ok(ObjectsSettings::Bucket(settings))
}

#[cfg(not(feature = "s3"))]
fn in_bucket(_: BucketSettings) -> Result<ObjectsSettings, SettingError> {
    Err(SettingError::WithoutFeature { field: "cluster.objects.bucket", feature: "s3" })
}

#[cfg(all(test, feature = "cluster"))]
mod tests {
    use super::*;

    const WHOLE: &str = r#"
        [database]
        url = "postgres://flankwatch@db/flankwatch"
        [nats]
        urls = ["nats://a:4222", "nats://b:4222"]
        user = "flankwatch"
        replicas = 3
        [objects]
        bucket = "records"
        endpoint = "http://minio:9000"
        [worker]
        at_once = 3
    "#;

    fn resolve(text: &str, secrets: ClusterSecrets) -> Result<ClusterSettings, String> {
        let table: ClusterTable = toml::from_str(text).map_err(|error| error.to_string())?;
        table.resolve(secrets).map_err(|error| error.to_string())
    }

    fn with_password() -> ClusterSecrets {
        ClusterSecrets { nats_password: Some("secret".into()), ..ClusterSecrets::default() }
    }

    #[test]
    fn a_complete_table_is_resolved() {
        let settings = resolve(WHOLE, with_password()).unwrap();
        assert_eq!((settings.nats.urls.len(), settings.nats.replicas, settings.worker.at_once), (2, 3, 3));
        assert_eq!(settings.nats.name, "flankwatch");
        assert!(
            matches!(settings.store.objects, ObjectsSettings::Bucket(bucket) if bucket.bucket == "records")
        );
    }

    #[test]
    fn the_environment_overrides_the_file() {
        let secrets =
            ClusterSecrets { database_url: Some("postgres://x:y@elsewhere/z".into()), ..with_password() };
        assert_eq!(resolve(WHOLE, secrets).unwrap().store.database_url, "postgres://x:y@elsewhere/z");
    }

    #[test]
    fn errors_name_the_setting_and_its_value_but_no_secret() {
        let without = |line: &str| WHOLE.replace(line, "");
        for (text, words) in [
            (
                without("[database]\n        url = \"postgres://flankwatch@db/flankwatch\""),
                vec!["cluster.database.url", "missing"],
            ),
            (
                WHOLE.replace("postgres://flankwatch@", "mysql://u:hidden@"),
                vec!["cluster.database.url", "mysql"],
            ),
            (WHOLE.replace("nats://b", "http://b"), vec!["cluster.nats.urls", "http://b:4222"]),
            (WHOLE.replace("nats://b", "nats://u:hidden@b"), vec!["cluster.nats.urls", "no user in it"]),
            (without("user = \"flankwatch\""), vec!["cluster.nats.user", "missing"]),
            (WHOLE.replace("replicas = 3", "replicas = 9"), vec!["cluster.nats.replicas", "9", "1 to 5"]),
            (WHOLE.replace("at_once = 3", "at_once = 0"), vec!["cluster.worker.at_once", "0", "at least 1"]),
            (without("bucket = \"records\""), vec!["cluster.objects", "missing"]),
            (
                WHOLE.replace("bucket = \"records\"", "folder = \"/records\""),
                vec!["cluster.objects.endpoint", "http://minio:9000", "cluster.objects.folder"],
            ),
            (
                WHOLE.replace("http://minio:9000", "minio:9000"),
                vec!["cluster.objects.endpoint", "http://host"],
            ),
            (WHOLE.replace("minio:9000", "minio:99999"), vec!["cluster.objects.endpoint", "65535"]),
            (WHOLE.replace("http://minio:9000", ""), vec!["cluster.objects.endpoint is empty"]),
            (WHOLE.replace("\"records\"", "\"Rec ords\""), vec!["cluster.objects.bucket", "Rec ords"]),
            (WHOLE.replace("nats://b:4222", "nats://b:99999"), vec!["cluster.nats.urls", "nats://b:99999"]),
            (WHOLE.replace("@db/", "@db:99999/"), vec!["cluster.database.url", "65535"]),
            (WHOLE.replace("at_once", "at_onec"), vec!["at_onec"]),
            (format!("name = \"a.b\"\n{WHOLE}"), vec!["cluster.name", "a.b"]),
        ] {
            let error = resolve(&text, with_password()).map(|_| ()).unwrap_err();
            for word in words {
                assert!(error.contains(word), "{word:?} in {error:?}");
            }
            assert!(!error.contains("hidden"), "{error}");
        }
        let error = resolve(WHOLE, ClusterSecrets::default()).map(|_| ()).unwrap_err();
        assert!(error.contains("FLANKWATCH_NATS_PASSWORD"), "{error}");
    }
}
