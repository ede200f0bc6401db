//! The tables (`migrations`), and what the two databases say differently.
//!
//! A migration that has been released is never changed; the next one is a file of its own with the next
//! number.

use std::borrow::Cow;

use futures_util::future::BoxFuture;
use sqlx::AnyConnection;
use sqlx::error::BoxDynError;
use sqlx::migrate::{MigrateError, Migration, MigrationSource, MigrationType, Migrator};

use super::StoreError;

/// Which database speaks behind the `Any` driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dialect {
    /// SQLite: one connection writes, so that a transaction has all rows to itself.
    Sqlite,
    /// PostgreSQL: many processes write, so that a transaction locks the rows that it changes.
    #[cfg(feature = "postgres")]
    Postgres,
}

impl Dialect {
    /// A text of the schema with the types of this database.
    pub(super) fn schema(self, text: &'static str) -> Cow<'static, str> {
        match self {
            Self::Sqlite => Cow::Borrowed(text),
            // Texts are in the order of their bytes, as everywhere in the program, whatever the database's
            // language.
            #[cfg(feature = "postgres")]
            Self::Postgres => {
                Cow::Owned(text.replace(" BLOB", " BYTEA").replace(" TEXT", " TEXT COLLATE \"C\""))
            }
        }
    }

    /// Behind a SELECT of rows that are going to be changed, or whose dependents are: nobody else changes
    /// them before the transaction's end.
    pub(super) fn for_update(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            // Not FOR UPDATE, which would keep out the foreign keys of rows that refer to these.
            #[cfg(feature = "postgres")]
            Self::Postgres => " FOR NO KEY UPDATE",
        }
    }

    /// Behind a SELECT of rows that are to stay as they are until the transaction's end.
    pub(super) fn for_share(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            #[cfg(feature = "postgres")]
            Self::Postgres => " FOR SHARE",
        }
    }

    /// Begins a transaction that sees the database as it is at its first statement.
    pub(super) fn begin_snapshot(self) -> &'static str {
        match self {
            Self::Sqlite => "BEGIN",
            #[cfg(feature = "postgres")]
            Self::Postgres => "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY",
        }
    }

    /// Asks for the time by the database's clock; none where that is this machine's.
    pub(super) fn time_ns(self) -> Option<&'static str> {
        match self {
            Self::Sqlite => None,
            #[cfg(feature = "postgres")]
            Self::Postgres => {
                Some("SELECT CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000000 AS BIGINT) AS now_ns")
            }
        }
    }

    /// Whether a statement may stay prepared whose optional doubles are sometimes missing. sqlx tells
    /// PostgreSQL another type for a missing one, and would bind the next value under that.
    pub(super) fn caches_optional_doubles(self) -> bool {
        self == Self::Sqlite
    }

    /// Whether a statement on that many rows stays prepared. PostgreSQL's own preparing costs a way there and
    /// back, and there are as many statements as there are numbers of rows.
    pub(super) fn caches_statement(self, rows: usize) -> bool {
        self == Self::Sqlite || rows == 1
    }
}

/// The migrations by their numbers, with their descriptions.
const MIGRATIONS: [(i64, &str, &str); 3] = [
    (1, "schema", include_str!("migrations/0001_schema.sql")),
    (2, "notifications", include_str!("migrations/0002_notifications.sql")),
    (3, "trend blocks", include_str!("migrations/0003_trend_blocks.sql")),
];

/// The table of tokens: in a database that processes share, or in one of its own beside SQLite's.
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

/// Brings the tables up to date; a database of a later program is refused. Of several processes the first one
/// does it, and the others wait.
pub(super) async fn migrate(connection: &mut AnyConnection, dialect: Dialect) -> Result<(), StoreError> {
    let migrated = async { Migrator::new(dialect).await?.run_direct(connection).await };
    migrated.await.map_err(|error| match error {
        MigrateError::VersionMissing(found) => StoreError::Newer { found, known: MIGRATIONS.len() as i64 },
        MigrateError::Execute(error) => error.into(),
        other => sqlx::Error::from(other).into(),
    })
}
