-- Indicators, features and posteriors as columns of numbers, whose names and structure are stored once. For
-- SQLite; `0006_columns_postgres.sql` does the same beside processes of the version before.

-- `id` is a hash of the layout: names and structure of indicators or features, depths of a posterior. A column
-- refers to its layout in its first bytes.
CREATE TABLE layouts (
    id BIGINT NOT NULL PRIMARY KEY,
    layout TEXT NOT NULL
);

-- Analyses that are there stay as JSON; they cannot all be made again.
CREATE TABLE analyses_in_columns (
    segment_id TEXT NOT NULL REFERENCES segments (id) ON DELETE CASCADE,
    generation BIGINT NOT NULL,
    analysis_key TEXT NOT NULL,
    feature_key TEXT NOT NULL,
    shaft_speed TEXT,
    basis TEXT,
    indicator_values BLOB NOT NULL,
    feature_values BLOB NOT NULL,
    PRIMARY KEY (segment_id, generation)
);
INSERT INTO analyses_in_columns
    SELECT segment_id, generation, analysis_key, feature_key, shaft_speed, basis, CAST(indicators AS BLOB), CAST(features AS BLOB)
    FROM analyses;
DROP TABLE analyses;
ALTER TABLE analyses_in_columns RENAME TO analyses;

-- What is folded is folded again: its keys differ from those of earlier versions.
ALTER TABLE wear_estimates DROP COLUMN run_indicators;
ALTER TABLE wear_estimates ADD COLUMN run_indicator_values BLOB;
DROP TABLE wear_posteriors;
CREATE TABLE wear_posteriors (
    segment_id TEXT NOT NULL REFERENCES segments (id) ON DELETE CASCADE,
    generation BIGINT NOT NULL,
    posterior BLOB,
    PRIMARY KEY (segment_id, generation)
);
