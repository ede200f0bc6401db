-- To find the records that still refer to a raw object while others are removed.
CREATE INDEX segments_of_raw ON segments (raw_sha256);
-- How often an upload was begun to be read: the number of the reader that may end it.
ALTER TABLE resumable_uploads ADD COLUMN readings BIGINT NOT NULL DEFAULT 0;
