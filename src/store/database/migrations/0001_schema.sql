-- The tables, in one text for SQLite and PostgreSQL.
--
-- Types are BIGINT (also for times: nanoseconds UTC), DOUBLE PRECISION, TEXT and BLOB; there are no booleans,
-- UUIDs or timestamps, which sqlx's `Any` driver cannot carry. Structures that are only read whole are JSON
-- in TEXT. For PostgreSQL the store reads BLOB as BYTEA and gives texts the order of their bytes.

-- Numbers that are given out once, also after what they named is gone, and rows by which processes take
-- turns.
CREATE TABLE counters (
    name TEXT NOT NULL PRIMARY KEY,
    value BIGINT NOT NULL
);
INSERT INTO counters (name, value) VALUES ('channel_no', 0), ('asset_revision', 0), ('swept_at_ns', 0), ('retention', 0);

-- Which store this is, and how far it has come: the raw objects carry the same mark. `one` is 1.
CREATE TABLE store_identity (
    one BIGINT NOT NULL PRIMARY KEY,
    store TEXT NOT NULL,
    generation BIGINT NOT NULL
);

-- What is monitored -----------------------------------------------------------------------------------------

CREATE TABLE assets (
    id TEXT NOT NULL PRIMARY KEY,
    spec TEXT NOT NULL,
    created_at_ns BIGINT NOT NULL,
    updated_at_ns BIGINT NOT NULL,
    -- Grows with every change of the description or of the maintenance events; never given out twice.
    revision BIGINT NOT NULL DEFAULT 0,
    -- The revision at which all histories of the asset were found as they are asked for.
    settled_revision BIGINT NOT NULL DEFAULT -1
);

-- One row for each asset that shares the sensor of another one, beside its description, so that an index
-- finds them.
CREATE TABLE shared_sensors (
    asset_id TEXT NOT NULL PRIMARY KEY REFERENCES assets (id) ON DELETE CASCADE,
    of_asset TEXT NOT NULL REFERENCES assets (id),
    -- Whether the asset has the records that came before it was described.
    is_caught_up BIGINT NOT NULL DEFAULT 0
);
CREATE INDEX shared_sensors_of_asset ON shared_sensors (of_asset);

CREATE TABLE maintenance_events (
    asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
    id TEXT NOT NULL,
    time_ns BIGINT NOT NULL,
    event TEXT NOT NULL,
    PRIMARY KEY (asset_id, id)
);
CREATE INDEX maintenance_in_time ON maintenance_events (asset_id, time_ns, id);

-- Records and what is derived from them ---------------------------------------------------------------------

-- One row for each asset and channel: the short key of its records, and what summaries need without counting.
CREATE TABLE channels (
    channel_no BIGINT NOT NULL PRIMARY KEY,
    asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
    name TEXT NOT NULL,
    segments BIGINT NOT NULL,
    first_start_ns BIGINT,
    last_start_ns BIGINT,
    last_segment_id TEXT,
    -- Grows with every change of the records, and the latest revision that was not an append.
    revision BIGINT NOT NULL,
    rewritten_revision BIGINT NOT NULL,
    -- Which generation of analyses and of estimates is served, and the greatest number given out.
    analysis_generation BIGINT NOT NULL DEFAULT 0,
    wear_generation BIGINT NOT NULL DEFAULT 0,
    newest_generation BIGINT NOT NULL DEFAULT 0,
    -- Under which keys the served generations were made.
    analysis_key TEXT NOT NULL DEFAULT '',
    feature_key TEXT NOT NULL DEFAULT '',
    fold_key TEXT NOT NULL DEFAULT '',
    -- Whether late records wait for their history to be folded, and whether rows of other generations are to
    -- be removed.
    must_fold BIGINT NOT NULL DEFAULT 0,
    leftovers BIGINT NOT NULL DEFAULT 0,
    -- The generations that are being made, and until when their maker counts as alive.
    next_analysis_generation BIGINT,
    next_analysis_key TEXT,
    next_wear_generation BIGINT,
    maker_until_ns BIGINT,
    -- The earliest place where the history changed since they were begun.
    changed_from_ns BIGINT,
    changed_from_id TEXT,
    UNIQUE (asset_id, name)
);

