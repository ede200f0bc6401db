//! The tables, as numbered migrations in one SQL text for SQLite and PostgreSQL.
//!
//! Types are BIGINT (also for times: nanoseconds UTC), DOUBLE PRECISION, TEXT and the tokens `{bytes}` and `{second_of_start}`; there are no booleans,
//! UUIDs or timestamps, which sqlx's `Any` driver cannot carry. Structures that are only read whole are JSON in TEXT.

use sqlx::{AnyConnection, Connection, Row};

use super::{StoreError, dead_letters, heard_through, renamed_segments, resumable_uploads, tokens};

/// Which database speaks behind the `Any` driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dialect {
    /// SQLite: one connection writes, so that a transaction has all rows to itself.
    Sqlite,
    /// PostgreSQL: many processes write, so that a transaction locks the rows that it changes.
    #[cfg(feature = "cluster")]
    Postgres,
}

impl Dialect {
    /// A migration's statement with the types of this database.
    pub(super) fn statement(self, text: &str) -> String {
        match self {
            Self::Sqlite => text
                .replace("{bytes}", "BLOB")
                .replace("{second_of_start}", &format!("printf('%09x', {SECOND_OF_START})")),
            // Texts are in the order of their bytes, as everywhere in the program, whatever the database's language.
            #[cfg(feature = "cluster")]
            Self::Postgres => text
                .replace("{bytes}", "BYTEA")
                .replace("{second_of_start}", &format!("lpad(to_hex({SECOND_OF_START}), 9, '0')"))
                .replace(" TEXT", " TEXT COLLATE \"C\""),
        }
    }

    /// Behind a SELECT of rows that are going to be changed, or whose dependents are: nobody else changes them before the transaction's end.
    pub(super) fn to_change(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            // Not FOR UPDATE, which would keep out the foreign keys of rows that refer to these.
            #[cfg(feature = "cluster")]
            Self::Postgres => " FOR NO KEY UPDATE",
        }
    }

    /// Behind a SELECT of rows that are to stay as they are until the transaction's end.
    pub(super) fn to_rest_on(self) -> &'static str {
        match self {
            Self::Sqlite => "",
            #[cfg(feature = "cluster")]
            Self::Postgres => " FOR SHARE",
        }
    }

    /// Begins a transaction that sees the database as it is at its first statement.
    pub(super) fn begin_snapshot(self) -> &'static str {
        match self {
            Self::Sqlite => "BEGIN",
            #[cfg(feature = "cluster")]
            Self::Postgres => "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY",
        }
    }

    /// Whether a statement may stay prepared whose optional doubles are sometimes missing. sqlx tells PostgreSQL another type for a missing
    /// one, and would bind the next value under that.
    pub(super) fn keeps_optional_doubles(self) -> bool {
        self == Self::Sqlite
    }

    /// Whether a statement on that many rows stays prepared. PostgreSQL's own preparing costs a way there and back, and there are as many
    /// statements as there are numbers of rows.
    pub(super) fn keeps(self, rows: usize) -> bool {
        self == Self::Sqlite || rows == 1
    }

    /// Waits, to the transaction's end and however long, until no other process brings the tables up to date; the number is "flankwat" in
    /// ASCII.
    fn lock_migrations(self) -> &'static [&'static str] {
        match self {
            Self::Sqlite => &[],
            #[cfg(feature = "cluster")]
            Self::Postgres => &[
                "SET LOCAL lock_timeout = 0",
                "SET LOCAL statement_timeout = 0",
                "SELECT pg_advisory_xact_lock(7380381016230682996)",
            ],
        }
    }
}

/// The second that an identifier begins with; times before 1970 are rounded down too.
const SECOND_OF_START: &str = "start_time_ns / 1000000000 - CASE WHEN start_time_ns % 1000000000 < 0 THEN 1 ELSE 0 END + 17179869184";

/// Each migration's statements; a migration that has been released is never changed.
const MIGRATIONS: &[&[&str]] = &[
    FIRST,
    RUN_INDICATORS,
    KEYED_UPLOADS,
    GENERATIONS,
    ALARMS,
    SHARING,
    heard_through::TABLE,
    QUARTILES,
    renamed_segments::BY_TIME,
    tokens::TABLE,
    resumable_uploads::TABLES,
    dead_letters::TABLE,
    heard_through::CAUGHT_UP,
    RETENTION,
];

