//! Opening the database: its location, the durability of its writes, and the lock of its folder.

pub(super) mod integrity;
pub(super) mod rows;
pub(super) mod schema;
pub(super) mod watched;

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

use sqlx::any::AnyPoolOptions;
use sqlx::{AnyConnection, AnyPool, Connection, Executor, SqliteConnection};

use crate::store::StoreError;
use crate::store::objects::file_error;
use integrity::Damage;
use schema::Dialect;
use watched::{Watch, WatchedPool};

/// Connections to the database.
#[derive(Debug)]
pub(in crate::store) struct Database {
    /// The SQL dialect.
    pub(in crate::store) dialect: Dialect,
    /// With SQLite a single connection: writers queue here instead of meeting a locked database, and two
    /// never write or checkpoint at the same time, which can corrupt the database before SQLite 3.51.3 (its
    /// "WAL-reset" bug).
    pub(in crate::store) write: WatchedPool,
    /// Readers see the last committed state and never wait for a writer.
    pub(in crate::store) read: WatchedPool,
    /// Held for the lifetime of the process, so that no other process uses the folder.
    lock: Option<File>,
    /// The file of an SQLite database.
    pub(in crate::store) path: Option<PathBuf>,
    /// The known damage.
    pub(in crate::store) damage: Damage,
}

impl Database {
    /// Closes both pools and releases the folder. The lock is released explicitly, because a child process
    /// that is being started may hold a copy of its descriptor.
    pub(in crate::store) async fn close(&self) {
        self.read.close().await;
        self.write.close().await;
        if let Some(lock) = &self.lock
            && let Err(error) = lock.unlock()
        {
            tracing::warn!(%error, "failed to unlock the data folder");
        }
    }

    /// Opens `flankwatch.db` in the folder; creates both if missing, and migrates the schema.
    pub(in crate::store) async fn open_folder(folder: &Path) -> Result<Self, StoreError> {
        fs::create_dir_all(folder).map_err(|source| file_error("create the data folder", folder, source))?;
        let lock_path = folder.join("lock");
        let lock = File::create(&lock_path)
            .map_err(|source| file_error("write to the data folder with", &lock_path, source))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(StoreError::InUse(folder.to_path_buf())),
            Err(TryLockError::Error(source)) => return Err(file_error("lock", &lock_path, source)),
        }
        let path = fs::canonicalize(folder)
            .map_err(|source| file_error("find the data folder", folder, source))?
            .join("flankwatch.db");
        sqlx::any::install_default_drivers();
        let url = sqlite_url(&path, "rwc");
        integrity::check_header(&path)?;
        let damage = check(&path, &url).await?;
        let watch = Some(Watch { damage: damage.clone(), path: path.clone() });
        let write = WatchedPool::new(pool(&url, 1).await?, watch.clone());
        let mut connection = write.acquire().await?;
        schema::migrate(&mut connection, Dialect::Sqlite)
            .await
            .map_err(|error| integrity::named(&path, error))?;
        drop(connection);
        let read = WatchedPool::new(pool(&url, 4).await?, watch);
        Ok(Self { dialect: Dialect::Sqlite, write, read, lock: Some(lock), path: Some(path), damage })
    }

    /// Opens `flankwatch.db` in the folder for reading, also while another process uses it.
    pub(in crate::store) async fn open_folder_to_read(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join("flankwatch.db");
        let path =
            fs::canonicalize(&path).map_err(|source| file_error("find the database", &path, source))?;
        sqlx::any::install_default_drivers();
        integrity::check_header(&path)?;
        let named = |error| integrity::named(&path, error);
        let mut connection = AnyConnection::connect(&sqlite_url(&path, "ro")).await.map_err(named)?;
        integrity::check_schema(&mut connection).await.map_err(named)?;
        connection.close().await?;
        let read = AnyPoolOptions::new()
            .max_connections(2)
            .acquire_timeout(std::time::Duration::from_secs(10))
            .connect(&sqlite_url(&path, "ro"))
            .await?;
        let read = WatchedPool::new(read, None);
        Ok(Self {
            dialect: Dialect::Sqlite,
            write: read.clone(),
            read,
            lock: None,
            path: Some(path),
            damage: Damage::default(),
        })
    }

    /// Connects to a shared PostgreSQL database, and migrates the schema.
    #[cfg(feature = "postgres")]
    pub(in crate::store) async fn connect(
        settings: &crate::store::SharedSettings,
    ) -> Result<Self, StoreError> {
        sqlx::any::install_default_drivers();
        let write = WatchedPool::new(shared_pool(settings, settings.write_connections).await?, None);
        let mut connection = write.acquire().await?;
        // Without timeouts: another process may be migrating.
        connection.execute("SET lock_timeout = 0; SET statement_timeout = 0").await?;
        schema::migrate(&mut connection, Dialect::Postgres).await?;
        connection.execute(SESSION).await?;
        drop(connection);
        let read = WatchedPool::new(shared_pool(settings, settings.read_connections).await?, None);
        Ok(Self {
            dialect: Dialect::Postgres,
            write,
            read,
            lock: None,
            path: None,
            damage: Damage::default(),
        })
    }
}

