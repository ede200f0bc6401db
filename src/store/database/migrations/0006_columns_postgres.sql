-- `0006_columns.sql` for a database that processes of the version before still use during an upgrade. The
-- columns that they read and write stay, and the next version drops them: new rows have empty values there,
-- and what they write is copied.

CREATE TABLE layouts (
    id BIGINT NOT NULL PRIMARY KEY,
    layout TEXT NOT NULL
);

ALTER TABLE analyses
    ADD COLUMN indicator_values BYTEA,
    ADD COLUMN feature_values BYTEA,
    ALTER COLUMN indicators SET DEFAULT '{"indicators":{}}',
    ALTER COLUMN features SET DEFAULT '{"values":{}}';
UPDATE analyses SET indicator_values = convert_to(indicators, 'UTF8'), feature_values = convert_to(features, 'UTF8');

CREATE FUNCTION copy_analysis() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    NEW.indicator_values = coalesce(NEW.indicator_values, convert_to(NEW.indicators, 'UTF8'));
    NEW.feature_values = coalesce(NEW.feature_values, convert_to(NEW.features, 'UTF8'));
    RETURN NEW;
END $$;
CREATE TRIGGER copy_analysis BEFORE INSERT ON analyses FOR EACH ROW EXECUTE FUNCTION copy_analysis();

ALTER TABLE wear_estimates ADD COLUMN run_indicator_values BYTEA;
ALTER TABLE wear_posteriors
    ADD COLUMN posterior BYTEA,
    ALTER COLUMN wear_um SET DEFAULT '',
    ALTER COLUMN probability SET DEFAULT '';
