//! Integrity checks of an SQLite database: its header, its pages, and damage found later.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use sqlx::{AnyConnection, Connection, Row};

use super::StoreError;
use super::database::sqlite_url;
use super::objects::file_error;

/// How long a start waits for the check of the pages, which then continues in the background.
const LOOKED_AT_FOR: Duration = Duration::from_millis(300);

/// The first bytes of an SQLite database.
const HEADER: &[u8; 16] = b"SQLite format 3\0";

/// Maximum number of reported findings; one damaged page can give thousands.
const MAX_FINDINGS: usize = 3;

/// The known damage of a database; none by default.
#[derive(Debug, Clone, Default)]
pub(super) struct Damage {
    found: Arc<OnceLock<String>>,
}

impl Damage {
    pub(super) fn get(&self) -> Option<&str> {
        self.found.get().map(String::as_str)
    }

    pub(super) fn note(&self, what: String) {
        if self.found.set(what).is_ok() {
            let what = self.get().unwrap_or_default();
            tracing::error!(
                what,
                "the database is damaged: stopped writing to it; repair it with `flankwatch restore` or `flankwatch rebuild`"
            );
        }
    }
}

/// Returns an error if a file is not an SQLite database at all.
pub(super) fn check_header(path: &Path) -> Result<(), StoreError> {
    let mut start = Vec::new();
    match File::open(path) {
        Ok(file) => file.take(HEADER.len() as u64).read_to_end(&mut start),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(source) => return Err(file_error("read", path, source)),
    }
    .map_err(|source| file_error("read", path, source))?;
    if start.is_empty() || start == HEADER {
        return Ok(());
    }
    Err(damaged(path, "its header is not that of an SQLite database".to_owned()))
}

/// Checks every page of a database, in the background if that takes longer than a fraction of a second.
/// Records the damage that is found, and closes the connection.
pub(super) async fn check_pages(path: &Path, mut connection: AnyConnection) -> Result<Damage, StoreError> {
    let damage = Damage::default();
    let noted = damage.clone();
    let look = tokio::spawn(async move {
        let found = findings(&mut connection, "PRAGMA quick_check(4)").await;
        connection.close().await?;
        match found {
            Ok(found) if found.is_empty() => {}
            Ok(found) => noted.note(found.join("; ")),
            Err(error) => return Err(error),
        }
        Ok::<_, sqlx::Error>(())
    });
    match tokio::time::timeout(LOOKED_AT_FOR, look).await {
        // The check itself failed.
        Ok(Ok(Err(error))) => return Err(named(path, error)),
        Ok(_) => {}
        Err(_) => {
            tracing::info!(path = %path.display(), "the database is large: checking its pages in the background")
        }
    }
    Ok(damage)
}

/// Returns an error if the tables of a database cannot be read. A pool would retry again and again.
pub(super) async fn check_schema(connection: &mut AnyConnection) -> Result<(), sqlx::Error> {
    sqlx::query("SELECT COUNT(*) FROM sqlite_master").fetch_one(connection).await.map(|_| ())
}

/// Converts an error of a database; one about damage names the file.
pub(super) fn named(path: &Path, error: impl Into<StoreError>) -> StoreError {
    match error.into() {
        error @ StoreError::Database(_) if error.is_damage() => damaged(path, error.to_string()),
        error => error,
    }
}

/// Runs a check of the whole database, which may take long; returns the findings.
pub(super) async fn findings_of(path: &Path) -> Result<Vec<String>, StoreError> {
    let mut connection = AnyConnection::connect(&sqlite_url(path, "ro")).await?;
    let found = findings(&mut connection, "PRAGMA integrity_check(4)").await;
    connection.close().await?;
    match found.map_err(StoreError::from) {
        Err(error) if error.is_damage() => Ok(vec![error.to_string()]),
        found => found,
    }
}

/// Runs a check of SQLite; returns the findings.
pub(super) async fn findings(
    connection: &mut AnyConnection,
    check: &str,
) -> Result<Vec<String>, sqlx::Error> {
    let rows = sqlx::query(check).fetch_all(connection).await?;
    let texts = rows.iter().map(|row| row.try_get::<String, _>(0));
    let mut found = texts.collect::<Result<Vec<String>, _>>()?;
    found.retain(|text| text != "ok");
    found.truncate(MAX_FINDINGS);
    Ok(found)
}

/// The error of a damaged database.
pub(super) fn damaged(path: &Path, what: String) -> StoreError {
    StoreError::DatabaseDamaged { path: path.display().to_string(), what }
}