/// Settings of every PostgreSQL session: commits are durable, and a process that is gone or disconnected does
/// not hold locks for long.
#[cfg(feature = "postgres")]
const SESSION: &str = "
    SET application_name = 'flankwatch';
    SET default_transaction_isolation = 'read committed';
    SET synchronous_commit = on;
    SET lock_timeout = '10s';
    SET statement_timeout = '60s';
    SET idle_in_transaction_session_timeout = '30s';
    SET tcp_keepalives_idle = 10;
    SET tcp_keepalives_interval = 5;
    SET tcp_keepalives_count = 3;
    SET client_min_messages = warning";

/// A pool that reconnects by itself after the database was unavailable.
#[cfg(feature = "postgres")]
async fn shared_pool(
    settings: &crate::store::SharedSettings,
    connections: u32,
) -> Result<AnyPool, sqlx::Error> {
    AnyPoolOptions::new()
        .max_connections(connections.max(1))
        .acquire_timeout(settings.connect_timeout)
        .after_connect(|connection, _| Box::pin(async move { connection.execute(SESSION).await.map(|_| ()) }))
        .connect(&settings.database_url)
        .await
}

/// The settings of an SQLite connection, as one text: each statement by itself would be a round trip to the
/// connection's thread.
///
/// A commit returns once the write-ahead log is durable. The cache is small (4 MB), since the file is in the
/// system's cache too, and there are five connections.
const PRAGMAS: &str = "
    PRAGMA busy_timeout = 10000;
    PRAGMA journal_mode = WAL;
    PRAGMA synchronous = FULL;
    PRAGMA foreign_keys = ON;
    PRAGMA cache_size = -4096";

async fn prepare(connection: &mut AnyConnection) -> Result<(), sqlx::Error> {
    connection.execute(PRAGMAS).await.map(|_| ())
}

/// Checks a database as far as a start waits for, by a connection of its own: a pool would retry for half a
/// minute, and then hide the cause of a failure.
async fn check(path: &Path, url: &str) -> Result<Damage, StoreError> {
    let named = |error| integrity::named(path, error);
    let mut connection = SqliteConnection::connect(url).await.map_err(named)?;
    integrity::check_schema(&mut connection).await.map_err(named)?;
    connection.execute(PRAGMAS).await.map_err(named)?;
    integrity::check_pages(path, connection).await
}

async fn pool(url: &str, connections: u32) -> Result<AnyPool, sqlx::Error> {
    AnyPoolOptions::new()
        .max_connections(connections)
        // A file does not hang up: a ping would only cost a round trip to the connection's thread.
        .test_before_acquire(false)
        .after_connect(|connection, _| Box::pin(prepare(connection)))
        .before_acquire(|connection, _| {
            // A transaction that a full disk aborts stays open for sqlx. Later records would then run inside
            // a savepoint that nobody commits: acknowledged, but lost.
            let is_usable = !connection.is_in_transaction();
            if !is_usable {
                tracing::warn!("found a transaction left open: closing its database connection");
            }
            Box::pin(async move { Ok(is_usable) })
        })
        .connect(url)
        .await
}

/// The path as a URL, with all special bytes escaped.
pub(in crate::store) fn sqlite_url(path: &Path, mode: &str) -> String {
    let mut url = String::from("sqlite://");
    for byte in path.to_string_lossy().bytes() {
        if byte.is_ascii_alphanumeric() || b"/-._~".contains(&byte) {
            url.push(char::from(byte));
        } else {
            url.push_str(&format!("%{byte:02X}"));
        }
    }
    url.push_str("?mode=");
    url.push_str(mode);
    url
}

#[cfg(test)]
mod tests {
    use super::*;
    use sqlx::Row;

    async fn error_of(folder: &Path) -> StoreError {
        Database::open_folder(folder).await.unwrap_err()
    }

    #[tokio::test]
    async fn a_folder_with_odd_characters_holds_a_safe_database() {
        let folder = tempfile::tempdir().unwrap();
        let odd = folder.path().join("a b?c#d%41é");
        let database = Database::open_folder(&odd).await.unwrap();
        assert!(odd.join("flankwatch.db").is_file());
        for pool in [&database.write, &database.read] {
            for (pragma, expected) in [("PRAGMA synchronous", 2), ("PRAGMA foreign_keys", 1)] {
                let value: i64 = sqlx::query(pragma).fetch_one(pool).await.unwrap().try_get(0).unwrap();
                assert_eq!(value, expected, "{pragma}");
            }
            let mode: String =
                sqlx::query("PRAGMA journal_mode").fetch_one(pool).await.unwrap().try_get(0).unwrap();
            assert_eq!(mode, "wal");
        }
    }

