//! Objects in a bucket of an S3-compatible store: `raw/ab/abcdef…`, `libraries/….fwlib` and
//! `uploads/…/abcdef…`.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use jiff::Timestamp;
use object_store::aws::{AmazonS3, AmazonS3Builder};
use object_store::path::Path;
use object_store::{BackoffConfig, ClientOptions, Error, ObjectStore, ObjectStoreExt, PutMode, RetryConfig};
use tokio::runtime::Handle;

use super::{Backend, ListedFile, ListedObject, StoreError, is_name};
use crate::store::BucketSettings;

/// Maximum number of concurrent requests of one call.
const REQUESTS_AT_ONCE: usize = 8;

/// Maximum size of an object that is read; no recording is larger.
const MAX_BYTES: u64 = 1 << 30;

/// Timeout of one request, after which it is retried.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(30);

/// Time for which a call is retried before the store counts as unavailable.
const RETRIED_FOR: Duration = Duration::from_secs(10);

/// A bucket.
#[derive(Debug)]
pub(super) struct Bucket {
    store: Arc<AmazonS3>,
    prefix: String,
    runtime: Handle,
}

impl Bucket {
    /// Opens a bucket. Must be called inside a Tokio runtime, which then performs the requests.
    pub(super) fn open(settings: &BucketSettings) -> Result<Self, StoreError> {
        // The client uses the process-wide crypto provider. If one is installed already, this has no effect.
        let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
        let prefix = settings.prefix.trim_matches('/');
        let is_plain = settings.endpoint.as_deref().is_some_and(|endpoint| endpoint.starts_with("http://"));
        let client = ClientOptions::new()
            .with_timeout(REQUEST_TIMEOUT)
            .with_connect_timeout(Duration::from_secs(5))
            .with_allow_http(is_plain);
        let retry =
            RetryConfig { backoff: BackoffConfig::default(), max_retries: 5, retry_timeout: RETRIED_FOR };
        let mut builder = AmazonS3Builder::new()
            .with_bucket_name(&settings.bucket)
            .with_region(&settings.region)
            .with_client_options(client)
            .with_retry(retry);
        if let Some(endpoint) = &settings.endpoint {
            builder = builder.with_endpoint(endpoint);
        }
        if let Some(credentials) = &settings.credentials {
            builder = builder
                .with_access_key_id(&credentials.access_key_id)
                .with_secret_access_key(&credentials.secret_access_key);
        }
        let store = builder.build().map_err(|error| bucket_error("open", &settings.bucket, error))?;
        Ok(Self {
            store: Arc::new(store),
            prefix: if prefix.is_empty() { String::new() } else { format!("{prefix}/") },
            runtime: Handle::current(),
        })
    }

    async fn put(&self, path: Path, bytes: Bytes) -> Result<(), StoreError> {
        let put = self.store.put(&path, bytes.into()).await;
        put.map(|_| ()).map_err(|error| bucket_error("store", path.as_ref(), error))
    }

    async fn fetch(&self, path: Path) -> Result<Option<Bytes>, StoreError> {
        let failed = |error| bucket_error("read", path.as_ref(), error);
        let found = match self.store.get(&path).await {
            Ok(found) => found,
            Err(Error::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(failed(error)),
        };
        if found.meta.size > MAX_BYTES {
            return Err(StoreError::Unexpected {
                what: "size of an object in bytes",
                value: found.meta.size.to_string(),
                expected: "at most 1 GiB",
            });
        }
        found.bytes().await.map(Some).map_err(failed)
    }

    fn at(&self, path: &str) -> Path {
        Path::from(format!("{}{path}", self.prefix))
    }
}

impl Backend for Bucket {
    /// An existing object is written again to reset its age, so that it is not removed as
    /// an old orphan before its results are committed.
    fn put_all(&self, objects: &[(String, Bytes)], note: Option<(String, Bytes)>) -> Result<(), StoreError> {
        let objects = objects.iter().map(|(name, bytes)| (self.object_path(name), bytes.clone()));
        let puts = objects.chain(note).map(|(path, bytes)| self.put(self.at(&path), bytes));
        self.runtime.block_on(async {
            let mut puts = stream::iter(puts).buffer_unordered(REQUESTS_AT_ONCE);
            while let Some(put) = puts.next().await {
                put?;
            }
            Ok(())
        })
    }

