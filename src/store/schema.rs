//! The tables, as numbered migrations in one SQL text for SQLite and PostgreSQL.
//!
//! Types are BIGINT (also for times: nanoseconds UTC), DOUBLE PRECISION, TEXT and the token `{bytes}`; there are no booleans,
//! UUIDs or timestamps, which sqlx's `Any` driver cannot carry. Structures that are only read whole are JSON in TEXT.

use sqlx::{AnyConnection, AssertSqlSafe, Connection, Row};

use super::StoreError;

/// Which database speaks behind the `Any` driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dialect {
    /// SQLite.
    Sqlite,
}

impl Dialect {
    /// The type of a column of bytes.
    fn bytes(self) -> &'static str {
        match self {
            Self::Sqlite => "BLOB",
        }
    }
}

/// Each migration's statements; a migration that has been released is never changed.
const MIGRATIONS: &[&[&str]] = &[&[
    "CREATE TABLE assets (
        id TEXT NOT NULL PRIMARY KEY,
        spec TEXT NOT NULL,
        created_at_ns BIGINT NOT NULL,
        updated_at_ns BIGINT NOT NULL
    )",
    // Numbers that are given out once, also after what they named is gone.
    "CREATE TABLE counters (name TEXT NOT NULL PRIMARY KEY, value BIGINT NOT NULL)",
    "INSERT INTO counters (name, value) VALUES ('channel_no', 0)",
    // One row for each (asset, channel): the short key of its records, and what summaries need without counting.
    // `revision` grows with every change of its records, `rewritten_revision` is the latest that was not an append.
    "CREATE TABLE channels (
        channel_no BIGINT NOT NULL PRIMARY KEY,
        asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
        name TEXT NOT NULL,
        segments BIGINT NOT NULL,
        first_start_ns BIGINT,
        last_start_ns BIGINT,
        last_segment_id TEXT,
        revision BIGINT NOT NULL,
        rewritten_revision BIGINT NOT NULL,
        UNIQUE (asset_id, name)
    )",
    "CREATE TABLE segments (
        id TEXT NOT NULL PRIMARY KEY,
        channel_no BIGINT NOT NULL REFERENCES channels (channel_no) ON DELETE CASCADE,
        start_time_ns BIGINT NOT NULL,
        received_at_ns BIGINT NOT NULL,
        sample_rate_hz DOUBLE PRECISION NOT NULL,
        samples BIGINT NOT NULL,
        unit TEXT NOT NULL,
        operating_point TEXT NOT NULL,
        shaft_speed TEXT,
        reference_wear_um DOUBLE PRECISION,
        raw_sha256 TEXT NOT NULL,
        raw_bytes BIGINT NOT NULL,
        raw_media_type TEXT NOT NULL,
        raw_channel_index BIGINT NOT NULL,
        indicators TEXT NOT NULL,
        features TEXT NOT NULL
    )",
    "CREATE INDEX segments_in_time ON segments (channel_no, start_time_ns, id)",
    "CREATE INDEX segments_of_object ON segments (raw_sha256)",
    "CREATE TABLE wear_estimates (
        segment_id TEXT NOT NULL PRIMARY KEY REFERENCES segments (id) ON DELETE CASCADE,
        status TEXT NOT NULL,
        reason TEXT NOT NULL,
        median_um DOUBLE PRECISION,
        mean_um DOUBLE PRECISION,
        p05_um DOUBLE PRECISION,
        p95_um DOUBLE PRECISION,
        log_evidence DOUBLE PRECISION,
        estimate TEXT NOT NULL
    )",
    // Apart from the estimates, so that reading a history does not read these.
    "CREATE TABLE wear_posteriors (
        segment_id TEXT NOT NULL PRIMARY KEY REFERENCES segments (id) ON DELETE CASCADE,
        wear_um {bytes} NOT NULL,
        probability {bytes} NOT NULL
    )",
    "CREATE TABLE tracker_states (
        channel_no BIGINT NOT NULL PRIMARY KEY REFERENCES channels (channel_no) ON DELETE CASCADE,
        fold_key TEXT NOT NULL,
        state TEXT NOT NULL,
        last_start_ns BIGINT NOT NULL,
        last_segment_id TEXT NOT NULL
    )",
]];

/// Brings the tables up to date; a database from a later program is refused.
pub(super) async fn migrate(connection: &mut AnyConnection, dialect: Dialect) -> Result<(), StoreError> {
    sqlx::query("CREATE TABLE IF NOT EXISTS migrations (version BIGINT NOT NULL PRIMARY KEY)")
        .execute(&mut *connection)
        .await?;
    let found: i64 = sqlx::query("SELECT COALESCE(MAX(version), 0) FROM migrations")
        .fetch_one(&mut *connection)
        .await?
        .try_get(0)?;
    let known = MIGRATIONS.len() as i64;
    if found > known {
        return Err(StoreError::Newer { found, known });
    }
    for (version, statements) in (1..).zip(MIGRATIONS).skip(usize::try_from(found).unwrap_or(0)) {
        let mut transaction = connection.begin().await?;
        for statement in *statements {
            let statement = statement.replace("{bytes}", dialect.bytes());
            sqlx::query(AssertSqlSafe(statement)).execute(&mut *transaction).await?;
        }
        sqlx::query("INSERT INTO migrations (version) VALUES ($1)")
            .bind(version as i64)
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        tracing::info!(version, "database migrated");
    }
    Ok(())
}