    #[tokio::test]
    async fn a_file_that_is_not_a_database_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("flankwatch.db"), [7_u8; 8192]).unwrap();
        let began = std::time::Instant::now();
        let error = error_of(folder.path()).await;
        assert!(matches!(error, StoreError::DatabaseDamaged { .. }), "{error}");
        assert!(error.to_string().contains("flankwatch.db"), "{error}");
        // Only the header is valid.
        fs::write(
            folder.path().join("flankwatch.db"),
            [b"SQLite format 3\0".as_slice(), &[7_u8; 8192]].concat(),
        )
        .unwrap();
        let error = error_of(folder.path()).await;
        assert!(matches!(error, StoreError::DatabaseDamaged { .. }), "{error}");
        assert!(began.elapsed().as_secs() < 10);
    }

    #[tokio::test]
    async fn a_second_process_and_a_newer_database_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let database = Database::open_folder(folder.path()).await.unwrap();
        assert!(matches!(error_of(folder.path()).await, StoreError::InUse(_)));
        sqlx::query(
            "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) VALUES (999, 'later', 1, x'00', 0)",
        )
        .execute(&database.write)
        .await
        .unwrap();
        drop(database);
        let error = error_of(folder.path()).await;
        assert!(matches!(error, StoreError::Newer { found: 999, .. }), "{error}");
    }

    /// The databases under test: SQLite, and PostgreSQL if `FLANKWATCH_TEST_DATABASE` is set.
    async fn databases(folder: &Path) -> Vec<Database> {
        #[cfg_attr(not(feature = "postgres"), expect(unused_mut, reason = "there is one"))]
        let mut databases = vec![Database::open_folder(folder).await.unwrap()];
        #[cfg(feature = "postgres")]
        if let Ok(url) = std::env::var("FLANKWATCH_TEST_DATABASE") {
            sqlx::any::install_default_drivers();
            let objects = crate::store::ObjectsSettings::Folder(folder.to_path_buf());
            let mut settings = crate::store::SharedSettings::new(url, objects);
            // A temporary table belongs to its connection.
            (settings.write_connections, settings.read_connections) = (1, 1);
            let write = WatchedPool::new(shared_pool(&settings, 1).await.unwrap(), None);
            databases.push(Database {
                dialect: Dialect::Postgres,
                read: write.clone(),
                write,
                lock: None,
                path: None,
                damage: Damage::default(),
            });
        }
        databases
    }

    #[tokio::test]
    async fn values_of_every_type_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        for database in databases(folder.path()).await {
            let make = database
                .dialect
                .schema("CREATE TEMPORARY TABLE t (n BIGINT, i BIGINT, d DOUBLE PRECISION, s TEXT, b BLOB)");
            let mut connection = database.write.acquire().await.unwrap();
            sqlx::query(&make).execute(&mut *connection).await.unwrap();
            // PostgreSQL does not allow NUL in texts.
            let text = if database.dialect == Dialect::Sqlite { "ä\0b" } else { "äb" };
            // Not -0.0: SQLite stores it as 0.
            let doubles = [0.1 + 0.2, f64::MIN_POSITIVE, 5e-324, -1.5, f64::MAX, 3.0];
            for (n, double) in (0_i64..).zip(doubles) {
                sqlx::query("INSERT INTO t VALUES ($1, $2, $3, $4, $5)")
                    .bind(n)
                    .bind(i64::MIN)
                    .bind(double)
                    .bind(text)
                    .bind(double.to_le_bytes().to_vec())
                    .execute(&mut *connection)
                    .await
                    .unwrap();
            }
            sqlx::query("INSERT INTO t VALUES ($1, $2, $3, $4, $5)")
                .bind(doubles.len() as i64)
                .bind(None::<i64>)
                .bind(None::<f64>)
                .bind(None::<String>)
                .bind(None::<Vec<u8>>)
                .persistent(database.dialect.caches_optional_doubles())
                .execute(&mut *connection)
                .await
                .unwrap();
            let rows =
                sqlx::query("SELECT i, d, s, b FROM t ORDER BY n").fetch_all(&mut *connection).await.unwrap();
            for (row, double) in rows.iter().zip(doubles) {
                assert_eq!(row.try_get::<i64, _>("i").unwrap(), i64::MIN);
                assert_eq!(row.try_get::<f64, _>("d").unwrap().to_bits(), double.to_bits());
                assert_eq!(row.try_get::<String, _>("s").unwrap(), text);
                assert_eq!(row.try_get::<Vec<u8>, _>("b").unwrap(), double.to_le_bytes());
            }
            assert_eq!(rows[doubles.len()].try_get::<Option<f64>, _>("d").unwrap(), None);
            assert_eq!(rows[doubles.len()].try_get::<Option<Vec<u8>>, _>("b").unwrap(), None);
        }
    }
}