CREATE TABLE segments (
    id TEXT NOT NULL PRIMARY KEY,
    channel_no BIGINT NOT NULL REFERENCES channels (channel_no) ON DELETE CASCADE,
    start_time_ns BIGINT NOT NULL,
    received_at_ns BIGINT NOT NULL,
    sample_rate_hz DOUBLE PRECISION NOT NULL,
    samples BIGINT NOT NULL,
    unit TEXT NOT NULL,
    operating_point TEXT NOT NULL,
    reference_wear_um DOUBLE PRECISION,
    raw_sha256 TEXT NOT NULL,
    raw_bytes BIGINT NOT NULL,
    raw_media_type TEXT NOT NULL,
    raw_channel_index BIGINT NOT NULL,
    -- Whether people took the record out of its history; it stays stored.
    excluded BIGINT NOT NULL DEFAULT 0
);
CREATE INDEX segments_in_time ON segments (channel_no, start_time_ns, id);
-- The few that are excluded, to be noted with their asset.
CREATE INDEX segments_excluded ON segments (channel_no) WHERE excluded <> 0;

-- What one record says by itself, and under which keys it was made to say so.
CREATE TABLE analyses (
    segment_id TEXT NOT NULL REFERENCES segments (id) ON DELETE CASCADE,
    generation BIGINT NOT NULL,
    analysis_key TEXT NOT NULL,
    feature_key TEXT NOT NULL,
    shaft_speed TEXT,
    basis TEXT,
    indicators TEXT NOT NULL,
    features TEXT NOT NULL,
    PRIMARY KEY (segment_id, generation)
);

-- What the run up to a record says of it.
CREATE TABLE wear_estimates (
    segment_id TEXT NOT NULL REFERENCES segments (id) ON DELETE CASCADE,
    generation BIGINT NOT NULL,
    status TEXT NOT NULL,
    reason TEXT NOT NULL,
    median_um DOUBLE PRECISION,
    mean_um DOUBLE PRECISION,
    p05_um DOUBLE PRECISION,
    p25_um DOUBLE PRECISION,
    p75_um DOUBLE PRECISION,
    p95_um DOUBLE PRECISION,
    log_evidence DOUBLE PRECISION,
    estimate TEXT NOT NULL,
    run_indicators TEXT,
    PRIMARY KEY (segment_id, generation)
);

-- Apart from the estimates, so that reading a history does not read these.
CREATE TABLE wear_posteriors (
    segment_id TEXT NOT NULL REFERENCES segments (id) ON DELETE CASCADE,
    generation BIGINT NOT NULL,
    wear_um BLOB NOT NULL,
    probability BLOB NOT NULL,
    PRIMARY KEY (segment_id, generation)
);

-- The fold's state after some of a channel's records, the newest among them; `position` counts the records up
-- to it.
CREATE TABLE fold_states (
    channel_no BIGINT NOT NULL REFERENCES channels (channel_no) ON DELETE CASCADE,
    generation BIGINT NOT NULL,
    position BIGINT NOT NULL,
    start_time_ns BIGINT NOT NULL,
    segment_id TEXT NOT NULL,
    state TEXT NOT NULL,
    PRIMARY KEY (channel_no, generation, position)
);

-- Alarms ----------------------------------------------------------------------------------------------------

CREATE TABLE alarms (
    id TEXT NOT NULL PRIMARY KEY,
    channel_no BIGINT NOT NULL REFERENCES channels (channel_no) ON DELETE CASCADE,
    quantity TEXT NOT NULL,
    rule TEXT,
    alarm TEXT NOT NULL,
    standing TEXT NOT NULL,
    severity TEXT,
    shelved_until_ns BIGINT,
    changed_at_ns BIGINT NOT NULL
);
CREATE INDEX alarms_of_channel ON alarms (channel_no);
CREATE INDEX alarms_in_time ON alarms (changed_at_ns, id);
CREATE INDEX alarms_by_standing ON alarms (standing);

