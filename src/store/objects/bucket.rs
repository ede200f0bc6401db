//! Objects in a bucket of an S3-compatible store: `raw/ab/abcdef…`, `libraries/….fwlib` and
//! `uploads/…/abcdef…`.

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
const MAX_CONCURRENT_REQUESTS: usize = 8;

/// Maximum size of an object that is read; no recording is larger.
const MAX_BYTES: u64 = 1 << 30;

/// Time for which the store may be silent, after which a request is retried once. It includes the time to
/// send a body, so that large ones have a timeout of their own.
const SILENT_FOR: Duration = Duration::from_secs(15);

/// Size in bytes from which on a body counts as large.
const LARGE_BYTES: usize = 1 << 20;

/// Timeout of a request that sends a large body: a recording of 256 MiB needs 0.9 MB/s. A connection that is
/// cut off fails sooner: the system closes it after 30 s without an acknowledgement.
const LARGE_SENT_FOR: Duration = Duration::from_secs(300);

/// Time to connect.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum number of retries of a request that fails at once.
const MAX_RETRIES: usize = 5;

/// A bucket.
#[derive(Debug)]
pub(super) struct Bucket {
    store: AmazonS3,
    /// The same bucket for requests that send a large body.
    large: AmazonS3,
    prefix: String,
    runtime: Handle,
}

impl Bucket {
    /// Opens a bucket. Must be called inside a Tokio runtime, which then performs the requests.
    pub(super) fn open(settings: &BucketSettings) -> Result<Self, StoreError> {
        Self::open_with(settings, SILENT_FOR, LARGE_SENT_FOR)
    }

    fn open_with(
        settings: &BucketSettings,
        silent_for: Duration,
        large_sent_for: Duration,
    ) -> Result<Self, StoreError> {
        // The client uses the process-wide crypto provider. If one is installed already, this has no effect.
        let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
        let prefix = settings.prefix.trim_matches('/');
        Ok(Self {
            store: client(settings, silent_for)?,
            large: client(settings, large_sent_for)?,
            prefix: if prefix.is_empty() { String::new() } else { format!("{prefix}/") },
            runtime: Handle::current(),
        })
    }

