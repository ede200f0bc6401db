//! Whether an SQLite database is whole: its header, its pages, and what is found out later.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use sqlx::{AnyConnection, Connection, Row};

use super::StoreError;
use super::database::sqlite_url;
use super::objects::file_error;

/// How long a start waits for the pages to be looked at. What takes longer is looked at in the background.
const LOOKED_AT_FOR: Duration = Duration::from_millis(300);

/// What a database of SQLite begins with.
const HEADER: &[u8; 16] = b"SQLite format 3\0";

/// Findings that are told; one damaged page can bring thousands.
const MAX_FINDINGS: usize = 3;

/// What is damaged of a database; nothing as far as is known.
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
                "the database is damaged: nothing is written any more; `flankwatch restore` or `flankwatch rebuild` makes it whole"
            );
        }
    }
}

/// Refuses a file that is no database at all.
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
    Err(damaged(path, "it does not begin as an SQLite database does".to_owned()))
}

/// Looks at every page of a database, for some seconds now and then in the background. What is found is
/// noted.
pub(super) async fn check_pages(path: &Path, url: String) -> Result<Damage, StoreError> {
    let damage = Damage::default();
    let noted = damage.clone();
    let look = tokio::spawn(async move {
        let mut connection = AnyConnection::connect(&url).await?;
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
        // What cannot even be looked at.
        Ok(Ok(Err(error))) => return Err(named(path, error)),
        Ok(_) => {}
        Err(_) => {
            tracing::info!(path = %path.display(), "the database is large: its pages are looked at in the background")
        }
    }
    Ok(damage)
}

/// Refuses a database whose tables cannot be read. A pool would try again and again.
pub(super) async fn check_schema(path: &Path, url: &str) -> Result<(), StoreError> {
    let read = async {
        let mut connection = AnyConnection::connect(url).await?;
        sqlx::query("SELECT COUNT(*) FROM sqlite_master").fetch_one(&mut connection).await?;
        connection.close().await
    };
    read.await.map_err(|error| named(path, error))
}

/// An error of a database; one that says that it is damaged names its file.
pub(super) fn named(path: &Path, error: impl Into<StoreError>) -> StoreError {
    match error.into() {
        error @ StoreError::Database(_) if error.is_damage() => damaged(path, error.to_string()),
        error => error,
    }
}

/// What a check of the whole database finds, which may take long.
pub(super) async fn findings_of(path: &Path) -> Result<Vec<String>, StoreError> {
    let mut connection = AnyConnection::connect(&sqlite_url(path, "ro")).await?;
    let found = findings(&mut connection, "PRAGMA integrity_check(4)").await;
    connection.close().await?;
    match found.map_err(StoreError::from) {
        Err(error) if error.is_damage() => Ok(vec![error.to_string()]),
        found => found,
    }
}

/// What a check of SQLite finds.
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

/// An error of a database that cannot be used because it is damaged.
pub(super) fn damaged(path: &Path, what: String) -> StoreError {
    StoreError::DatabaseDamaged { path: path.display().to_string(), what }
}