/// Assets, channels, segments with everything about them.
const FIRST: &[&str] = &[
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
];

/// What indicators rest on, and those that the run up to a record gives: set by the fold, as the estimate is.
const RUN_INDICATORS: &[&str] = &[
    "ALTER TABLE segments ADD COLUMN basis TEXT",
    "ALTER TABLE segments ADD COLUMN run_indicators TEXT",
];

/// Uploads under a key of the client's.
const KEYED_UPLOADS: &[&str] = &[
    "CREATE TABLE keyed_uploads (
        asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
        upload_key TEXT NOT NULL,
        request_sha256 TEXT NOT NULL,
        received_at_ns BIGINT NOT NULL,
        answer TEXT,
        PRIMARY KEY (asset_id, upload_key)
    )",
    "CREATE INDEX keyed_uploads_in_time ON keyed_uploads (received_at_ns)",
];

/// What is derived is apart from what was recorded, under a generation number: a channel's history is computed again beside the one
/// that is served, and swapped in by one number. Raw objects are counted for each asset.
const GENERATIONS: &[&str] = &[
    // Which generation of analyses and of estimates is served, and the greatest number given out; under which keys they were made;
    // whether late records wait for their history to be folded; whether rows of other generations are to be removed.
    "ALTER TABLE channels ADD COLUMN analysis_generation BIGINT NOT NULL DEFAULT 0",
    "ALTER TABLE channels ADD COLUMN wear_generation BIGINT NOT NULL DEFAULT 0",
    "ALTER TABLE channels ADD COLUMN newest_generation BIGINT NOT NULL DEFAULT 0",
    "ALTER TABLE channels ADD COLUMN analysis_key TEXT NOT NULL DEFAULT ''",
    "ALTER TABLE channels ADD COLUMN feature_key TEXT NOT NULL DEFAULT ''",
    "ALTER TABLE channels ADD COLUMN fold_key TEXT NOT NULL DEFAULT ''",
    "ALTER TABLE channels ADD COLUMN must_fold BIGINT NOT NULL DEFAULT 0",
    "ALTER TABLE channels ADD COLUMN leftovers BIGINT NOT NULL DEFAULT 0",
    // A generation of analyses that is being made, so that it is gone on with after a restart.
    "ALTER TABLE channels ADD COLUMN next_analysis_generation BIGINT",
    "ALTER TABLE channels ADD COLUMN next_analysis_key TEXT",
    // What one record says by itself, and under which keys it was made to say so.
    "CREATE TABLE analyses (
        segment_id TEXT NOT NULL REFERENCES segments (id) ON DELETE CASCADE,
        generation BIGINT NOT NULL,
        analysis_key TEXT NOT NULL,
        feature_key TEXT NOT NULL,
        shaft_speed TEXT,
        basis TEXT,
        indicators TEXT NOT NULL,
        features TEXT NOT NULL,
        PRIMARY KEY (segment_id, generation)
    )",
    "INSERT INTO analyses (segment_id, generation, analysis_key, feature_key, shaft_speed, basis, indicators, features)
        SELECT id, 0, '', '', shaft_speed, basis, indicators, features FROM segments",
    "ALTER TABLE segments DROP COLUMN shaft_speed",
    "ALTER TABLE segments DROP COLUMN basis",
    "ALTER TABLE segments DROP COLUMN indicators",
    "ALTER TABLE segments DROP COLUMN features",
    "ALTER TABLE wear_estimates RENAME TO first_wear_estimates",
    "CREATE TABLE wear_estimates (
        segment_id TEXT NOT NULL REFERENCES segments (id) ON DELETE CASCADE,
        generation BIGINT NOT NULL,
        status TEXT NOT NULL,
        reason TEXT NOT NULL,
        median_um DOUBLE PRECISION,
        mean_um DOUBLE PRECISION,
        p05_um DOUBLE PRECISION,
        p95_um DOUBLE PRECISION,
        log_evidence DOUBLE PRECISION,
        estimate TEXT NOT NULL,
        run_indicators TEXT,
        PRIMARY KEY (segment_id, generation)
    )",
    "INSERT INTO wear_estimates SELECT w.segment_id, 0, w.status, w.reason, w.median_um, w.mean_um, w.p05_um, w.p95_um, w.log_evidence,
        w.estimate, s.run_indicators FROM first_wear_estimates w JOIN segments s ON s.id = w.segment_id",
    "ALTER TABLE segments DROP COLUMN run_indicators",
    "DROP TABLE first_wear_estimates",
    "ALTER TABLE wear_posteriors RENAME TO first_wear_posteriors",
    "CREATE TABLE wear_posteriors (
        segment_id TEXT NOT NULL REFERENCES segments (id) ON DELETE CASCADE,
        generation BIGINT NOT NULL,
        wear_um {bytes} NOT NULL,
        probability {bytes} NOT NULL,
        PRIMARY KEY (segment_id, generation)
    )",
    "INSERT INTO wear_posteriors SELECT segment_id, 0, wear_um, probability FROM first_wear_posteriors",
    "DROP TABLE first_wear_posteriors",
    // The fold's state after some of a channel's records, the newest among them. `position` counts the records up to it.
    "DROP TABLE tracker_states",
    "CREATE TABLE fold_states (
        channel_no BIGINT NOT NULL REFERENCES channels (channel_no) ON DELETE CASCADE,
        generation BIGINT NOT NULL,
        position BIGINT NOT NULL,
        start_time_ns BIGINT NOT NULL,
        segment_id TEXT NOT NULL,
        state TEXT NOT NULL,
        PRIMARY KEY (channel_no, generation, position)
    )",
    // Which raw objects are kept for which asset, and how many bytes they are together.
    "CREATE TABLE raw_objects (
        sha256 TEXT NOT NULL,
        asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
        bytes BIGINT NOT NULL,
        start_time_ns BIGINT NOT NULL,
        PRIMARY KEY (sha256, asset_id)
    )",
    "INSERT INTO raw_objects (sha256, asset_id, bytes, start_time_ns)
        SELECT s.raw_sha256, c.asset_id, MAX(s.raw_bytes), MIN(s.start_time_ns)
        FROM segments s JOIN channels c ON c.channel_no = s.channel_no GROUP BY s.raw_sha256, c.asset_id",
    "CREATE INDEX raw_objects_of_asset ON raw_objects (asset_id, start_time_ns)",
    "CREATE INDEX raw_objects_in_time ON raw_objects (start_time_ns)",
    "DROP INDEX segments_of_object",
    "CREATE TABLE raw_volumes (
        asset_id TEXT NOT NULL PRIMARY KEY REFERENCES assets (id) ON DELETE CASCADE,
        bytes BIGINT NOT NULL
    )",
    "INSERT INTO raw_volumes (asset_id, bytes)
        SELECT a.id, CAST(COALESCE((SELECT SUM(bytes) FROM raw_objects r WHERE r.asset_id = a.id), 0) AS BIGINT) FROM assets a",
    // Replays outlive the process: which ones there were, and what had become of them.
    "CREATE TABLE replays (
        number BIGINT NOT NULL PRIMARY KEY,
        replay TEXT NOT NULL
    )",
];

