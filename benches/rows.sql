-- Fills the tables of a PostgreSQL store with many records and measures the service's own statements on them.
--
--   psql postgres://127.0.0.1/test -v schema=rows -v channels=1000 -v records=10000 \
--     -v indicators=233 -v features=630 -f benches/rows.sql
--
-- flankwatch creates the schema's tables: start it once on `postgres://…?options[search_path]=rows`, and stop it.
-- Rows are inserted in time order over all channels, like records. `indicators` and `features` are the lengths of
-- these columns in bytes; those above are of a record of an asset with a gear pair.
\set ON_ERROR_STOP on
\timing on
SET search_path TO :schema;
SET synchronous_commit = off;
-- Foreign keys are not checked during the fill; the measurements do not use them.
SET session_replication_role = replica;

\echo '--- assets and channels'
INSERT INTO assets (id, spec, created_at_ns, updated_at_ns)
    SELECT 'machine-' || n, '{}', 0, 0 FROM generate_series(1, :channels) n;
INSERT INTO channels (channel_no, asset_id, name, segments, first_start_ns, last_start_ns, revision, rewritten_revision)
    SELECT n, 'machine-' || n, '1', :records, 0, (:records - 1) * 60000000000::bigint, 1, 0 FROM generate_series(1, :channels) n;

\echo '--- segments, then analyses, wear estimates and posteriors'
INSERT INTO segments (id, channel_no, start_time_ns, received_at_ns, sample_rate_hz, samples, unit, operating_point, raw_sha256, raw_bytes,
        raw_media_type, raw_channel_index)
    SELECT lpad(to_hex(17179869184 + t * 60), 9, '0') || left(md5(t || '/' || c), 15), c, t * 60000000000::bigint, t * 60000000000::bigint, 25600, 25600, 'm/s2',
        '{"shaft_speed_hz":24.9,"torque_nm":118.4}', md5(t || ':' || c) || md5(c || ':' || t), 102512, 'application/x-protobuf', 0
    FROM generate_series(0, :records - 1) t, LATERAL generate_series(1, :channels + 0 * t) c;
SELECT substr(string_agg(md5('i' || k), ''), 1, 2 * :indicators) AS indicators FROM generate_series(0, :indicators / 16) k \gset
SELECT substr(string_agg(md5('f' || k), ''), 1, 2 * :features) AS features FROM generate_series(0, :features / 16) k \gset
INSERT INTO analyses (segment_id, generation, analysis_key, feature_key, shaft_speed, basis, indicator_values, feature_values)
    SELECT id, 0, md5('analysis'), md5('feature'), rpad('{"shaft_speed_hz":24.9,"source":"mesh_comb"', 178, 'x'), rpad('{', 224, 'x'),
        decode(:'indicators', 'hex'), decode(:'features', 'hex')
    FROM segments;
INSERT INTO wear_estimates (segment_id, generation, status, reason, median_um, mean_um, low_um, high_um, log_evidence, estimate, run_indicator_values)
    SELECT id, 0, 'estimated', 'wear 12 µm, between 9 and 16 µm with 90 % probability', 12.5, 12.6, 9.8, 15.9, -31.4,
        (SELECT string_agg(md5('e' || k), '') FROM generate_series(1, 30) k), decode(repeat('01', 33), 'hex')
    FROM segments;
INSERT INTO wear_posteriors (segment_id, generation, posterior)
    SELECT id, 0, decode((SELECT string_agg(md5('p' || k), '') FROM generate_series(1, 26) k), 'hex') FROM segments;
ANALYZE wear_posteriors;
ANALYZE segments;
ANALYZE analyses;
ANALYZE wear_estimates;

\echo '--- sizes'
SELECT relname, reltuples::bigint AS rows, pg_size_pretty(pg_relation_size(oid)) AS heap, pg_size_pretty(pg_indexes_size(oid)) AS indexes,
        round(pg_total_relation_size(oid) / greatest(reltuples, 1)::numeric) AS bytes_per_row
    FROM pg_class WHERE relnamespace = :'schema'::regnamespace AND relname IN ('segments', 'analyses', 'wear_estimates', 'wear_posteriors');

\echo '--- a block of a trend: 4096 records of a channel after a time (cold, then repeated)'
PREPARE trend (bigint, bigint, text, bigint) AS
    SELECT s.id, s.start_time_ns, s.unit, s.operating_point, a.shaft_speed, a.indicator_values, w.run_indicator_values, s.reference_wear_um, w.status, w.reason,
        w.median_um, w.mean_um, w.low_um, w.high_um, w.log_evidence
    FROM segments s
    JOIN analyses a ON a.segment_id = s.id AND a.generation = 0
    JOIN wear_estimates w ON w.segment_id = s.id AND w.generation = 0
    WHERE s.channel_no = $1 AND (s.start_time_ns, s.id) > ($2, $3) ORDER BY s.start_time_ns, s.id LIMIT $4;
EXPLAIN (ANALYZE, BUFFERS, COSTS OFF) EXECUTE trend(:channels / 2, :records / 4 * 60000000000::bigint, '', 4096);
EXPLAIN (ANALYZE, BUFFERS, COSTS OFF) EXECUTE trend(:channels / 2, :records / 4 * 60000000000::bigint, '', 4096);

\echo '--- the latest 50 segments of a channel with their wear (cold, then repeated)'
PREPARE latest (bigint) AS
    SELECT s.*, c.asset_id, c.name AS channel, a.indicator_values, a.feature_values, w.estimate, w.run_indicator_values, p.posterior
    FROM (
        SELECT * FROM segments WHERE channel_no = $1 AND start_time_ns >= -9223372036854775808 AND start_time_ns < 9223372036854775807
            AND (start_time_ns, id) < (9223372036854775807, '')
        ORDER BY start_time_ns DESC, id DESC LIMIT 50
    ) s
    JOIN channels c ON c.channel_no = s.channel_no
    JOIN analyses a ON a.segment_id = s.id AND a.generation = c.analysis_generation
    JOIN wear_estimates w ON w.segment_id = s.id AND w.generation = c.wear_generation
    LEFT JOIN wear_posteriors p ON p.segment_id = s.id AND p.generation = c.wear_generation
    ORDER BY s.start_time_ns DESC, s.id DESC;
EXPLAIN (ANALYZE, BUFFERS, COSTS OFF) EXECUTE latest(7);
EXPLAIN (ANALYZE, BUFFERS, COSTS OFF) EXECUTE latest(7);

\echo '--- finding a repeated record'
EXPLAIN (ANALYZE, BUFFERS, COSTS OFF) SELECT * FROM segments WHERE id IN (lpad(to_hex(17179869184 + 300), 9, '0') || left(md5('5/7'), 15), lpad(to_hex(17179869184 + 540), 9, '0') || left(md5('9/11'), 15));
