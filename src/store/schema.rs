//! The schema (`migrations`), and the differences between the two SQL dialects.
//!
//! A released migration is never changed; the next one is a new file with the next number.

use std::borrow::Cow;

use futures_util::future::BoxFuture;
use sqlx::AnyConnection;
use sqlx::error::BoxDynError;
use sqlx::migrate::{MigrateError, Migration, MigrationSource, MigrationType, Migrator};

use super::StoreError;

/// The database behind the `Any` driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dialect {
    /// SQLite: a single connection writes, so that a transaction needs no row locks.
    Sqlite,
    /// PostgreSQL: several processes write, so that a transaction locks the rows that it changes.
    #[cfg(feature = "postgres")]
    Postgres,
}

impl Dialect {
    /// Translates a text of the schema to the types of this database.
    pub(super) fn schema(self, text: &'static str) -> Cow<'static, str> {
        match self {
            Self::Sqlite => Cow::Borrowed(text),
            // Texts are sorted by their bytes, as everywhere in the program, whatever the locale of the
            // database.
            #[cfg(feature = "postgres")]
            Self::Postgres => {
                Cow::Owned(text.replace(" BLOB", " BYTEA").replace(" TEXT", " TEXT COLLATE \"C\""))
            }
        }
    }

    /// Suffix of a SELECT that locks rows which are going to be changed, or whose dependent rows are, until
    /// the end of the transaction.
    pub(super) fn for_update(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            // Not FOR UPDATE, which would block inserts of rows that reference these.
            #[cfg(feature = "postgres")]
            Self::Postgres => " FOR NO KEY UPDATE",
        }
    }

    /// Suffix of a SELECT that locks rows against changes until the end of the transaction.
    pub(super) fn for_share(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            #[cfg(feature = "postgres")]
            Self::Postgres => " FOR SHARE",
        }
    }

    /// Statement that begins a transaction on a snapshot of the database at its first query.
    pub(super) fn begin_snapshot(self) -> &'static str {
        match self {
            Self::Sqlite => "BEGIN",
            #[cfg(feature = "postgres")]
            Self::Postgres => "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY",
        }
    }

    /// Query for the time by the database's clock; `None` if that is the clock of this machine.
    pub(super) fn time_ns(self) -> Option<&'static str> {
        match self {
            Self::Sqlite => None,
            #[cfg(feature = "postgres")]
            Self::Postgres => {
                Some("SELECT CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000000 AS BIGINT) AS now_ns")
            }
        }
    }

    /// Whether a statement with optional doubles may stay prepared. For a missing one, sqlx declares another
    /// type to PostgreSQL, and would bind the next value as that type.
    pub(super) fn caches_optional_doubles(self) -> bool {
        self == Self::Sqlite
    }

    /// Whether a statement on that many rows stays prepared. Preparing costs a round trip to PostgreSQL, and
    /// there is a different statement for each number of rows.
    pub(super) fn caches_statement(self, rows: usize) -> bool {
        self == Self::Sqlite || rows == 1
    }
}

/// The migrations: number, description and text.
const MIGRATIONS: [(i64, &str, &str); 6] = [
    (1, "schema", include_str!("migrations/0001_schema.sql")),
    (2, "notifications", include_str!("migrations/0002_notifications.sql")),
    (3, "trend blocks", include_str!("migrations/0003_trend_blocks.sql")),
    (4, "streams", include_str!("migrations/0004_streams.sql")),
    (5, "interval", include_str!("migrations/0005_interval.sql")),
    (6, "partitions", include_str!("migrations/0006_partitions.sql")),
];

/// The table of tokens, in the shared database or in a separate SQLite database.
pub(super) const TOKENS: &str = include_str!("migrations/tokens.sql");

impl MigrationSource<'static> for Dialect {
    fn resolve(self) -> BoxFuture<'static, Result<Vec<Migration>, BoxDynError>> {
        let migration = move |(version, description, text): (i64, &'static str, &'static str)| {
            let tables = self.schema(text);
            #[cfg(feature = "postgres")]
            let tables = match self {
                Self::Postgres if version == 1 => Cow::Owned(format!("{tables}\n{}", self.schema(TOKENS))),
                _ => tables,
            };
            Migration::new(version, description.into(), MigrationType::Simple, tables, false)
        };
        Box::pin(async move { Ok(MIGRATIONS.into_iter().map(migration).collect()) })
    }
}

/// Migrates the schema; returns an error for a database of a newer program. With several processes the first
/// one migrates, and the others wait.
pub(super) async fn migrate(connection: &mut AnyConnection, dialect: Dialect) -> Result<(), StoreError> {
    let migrated = async { Migrator::new(dialect).await?.run_direct(connection).await };
    migrated.await.map_err(|error| match error {
        MigrateError::VersionMissing(found) => StoreError::Newer { found, known: MIGRATIONS.len() as i64 },
        MigrateError::Execute(error) => error.into(),
        other => sqlx::Error::from(other).into(),
    })
}