/// Maintenance events of assets, and alarms of channels. What people did to an alarm stays; its changes are replaced where the history is folded
/// again, and those that are not confirmed then stay as withdrawn. `place` is twice the number of records before and at a change, and one
/// more where it lies between two records.
const ALARMS: &[&str] = &[
    "CREATE TABLE maintenance_events (
        asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
        id TEXT NOT NULL,
        time_ns BIGINT NOT NULL,
        event TEXT NOT NULL,
        PRIMARY KEY (asset_id, id)
    )",
    "CREATE INDEX maintenance_in_time ON maintenance_events (asset_id, time_ns, id)",
    "CREATE TABLE alarms (
        id TEXT NOT NULL PRIMARY KEY,
        channel_no BIGINT NOT NULL REFERENCES channels (channel_no) ON DELETE CASCADE,
        quantity TEXT NOT NULL,
        rule TEXT,
        alarm TEXT NOT NULL,
        standing TEXT NOT NULL,
        severity TEXT,
        shelved_until_ns BIGINT,
        changed_at_ns BIGINT NOT NULL
    )",
    "CREATE INDEX alarms_of_channel ON alarms (channel_no)",
    "CREATE INDEX alarms_in_time ON alarms (changed_at_ns, id)",
    "CREATE INDEX alarms_by_standing ON alarms (standing)",
    "CREATE TABLE alarm_actions (
        alarm_id TEXT NOT NULL REFERENCES alarms (id) ON DELETE CASCADE,
        number BIGINT NOT NULL,
        after_ns BIGINT NOT NULL,
        action TEXT NOT NULL,
        PRIMARY KEY (alarm_id, number)
    )",
    "CREATE TABLE alarm_changes (
        alarm_id TEXT NOT NULL REFERENCES alarms (id) ON DELETE CASCADE,
        place BIGINT NOT NULL,
        number BIGINT NOT NULL,
        change TEXT NOT NULL,
        withdrawn_at_ns BIGINT,
        PRIMARY KEY (alarm_id, place, number)
    )",
];

