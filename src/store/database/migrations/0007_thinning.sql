-- The results of records that start earlier are thinned already.
ALTER TABLE channels ADD COLUMN thinned_until_ns BIGINT NOT NULL DEFAULT -9223372036854775808;
INSERT INTO counters (name, value) VALUES ('thinned_at_ns', 0);
