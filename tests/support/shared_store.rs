//! PostgreSQL for tests: a schema for each, which goes with it.

use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use flankwatch::store::{BucketCredentials, BucketSettings, ObjectsSettings, SharedSettings};
use sqlx::Connection;

static SCHEMAS: AtomicU32 = AtomicU32::new(0);

/// A temporary schema in the database of `FLANKWATCH_TEST_DATABASE`.
pub(crate) struct TestDatabase {
    server: String,
    schema: String,
}

impl TestDatabase {
    /// Returns a schema, or `None` without `FLANKWATCH_TEST_DATABASE`.
    pub(crate) fn named() -> Option<Self> {
        Some(Self::on(std::env::var("FLANKWATCH_TEST_DATABASE").ok()?))
    }

    /// Creates a schema in a database.
    pub(crate) fn on(server: String) -> Self {
        let schema = format!("test_{}_{}", std::process::id(), SCHEMAS.fetch_add(1, Ordering::Relaxed));
        let database = Self { server, schema };
        database.run(&format!("DROP SCHEMA IF EXISTS {0} CASCADE; CREATE SCHEMA {0}", database.schema));
        database
    }

    /// Returns settings of a store with its rows in this schema and its objects in the folder, or in the
    /// bucket of `FLANKWATCH_TEST_BUCKET` (`http://host:port/bucket`).
    pub(crate) fn settings(&self, folder: &Path) -> SharedSettings {
        let url = format!("{}?options[search_path]={}", self.server, self.schema);
        let objects = match std::env::var("FLANKWATCH_TEST_BUCKET") {
            Ok(address) => {
                let (endpoint, bucket) = address.rsplit_once('/').unwrap();
                ObjectsSettings::Bucket(BucketSettings {
                    bucket: bucket.to_owned(),
                    endpoint: Some(endpoint.to_owned()),
                    region: "us-east-1".to_owned(),
                    credentials: Some(BucketCredentials {
                        access_key_id: "test".to_owned(),
                        secret_access_key: "test".to_owned(),
                    }),
                    prefix: self.schema.clone(),
                })
            }
            Err(_) => ObjectsSettings::Folder(folder.join("raw")),
        };
        SharedSettings {
            write_connections: 2,
            read_connections: 3,
            // No other process uses this folder.
            orphan_age: Duration::ZERO,
            ..SharedSettings::new(url, objects)
        }
    }

    /// Makes all resumable uploads older by `age`.
    pub(crate) fn age_uploads(&self, age: Duration) {
        let (schema, age_ns) = (&self.schema, age.as_nanos());
        self.run(&format!("UPDATE {schema}.resumable_uploads SET expires_at_ns = expires_at_ns - {age_ns}"));
    }

    /// Makes PostgreSQL reject every new segment with a full-disk error, or stops that.
    pub(crate) fn set_full(&self, is_full: bool) {
        let schema = &self.schema;
        let begin = format!(
            "CREATE FUNCTION {schema}.no_room() RETURNS trigger LANGUAGE plpgsql AS $$
             BEGIN RAISE EXCEPTION 'could not extend file: No space left on device' USING ERRCODE = '53100'; END $$;
             CREATE TRIGGER no_room BEFORE INSERT ON {schema}.segments FOR EACH ROW EXECUTE FUNCTION {schema}.no_room()"
        );
        let end = format!("DROP TRIGGER no_room ON {schema}.segments; DROP FUNCTION {schema}.no_room()");
        self.run(if is_full { &begin } else { &end });
    }

    /// Makes PostgreSQL reject every change of a shared counter, as a read-only database does.
    pub(crate) fn set_read_only(&self, is_read_only: bool) {
        let schema = &self.schema;
        let begin = format!(
            "CREATE FUNCTION {schema}.read_only() RETURNS trigger LANGUAGE plpgsql AS $$
             BEGIN RAISE EXCEPTION 'cannot execute INSERT in a read-only transaction' USING ERRCODE = '25006'; END $$;
             CREATE TRIGGER read_only BEFORE INSERT OR UPDATE ON {schema}.counters FOR EACH ROW EXECUTE FUNCTION {schema}.read_only()"
        );
        let end = format!("DROP TRIGGER read_only ON {schema}.counters; DROP FUNCTION {schema}.read_only()");
        self.run(if is_read_only { &begin } else { &end });
    }

    /// Runs statements on another connection than the service's.
    pub(crate) fn run(&self, statements: &str) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let outcome = runtime.block_on(async {
            sqlx::any::install_default_drivers();
            let mut connection = sqlx::AnyConnection::connect(&self.server).await?;
            sqlx::raw_sql(statements).execute(&mut connection).await?;
            connection.close().await
        });
        outcome.unwrap_or_else(|error| panic!("{statements}: {error}"));
    }
}

impl Drop for TestDatabase {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.run(&format!("DROP SCHEMA {} CASCADE", self.schema));
        }
    }
}