/// What several processes need to work on the same channels: what tells that something changed, and who makes what.
const SHARING: &[&str] = &[
    // Grows with every change of a description or of an asset's maintenance events; never given out twice.
    "ALTER TABLE assets ADD COLUMN revision BIGINT NOT NULL DEFAULT 0",
    "INSERT INTO counters (name, value) VALUES ('asset_revision', 0)",
    // The revision at which all histories of an asset were found as they are asked for.
    "ALTER TABLE assets ADD COLUMN settled_revision BIGINT NOT NULL DEFAULT -1",
    "INSERT INTO counters (name, value) VALUES ('swept_at_ns', 0)",
    // The generation of estimates that is being made, which alone may be served next; and until when its maker counts as alive.
    "ALTER TABLE channels ADD COLUMN next_wear_generation BIGINT",
    "ALTER TABLE channels ADD COLUMN maker_until_ns BIGINT",
    // The earliest place where the history changed since that one was begun.
    "ALTER TABLE channels ADD COLUMN changed_from_ns BIGINT",
    "ALTER TABLE channels ADD COLUMN changed_from_id TEXT",
    // Which libraries are being built, and until when their builders count as alive.
    "CREATE TABLE library_builds (library_id TEXT NOT NULL PRIMARY KEY, builder_until_ns BIGINT NOT NULL)",
];

/// The middle half of what is believed of the wear; estimates made before have none until they are made again.
const QUARTILES: &[&str] = &[
    "ALTER TABLE wear_estimates ADD COLUMN p25_um DOUBLE PRECISION",
    "ALTER TABLE wear_estimates ADD COLUMN p75_um DOUBLE PRECISION",
];

/// The row by which processes that give up raw recordings take turns.
const RETENTION: &[&str] = &["INSERT INTO counters (name, value) VALUES ('retention', 0)"];

/// Brings the tables up to date; a database from a later program is refused.
pub(super) async fn migrate(connection: &mut AnyConnection, dialect: Dialect) -> Result<(), StoreError> {
    // All or nothing; of several processes the first one does it, and the others find it done.
    let mut transaction = connection.begin().await?;
    for statement in dialect.lock_migrations() {
        sqlx::query(statement).execute(&mut *transaction).await?;
    }
    sqlx::query("CREATE TABLE IF NOT EXISTS migrations (version BIGINT NOT NULL PRIMARY KEY)")
        .execute(&mut *transaction)
        .await?;
    let found: i64 = sqlx::query("SELECT COALESCE(MAX(version), 0) FROM migrations")
        .fetch_one(&mut *transaction)
        .await?
        .try_get(0)?;
    let known = MIGRATIONS.len() as i64;
    if found > known {
        return Err(StoreError::Newer { found, known });
    }
    for (version, statements) in (1..).zip(MIGRATIONS).skip(usize::try_from(found).unwrap_or(0)) {
        for statement in *statements {
            let statement = dialect.statement(statement);
            sqlx::query(&statement).execute(&mut *transaction).await?;
        }
        sqlx::query("INSERT INTO migrations (version) VALUES ($1)")
            .bind(version as i64)
            .execute(&mut *transaction)
            .await?;
        tracing::info!(version, "database migrated");
    }
    Ok(transaction.commit().await?)
}
