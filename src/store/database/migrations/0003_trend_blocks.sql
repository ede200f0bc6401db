-- Stretches of a channel's history as columns, made again from its rows where they are missing: reading a
-- long history row by row takes seconds. `revision` is the channel's at which a block was read; one that is
-- older than the channel's `rewritten_revision`, or of another format, counts as missing.
CREATE TABLE trend_blocks (
    channel_no BIGINT NOT NULL REFERENCES channels (channel_no) ON DELETE CASCADE,
    number BIGINT NOT NULL,
    format BIGINT NOT NULL,
    revision BIGINT NOT NULL,
    last_start_ns BIGINT NOT NULL,
    last_segment_id TEXT NOT NULL,
    columns BLOB NOT NULL,
    PRIMARY KEY (channel_no, number)
);