-- What operators did to an alarm.
CREATE TABLE alarm_actions (
    alarm_id TEXT NOT NULL REFERENCES alarms (id) ON DELETE CASCADE,
    number BIGINT NOT NULL,
    after_ns BIGINT NOT NULL,
    action TEXT NOT NULL,
    PRIMARY KEY (alarm_id, number)
);

-- What happened to an alarm. A history that is folded again replaces its changes; those that it does not
-- confirm stay as withdrawn. `place` is twice the number of records before and at a change, and one more
-- where it lies between two records.
CREATE TABLE alarm_changes (
    alarm_id TEXT NOT NULL REFERENCES alarms (id) ON DELETE CASCADE,
    place BIGINT NOT NULL,
    number BIGINT NOT NULL,
    change TEXT NOT NULL,
    withdrawn_at_ns BIGINT,
    PRIMARY KEY (alarm_id, place, number)
);

-- Raw objects -----------------------------------------------------------------------------------------------

-- Which raw objects are kept for which asset, and how many bytes they are together.
CREATE TABLE raw_objects (
    sha256 TEXT NOT NULL,
    asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
    bytes BIGINT NOT NULL,
    start_time_ns BIGINT NOT NULL,
    PRIMARY KEY (sha256, asset_id)
);
CREATE INDEX raw_objects_of_asset ON raw_objects (asset_id, start_time_ns);
CREATE INDEX raw_objects_in_time ON raw_objects (start_time_ns);

CREATE TABLE raw_volumes (
    asset_id TEXT NOT NULL PRIMARY KEY REFERENCES assets (id) ON DELETE CASCADE,
    bytes BIGINT NOT NULL
);

-- Uploads ---------------------------------------------------------------------------------------------------

-- Uploads under a key of the client's, with what was answered.
CREATE TABLE keyed_uploads (
    asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
    upload_key TEXT NOT NULL,
    request_sha256 TEXT NOT NULL,
    received_at_ns BIGINT NOT NULL,
    answer TEXT,
    PRIMARY KEY (asset_id, upload_key)
);
CREATE INDEX keyed_uploads_in_time ON keyed_uploads (received_at_ns);

-- Without a reference to the asset: an upload whose asset is removed ends by saying so.
CREATE TABLE resumable_uploads (
    id TEXT NOT NULL PRIMARY KEY,
    asset_id TEXT NOT NULL,
    length BIGINT NOT NULL,
    received BIGINT NOT NULL,
    progress TEXT NOT NULL,
    expires_at_ns BIGINT NOT NULL,
    reader_until_ns BIGINT,
    result TEXT,
    error TEXT
);
CREATE INDEX resumable_uploads_in_time ON resumable_uploads (expires_at_ns);
CREATE INDEX resumable_uploads_by_progress ON resumable_uploads (progress);

CREATE TABLE upload_pieces (
    upload_id TEXT NOT NULL REFERENCES resumable_uploads (id) ON DELETE CASCADE,
    at_byte BIGINT NOT NULL,
    bytes BIGINT NOT NULL,
    object TEXT NOT NULL,
    PRIMARY KEY (upload_id, at_byte)
);

-- The service itself ----------------------------------------------------------------------------------------

-- Replays outlive the process: which ones there were, and what had become of them.
CREATE TABLE replays (
    number BIGINT NOT NULL PRIMARY KEY,
    replay TEXT NOT NULL
);

-- Which libraries are being built, and until when their builders count as alive.
CREATE TABLE library_builds (
    library_id TEXT NOT NULL PRIMARY KEY,
    builder_until_ns BIGINT NOT NULL
);

-- How often a queued record was put among the dead letters; `letter` is the place in the queue that the last
-- one had.
CREATE TABLE dead_letters (
    segment_id TEXT NOT NULL PRIMARY KEY,
    times BIGINT NOT NULL,
    letter BIGINT NOT NULL,
    put_at_ns BIGINT NOT NULL
);
CREATE INDEX dead_letters_in_time ON dead_letters (put_at_ns);
