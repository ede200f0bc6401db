//! The schema (`migrations`), and the differences between the two SQL dialects.
//!
//! A released migration is never changed; the next one is a new file with the next number.

use std::borrow::Cow;

use futures_util::future::BoxFuture;
use sqlx::AnyConnection;
use sqlx::error::BoxDynError;
use sqlx::migrate::{MigrateError, Migration, MigrationSource, MigrationType, Migrator};

use crate::store::StoreError;

/// The database behind the `Any` driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) enum Dialect {
    /// SQLite: a single connection writes, so that a transaction needs no row locks.
    Sqlite,
    /// PostgreSQL: several processes write, so that a transaction locks the rows that it changes.
    #[cfg(feature = "postgres")]
    Postgres,
}

impl Dialect {
    /// Translates a text of the schema to the types of this database.
    pub(in crate::store) fn schema(self, text: &'static str) -> Cow<'static, str> {
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

    /// Joins the texts of all rows.
    pub(in crate::store) fn joined(self, text: &str, separator: &str) -> String {
        let function = match self {
            Self::Sqlite => "group_concat",
            #[cfg(feature = "postgres")]
            Self::Postgres => "string_agg",
        };
        format!("{function}({text}, '{separator}')")
    }

    /// Suffix of a SELECT that locks rows which are going to be changed, or whose dependent rows are, until
    /// the end of the transaction.
    pub(in crate::store) fn for_update(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            // Not FOR UPDATE, which would block inserts of rows that reference these.
            #[cfg(feature = "postgres")]
            Self::Postgres => " FOR NO KEY UPDATE",
        }
    }

    /// Suffix of a SELECT that locks rows against changes until the end of the transaction.
    pub(in crate::store) fn for_share(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            #[cfg(feature = "postgres")]
            Self::Postgres => " FOR SHARE",
        }
    }

    /// Statement that begins a transaction on a snapshot of the database at its first query.
    pub(in crate::store) fn begin_snapshot(self) -> &'static str {
        match self {
            Self::Sqlite => "BEGIN",
            #[cfg(feature = "postgres")]
            Self::Postgres => "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY",
        }
    }

    /// Query for the time by the database's clock; `None` if that is the clock of this machine.
    pub(in crate::store) fn time_ns(self) -> Option<&'static str> {
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
    pub(in crate::store) fn caches_optional_doubles(self) -> bool {
        self == Self::Sqlite
    }

    /// Whether a statement on that many rows stays prepared. Preparing costs a round trip to PostgreSQL, and
    /// there is a different statement for each number of rows.
    pub(in crate::store) fn caches_statement(self, rows: usize) -> bool {
        self == Self::Sqlite || rows == 1
    }
}

/// The migrations: number, description and text.
const MIGRATIONS: [(i64, &str, &str); 9] = [
    (1, "schema", include_str!("migrations/0001_schema.sql")),
    (2, "notifications", include_str!("migrations/0002_notifications.sql")),
    (3, "trend blocks", include_str!("migrations/0003_trend_blocks.sql")),
    (4, "streams", include_str!("migrations/0004_streams.sql")),
    (5, "interval", include_str!("migrations/0005_interval.sql")),
    (6, "columns", include_str!("migrations/0006_columns.sql")),
    (7, "thinning", include_str!("migrations/0007_thinning.sql")),
    (8, "partitions", include_str!("migrations/0008_partitions.sql")),
    (9, "removal", include_str!("migrations/0009_removal.sql")),
];

/// The sixth migration for PostgreSQL.
#[cfg(feature = "postgres")]
const COLUMNS_POSTGRES: &str = include_str!("migrations/0006_columns_postgres.sql");

/// The table of tokens, in the shared database or in a separate SQLite database.
pub(in crate::store) const TOKENS: &str = include_str!("migrations/tokens.sql");

impl MigrationSource<'static> for Dialect {
    fn resolve(self) -> BoxFuture<'static, Result<Vec<Migration>, BoxDynError>> {
        let migration = move |(version, description, text): (i64, &'static str, &'static str)| {
            let tables = self.schema(text);
            #[cfg(feature = "postgres")]
            let tables = match self {
                Self::Postgres if version == 1 => Cow::Owned(format!("{tables}\n{}", self.schema(TOKENS))),
                Self::Postgres if version == 6 => self.schema(COLUMNS_POSTGRES),
                _ => tables,
            };
            Migration::new(version, description.into(), MigrationType::Simple, tables, false)
        };
        Box::pin(async move { Ok(MIGRATIONS.into_iter().map(migration).collect()) })
    }
}

/// Migrates the schema; returns an error for a database of a newer program. With several processes the first
/// one migrates, and the others wait.
pub(in crate::store) async fn migrate(
    connection: &mut AnyConnection,
    dialect: Dialect,
) -> Result<(), StoreError> {
    let migrated = async { Migrator::new(dialect).await?.run_direct(connection).await };
    migrated.await.map_err(|error| match error {
        MigrateError::VersionMissing(found) => StoreError::Newer { found, known: MIGRATIONS.len() as i64 },
        MigrateError::Execute(error) => error.into(),
        other => sqlx::Error::from(other).into(),
    })
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use sqlx::Connection;

    use super::*;
    use crate::asset::AssetId;
    use crate::store::{Store, StoreSettings};

    #[tokio::test]
    async fn analyses_of_a_database_without_layouts_are_read() {
        let folder = tempfile::tempdir().unwrap();
        sqlx::any::install_default_drivers();
        let url = format!("sqlite://{}?mode=rwc", folder.path().join("flankwatch.db").display());
        let mut connection = AnyConnection::connect(&url).await.unwrap();
        let before_layouts = Dialect::Sqlite.resolve().await.unwrap().into_iter().take(5).collect();
        let migrator = Migrator { migrations: Cow::Owned(before_layouts), ..Migrator::DEFAULT };
        migrator.run_direct(&mut connection).await.unwrap();
        for text in [
            r#"INSERT INTO assets (id, spec, created_at_ns, updated_at_ns) VALUES ('pump', '{"id":"pump"}', 0, 0)"#,
            "INSERT INTO channels (channel_no, asset_id, name, segments, revision, rewritten_revision) VALUES (1, 'pump', 'a', 1, 1, 1)",
            "INSERT INTO segments VALUES ('s', 1, 5, 5, 20000.0, 4, 'g', '{}', NULL, 'hash', 8, 'audio/wav', 0, 0)",
            r#"INSERT INTO analyses VALUES ('s', 0, 'k', 'f', NULL, NULL,
                '{"indicators":{"rms":0.1},"absent":{"fm4":"no_speed"}}',
                '{"values":{"ln_rms":-2.3},"speed_doubt":"a \"quoted\" line"}')"#,
        ] {
            sqlx::query(text).execute(&mut connection).await.unwrap();
        }
        connection.close().await.unwrap();

        let store = Store::open(&StoreSettings::Folder(folder.path().to_owned())).await.unwrap();
        let channel = store.channels(&AssetId::new("pump".to_owned()).unwrap()).await.unwrap().remove(0);
        let read = store.features(&channel, channel.served_analyses(), None, 10).await.unwrap().remove(0);
        assert_eq!(read.indicators.values["rms"], 0.1);
        assert_eq!(read.features.values["ln_rms"], -2.3);
        assert_eq!(read.features.speed_doubt.as_deref(), Some(r#"a "quoted" line"#));
    }
}
