-- Live streams of a shared store: on a data folder of one process they are files.

INSERT INTO counters (name, value) VALUES ('stream_no', 0);

CREATE TABLE streams (
    stream_no BIGINT NOT NULL PRIMARY KEY,
    asset_id TEXT NOT NULL REFERENCES assets (id) ON DELETE CASCADE,
    name TEXT NOT NULL,
    -- The number of the entries after which the stored state is.
    checkpoint BIGINT NOT NULL DEFAULT 0,
    -- Bytes of the stored levels.
    level_bytes BIGINT NOT NULL DEFAULT 0,
    -- The process that stores the stream's records, and until when it counts as alive.
    cutter BIGINT NOT NULL DEFAULT 0,
    cutting_until_ns BIGINT NOT NULL DEFAULT 0,
    UNIQUE (asset_id, name)
);

-- The journal of a stream: what was appended at once is a row. Numbers ascend by one, so that of two processes
-- that append at the same time one finds its number taken.
CREATE TABLE stream_entries (
    stream_no BIGINT NOT NULL REFERENCES streams (stream_no) ON DELETE CASCADE,
    number BIGINT NOT NULL,
    -- Indices after the last sample before and after these entries.
    first_index BIGINT NOT NULL,
    end_index BIGINT NOT NULL,
    -- Records that are planned and not stored after these entries.
    pending BIGINT NOT NULL,
    entries BLOB NOT NULL,
    PRIMARY KEY (stream_no, number)
);

-- The state of a stream at its checkpoint, apart from the rows that change more often.
CREATE TABLE stream_states (
    stream_no BIGINT NOT NULL PRIMARY KEY REFERENCES streams (stream_no) ON DELETE CASCADE,
    state BLOB NOT NULL
);

-- The levels of each second, in blocks; `number` is that of the checkpoint with which a block was stored.
CREATE TABLE stream_levels (
    stream_no BIGINT NOT NULL REFERENCES streams (stream_no) ON DELETE CASCADE,
    number BIGINT NOT NULL,
    first_ns BIGINT NOT NULL,
    last_ns BIGINT NOT NULL,
    levels BLOB NOT NULL,
    PRIMARY KEY (stream_no, number)
);
