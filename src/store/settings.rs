//! Where a store is.

use std::path::{Path, PathBuf};

/// Where a store is.
#[derive(Debug, Clone)]
pub enum StoreSettings {
    /// A data folder of this process alone: SQLite and files.
    Folder(PathBuf),
    /// What any number of processes share: PostgreSQL and objects that all of them reach.
    #[cfg(feature = "postgres")]
    Shared(SharedSettings),
}

impl From<&Path> for StoreSettings {
    fn from(folder: &Path) -> Self {
        Self::Folder(folder.to_path_buf())
    }
}

/// A store that processes share.
#[cfg(feature = "postgres")]
#[derive(Clone)]
pub struct SharedSettings {
    /// The PostgreSQL database, `postgres://user:password@host/name?sslmode=verify-full`.
    pub database_url: String,
    /// Connections of this process for transactions that write.
    pub write_connections: u32,
    /// Connections of this process for reading.
    pub read_connections: u32,
    /// How long a request waits for a connection before the database counts as away.
    pub connect_timeout: std::time::Duration,
    /// Where raw recordings and libraries are.
    pub objects: ObjectsSettings,
    /// An object that nothing refers to is removed when it is at least this old. To be longer than anything
    /// that was answered waits for its results.
    pub orphan_age: std::time::Duration,
}

#[cfg(feature = "postgres")]
impl SharedSettings {
    /// The defaults for a database and a place of objects.
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

/// Where shared objects are.
#[cfg(feature = "postgres")]
#[derive(Debug, Clone)]
pub enum ObjectsSettings {
    /// A folder that every process reaches under this path.
    Folder(PathBuf),
    /// A bucket of an S3-compatible object store.
    #[cfg(feature = "s3")]
    Bucket(BucketSettings),
}

/// A bucket of an S3-compatible object store.
#[cfg(feature = "postgres")]
#[derive(Clone)]
pub struct BucketSettings {
    /// The bucket, which is there already.
    pub bucket: String,
    /// Address of the server; that of AWS where not given. One that begins with `http://` is spoken to
    /// without TLS.
    pub endpoint: Option<String>,
    /// The region; servers other than AWS take any.
    pub region: String,
    /// Key and secret; where not given those that AWS gives the machine it runs on.
    pub credentials: Option<BucketCredentials>,
    /// What the names of all objects begin with; may be empty.
    pub prefix: String,
}

/// Who uses a bucket.
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