    fn list(&self, shard: u8) -> Result<Vec<ListedObject>, StoreError> {
        let folder = format!("{}raw/{shard:02x}", self.prefix);
        let listed = self.store.list(Some(&Path::from(folder.as_str())));
        let listed = self.runtime.block_on(listed.try_collect::<Vec<_>>());
        let listed = listed.map_err(|error| bucket_error("list", &folder, error))?;
        let object = |found: object_store::ObjectMeta| {
            let name = found.location.filename().filter(|name| is_name(name))?;
            Some(ListedObject { name: name.to_owned(), bytes: found.size, written_at: timestamp(&found) })
        };
        Ok(listed.into_iter().filter_map(object).collect())
    }

    fn put_file(&self, path: &str, bytes: Bytes) -> Result<(), StoreError> {
        self.runtime.block_on(self.put(self.at(path), bytes))
    }

    fn create_file(&self, path: &str, bytes: Bytes) -> Result<bool, StoreError> {
        let path = self.at(path);
        let created = self.store.put_opts(&path, bytes.into(), PutMode::Create.into());
        match self.runtime.block_on(created) {
            Ok(_) => Ok(true),
            Err(Error::AlreadyExists { .. }) => Ok(false),
            Err(error) => Err(bucket_error("store", path.as_ref(), error)),
        }
    }

    fn file(&self, path: &str) -> Result<Option<Bytes>, StoreError> {
        self.runtime.block_on(self.fetch(self.at(path)))
    }

    fn metadata(&self, path: &str) -> Result<Option<(u64, Timestamp)>, StoreError> {
        let path = self.at(path);
        match self.runtime.block_on(self.store.head(&path)) {
            Ok(found) => Ok(Some((found.size, timestamp(&found)))),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(bucket_error("read the metadata of", path.as_ref(), error)),
        }
    }

    fn files(&self, under: &str) -> Result<Vec<ListedFile>, StoreError> {
        let listed = self.store.list(Some(&self.at(under)));
        let listed = self.runtime.block_on(listed.try_collect::<Vec<_>>());
        let listed = listed.map_err(|error| bucket_error("list", under, error))?;
        let file = |found: object_store::ObjectMeta| {
            Some(ListedFile {
                path: found.location.as_ref().strip_prefix(&self.prefix)?.to_owned(),
                bytes: found.size,
            })
        };
        Ok(listed.into_iter().filter_map(file).collect())
    }

    fn move_file(&self, from: &str, to: &str) -> Result<(), StoreError> {
        // The copy is written before the original is removed.
        match self.runtime.block_on(self.store.copy(&self.at(from), &self.at(to))) {
            Ok(()) => self.remove_file(from),
            Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(bucket_error("move", from, error)),
        }
    }

    fn remove_file(&self, path: &str) -> Result<(), StoreError> {
        match self.runtime.block_on(self.store.delete(&self.at(path))) {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(bucket_error("remove", path, error)),
        }
    }

    fn object_path(&self, name: &str) -> String {
        format!("raw/{}/{name}", name.get(..2).unwrap_or("xx"))
    }

    fn remove_pieces(&self, upload: &str) -> Result<(), StoreError> {
        let folder = Path::from(format!("{}uploads/{upload}", self.prefix));
        let failed = |error| bucket_error("remove", folder.as_ref(), error);
        self.runtime.block_on(async {
            let listed: Vec<_> = self.store.list(Some(&folder)).try_collect().await.map_err(failed)?;
            for piece in listed {
                match self.store.delete(&piece.location).await {
                    Ok(()) | Err(Error::NotFound { .. }) => {}
                    Err(error) => return Err(failed(error)),
                }
            }
            Ok(())
        })
    }

    fn uploads(&self) -> Result<Vec<String>, StoreError> {
        let folder = Path::from(format!("{}uploads", self.prefix));
        let listed = self.runtime.block_on(self.store.list_with_delimiter(Some(&folder)));
        let listed = listed.map_err(|error| bucket_error("list", folder.as_ref(), error))?;
        let names = listed.common_prefixes.iter().filter_map(|upload| upload.filename());
        Ok(names.map(str::to_owned).collect())
    }
}

fn timestamp(found: &object_store::ObjectMeta) -> Timestamp {
    Timestamp::from_second(found.last_modified.timestamp()).unwrap_or(Timestamp::MAX)
}

fn bucket_error(action: &'static str, name: &str, source: Error) -> StoreError {
    StoreError::Bucket { action, name: name.to_owned(), source: Box::new(source) }
}
