//! Settings of a store.

use std::path::{Path, PathBuf};

/// The location of a store.
#[derive(Debug, Clone)]
pub enum StoreSettings {
    /// A data folder used by this process alone: SQLite and files.
    Folder(PathBuf),
    /// A store shared by any number of processes: PostgreSQL, and objects that all of them can access.
    #[cfg(feature = "postgres")]
    Shared(SharedSettings),
}

impl From<&Path> for StoreSettings {
    fn from(folder: &Path) -> Self {
        Self::Folder(folder.to_path_buf())
    }
}

/// Settings of a shared store.
#[cfg(feature = "postgres")]
#[derive(Clone)]
pub struct SharedSettings {
    /// The PostgreSQL database, `postgres://user:password@host/name?sslmode=verify-full`.
    pub database_url: String,
    /// Maximum number of write connections of this process.
    pub write_connections: u32,
    /// Maximum number of read connections of this process.
    pub read_connections: u32,
    /// How long a request waits for a connection before the database counts as unavailable.
    pub connect_timeout: std::time::Duration,
    /// Location of raw recordings and libraries.
    pub objects: ObjectsSettings,
    /// Minimum age at which an unreferenced object is removed. Must be longer than any accepted record waits
    /// for its results.
    pub orphan_age: std::time::Duration,
}

#[cfg(feature = "postgres")]
impl SharedSettings {
    /// The default settings for a database and a location of objects.
    pub fn new(database_url: impl Into<String>, objects: ObjectsSettings) -> Self {
        Self {
            database_url: database_url.into(),
            write_connections: 4,
            read_connections: 8,
            connect_timeout: std::time::Duration::from_secs(5),
            objects,
            orphan_age: std::time::Duration::from_secs(7 * 24 * 3600),
        }
    }
}

#[cfg(feature = "postgres")]
impl std::fmt::Debug for SharedSettings {
    /// Without the database's address, which may hold a password.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SharedSettings")
            .field("objects", &self.objects)
            .field("orphan_age", &self.orphan_age)
            .finish_non_exhaustive()
    }
}

/// The location of shared objects.
#[cfg(feature = "postgres")]
#[derive(Debug, Clone)]
pub enum ObjectsSettings {
    /// A folder that every process can access under this path.
    Folder(PathBuf),
    /// A bucket of an S3-compatible object store.
    #[cfg(feature = "s3")]
    Bucket(BucketSettings),
}

/// A bucket of an S3-compatible object store.
#[cfg(feature = "postgres")]
#[derive(Clone)]
pub struct BucketSettings {
    /// Name of the bucket, which must exist.
    pub bucket: String,
    /// URL of the server; by default that of AWS. A URL starting with `http://` is used without TLS.
    pub endpoint: Option<String>,
    /// The region; servers other than AWS accept any.
    pub region: String,
    /// Access key and secret; by default those that AWS provides to the machine.
    pub credentials: Option<BucketCredentials>,
    /// Prefix of the names of all objects; may be empty.
    pub prefix: String,
}

/// Credentials of a bucket.
#[cfg(feature = "postgres")]
#[derive(Clone)]
pub struct BucketCredentials {
    /// The access key's identifier.
    pub access_key_id: String,
    /// Its secret.
    pub secret_access_key: String,
}

#[cfg(feature = "postgres")]
impl std::fmt::Debug for BucketSettings {
    /// Without the credentials.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BucketSettings")
            .field("bucket", &self.bucket)
            .field("endpoint", &self.endpoint)
            .field("region", &self.region)
            .field("prefix", &self.prefix)
            .finish_non_exhaustive()
    }
}