    async fn put(&self, path: Path, bytes: Bytes) -> Result<(), StoreError> {
        let store = if bytes.len() < LARGE_BYTES { &self.store } else { &self.large };
        let put = store.put(&path, bytes.into()).await;
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
    fn put_all(
        &self,
        objects: &[(String, Bytes)],
        metadata: Option<(String, Bytes)>,
    ) -> Result<(), StoreError> {
        let objects = objects.iter().map(|(name, bytes)| (self.object_path(name), bytes.clone()));
        let puts = objects.chain(metadata).map(|(path, bytes)| self.put(self.at(&path), bytes));
        self.runtime.block_on(async {
            let mut puts = stream::iter(puts).buffer_unordered(MAX_CONCURRENT_REQUESTS);
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

    fn part(&self, path: &str, offset: u64, length: usize) -> Result<Option<Bytes>, StoreError> {
        let path = self.at(path);
        match self.runtime.block_on(self.store.get_range(&path, offset..offset + length as u64)) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(bucket_error("read", path.as_ref(), error)),
        }
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

/// A client whose requests are retried after this time without a byte from the store.
fn client(settings: &BucketSettings, silent_for: Duration) -> Result<AmazonS3, StoreError> {
    let is_plain = settings.endpoint.as_deref().is_some_and(|endpoint| endpoint.starts_with("http://"));
    let client = ClientOptions::new()
        // It would include the time to read a body.
        .with_timeout_disabled()
        .with_read_timeout(silent_for)
        .with_connect_timeout(CONNECT_TIMEOUT)
        .with_allow_http(is_plain);
    let retry = RetryConfig {
        backoff: BackoffConfig::default(),
        max_retries: MAX_RETRIES,
        // Longer than one attempt, and shorter than two.
        retry_timeout: silent_for + silent_for / 3,
    };
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
    builder.build().map_err(|error| bucket_error("open", &settings.bucket, error))
}

fn timestamp(found: &object_store::ObjectMeta) -> Timestamp {
    Timestamp::from_second(found.last_modified.timestamp()).unwrap_or(Timestamp::MAX)
}

fn bucket_error(action: &'static str, name: &str, source: Error) -> StoreError {
    StoreError::Bucket { action, name: name.to_owned(), source: Box::new(source) }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader, Read, Write};
    use std::net::{TcpListener, TcpStream};

    use super::*;
    use crate::store::BucketCredentials;

    const SILENT: Duration = Duration::from_millis(500);

    /// A bucket whose server answers each connection by `handle_connection`, given its number.
    fn bucket(
        handle_connection: impl Fn(u32, BufReader<TcpStream>) + Send + Sync + Clone + 'static,
    ) -> Bucket {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let settings = BucketSettings {
            bucket: "records".to_owned(),
            endpoint: Some(format!("http://{}", listener.local_addr().unwrap())),
            region: "us-east-1".to_owned(),
            credentials: Some(BucketCredentials {
                access_key_id: "test".to_owned(),
                secret_access_key: "test".to_owned(),
            }),
            prefix: String::new(),
        };
        std::thread::spawn(move || {
            for (number, connection) in (0..).zip(listener.incoming().flatten()) {
                let handle_connection = handle_connection.clone();
                std::thread::spawn(move || handle_connection(number, BufReader::new(connection)));
            }
        });
        Bucket::open_with(&settings, SILENT, 10 * SILENT).unwrap()
    }

    /// Reads the head of a request; returns the length of its body.
    fn read_head(connection: &mut BufReader<TcpStream>) -> usize {
        let mut bytes = 0;
        loop {
            let mut line = String::new();
            connection.read_line(&mut line).unwrap();
            match line.trim().to_lowercase().split_once(": ") {
                Some(("content-length", length)) => bytes = length.parse().unwrap(),
                None if line.trim().is_empty() => return bytes,
                _ => {}
            }
        }
    }

    fn send(connection: &BufReader<TcpStream>, bytes: &[u8]) {
        connection.get_ref().write_all(bytes).unwrap();
    }

    fn send_head(connection: &BufReader<TcpStream>, length: usize) {
        let head = format!(
            "HTTP/1.1 200 OK\r\nContent-Length: {length}\r\nETag: \"1\"\r\nLast-Modified: Thu, 01 Jan 2026 00:00:00 GMT\r\n\r\n"
        );
        send(connection, head.as_bytes());
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_slow_body_is_read_to_its_end() {
        let bucket = bucket(|_, mut connection| {
            read_head(&mut connection);
            send_head(&connection, 8);
            for byte in b"a record" {
                std::thread::sleep(SILENT / 3);
                send(&connection, &[*byte]);
            }
        });
        let read = tokio::task::spawn_blocking(move || bucket.file("a").unwrap()).await.unwrap();
        assert_eq!(read.unwrap(), &b"a record"[..]);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_request_without_a_response_is_retried() {
        let bucket = bucket(|number, mut connection| {
            read_head(&mut connection);
            if number == 0 {
                std::thread::sleep(4 * SILENT);
                return;
            }
            send_head(&connection, 1);
            send(&connection, b"a");
        });
        let read = tokio::task::spawn_blocking(move || bucket.file("a").unwrap()).await.unwrap();
        assert_eq!(read.unwrap(), &b"a"[..]);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_large_body_may_be_sent_slowly() {
        let bucket = bucket(|number, mut connection| {
            assert_eq!(number, 0, "it is sent once");
            let length = read_head(&mut connection);
            std::thread::sleep(3 * SILENT);
            connection.read_exact(&mut vec![0; length]).unwrap();
            send_head(&connection, 0);
        });
        let bytes = Bytes::from(vec![7; LARGE_BYTES]);
        tokio::task::spawn_blocking(move || bucket.put_file("a", bytes).unwrap()).await.unwrap();
    }
}
