//! Integrity checks of an SQLite database: its header, its pages, and damage found later.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sqlx::{Connection, Executor, Row, SqliteConnection};

use super::sqlite_url;
use crate::store::StoreError;
use crate::store::objects::file_error;

/// How long a start waits for the check of the pages, which then continues in the background.
const LOOKED_AT_FOR: Duration = Duration::from_millis(300);

/// Pages between two rests of a check in the background.
const PAGES_WITHOUT_REST: i32 = 64;

/// How many times as long as it works a check in the background rests: requests need the processor more.
const REST: u32 = 3;

/// Longest rest of a check in the background, if a disk stood still before it.
const MAX_REST: Duration = Duration::from_millis(100);

/// The first bytes of an SQLite database.
const HEADER: &[u8; 16] = b"SQLite format 3\0";

/// Maximum number of reported findings; one damaged page can give thousands.
const MAX_FINDINGS: usize = 3;

/// Number of checks that find damage before a statement's report counts as confirmed: a disk that fails for a
/// moment can spoil a check too.
const CONFIRMING_CHECKS: u32 = 3;

/// Pause between two checks of reported damage.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Damage of a database that a statement reported.
#[derive(Debug, Clone)]
pub struct FoundDamage {
    /// What the statement reported.
    pub what: String,
    /// Whether a check of the file's pages can confirm it; a table or a value that cannot be read needs none.
    pub is_of_pages: bool,
}

/// The known damage of a database; none by default.
#[derive(Debug, Clone, Default)]
pub(in crate::store) struct Damage {
    known: Arc<Mutex<Option<KnownDamage>>>,
}

#[derive(Debug)]
struct KnownDamage {
    what: String,
    is_confirmed: bool,
}

impl Damage {
    pub(in crate::store) fn get(&self) -> Option<String> {
        self.known().as_ref().map(|known| known.what.clone())
    }

    fn known(&self) -> MutexGuard<'_, Option<KnownDamage>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records damage of a database that a statement reported. Damage of the pages of its file counts until a
    /// check of the file shows that there is none. Must be called inside a Tokio runtime.
    pub(in crate::store) fn report(&self, found: &FoundDamage, path: Option<&Path>) {
        match path {
            Some(path) if found.is_of_pages => self.suspect(&found.what, path.to_owned()),
            _ => self.confirm(&found.what),
        }
    }

    /// Records the outcome of a check of the pages in the background.
    fn checked(&self, path: &Path, outcome: Result<Vec<String>, sqlx::Error>) {
        match outcome {
            Ok(found) if found.is_empty() => {}
            Ok(found) => self.confirm(&found.join("; ")),
            Err(error) => match damage_in(&error) {
                Some(found) => self.report(&found, Some(path)),
                None => {
                    tracing::error!(path = %path.display(), %error, "failed to check the pages of the database")
                }
            },
        }
    }

    /// Records damage that needs no check. It replaces damage that is being checked.
    pub(in crate::store) fn confirm(&self, what: &str) {
        let mut known = self.known();
        if known.as_ref().is_some_and(|known| known.is_confirmed) {
            return;
        }
        tracing::error!(
            what,
            "the database is damaged: stopped writing to it; repair it with `flankwatch restore` or `flankwatch rebuild`"
        );
        *known = Some(KnownDamage { what: what.to_owned(), is_confirmed: true });
    }

    /// Stops writing until a check of the whole database, in the background, shows whether it is damaged.
    /// SQLite can also report damage when the disk has failed to read or write a page.
    pub(in crate::store) fn suspect(&self, what: &str, path: PathBuf) {
        let mut known = self.known();
        if known.is_some() {
            return;
        }
        *known = Some(KnownDamage { what: what.to_owned(), is_confirmed: false });
        tracing::warn!(what, "SQLite reports a damaged database: stopped writing to it until it is checked");
        let (damage, what) = (self.clone(), what.to_owned());
        tokio::spawn(async move {
            if is_damaged(&path).await {
                damage.confirm(&what);
            } else if damage.known().take_if(|known| !known.is_confirmed).is_some() {
                tracing::info!("the check of the database found no damage: writing to it again");
            }
        });
    }
}

/// Checks a whole database until a check finds nothing, or several have found damage.
async fn is_damaged(path: &Path) -> bool {
    let mut confirmations = 0;
    loop {
        match findings_of(path).await {
            Ok(found) if found.is_empty() => return false,
            Ok(_) => confirmations += 1,
            Err(error) => tracing::warn!(%error, "failed to check the database"),
        }
        if confirmations == CONFIRMING_CHECKS {
            return true;
        }
        tokio::time::sleep(CHECK_INTERVAL).await;
    }
}

/// Returns an error if a file is not an SQLite database at all.
pub(in crate::store) fn check_header(path: &Path) -> Result<(), StoreError> {
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
pub(in crate::store) async fn check_pages(
    path: &Path,
    mut connection: SqliteConnection,
) -> Result<Damage, StoreError> {
    rest_in_background(&mut connection).await.map_err(|error| named(path, error))?;
    let damage = Damage::default();
    let mut check = tokio::spawn(async move {
        let found = findings(&mut connection, "PRAGMA quick_check(4)").await;
        if let Err(error) = connection.close().await {
            tracing::warn!(%error, "failed to close the connection that checked the database");
        }
        found
    });
    match tokio::time::timeout(LOOKED_AT_FOR, &mut check).await {
        // The check itself failed.
        Ok(Ok(Err(error))) => return Err(named(path, error)),
        Ok(Ok(outcome)) => damage.checked(path, outcome),
        Ok(Err(error)) => tracing::error!(%error, "the check of the database stopped"),
        Err(_) => {
            tracing::info!(path = %path.display(), "the database is large: checking its pages in the background");
            let (damage, path) = (damage.clone(), path.to_owned());
            tokio::spawn(async move {
                match check.await {
                    Ok(outcome) => damage.checked(&path, outcome),
                    Err(error) => tracing::error!(%error, "the check of the database stopped"),
                }
            });
        }
    }
    Ok(damage)
}

/// Pauses the check on this connection now and then once startup no longer waits for it.
async fn rest_in_background(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    let began = Instant::now();
    let mut resumed = began;
    connection.lock_handle().await?.set_progress_handler(PAGES_WITHOUT_REST, move || {
        if began.elapsed() > LOOKED_AT_FOR {
            std::thread::sleep((resumed.elapsed() * REST).min(MAX_REST));
        }
        resumed = Instant::now();
        true
    });
    Ok(())
}

/// Returns an error if the tables of a database cannot be read. A pool would retry again and again.
pub(in crate::store) async fn check_schema<'c>(connection: impl Executor<'c>) -> Result<(), sqlx::Error> {
    connection.fetch_one("SELECT COUNT(*) FROM sqlite_master").await.map(|_| ())
}

/// Converts an error of a database; one about damage names the file.
pub(in crate::store) fn named(path: &Path, error: impl Into<StoreError>) -> StoreError {
    match error.into() {
        error @ StoreError::Database(_) if error.is_damage() => damaged(path, error.to_string()),
        error => error,
    }
}

/// Runs a check of the whole database, which may take long; returns the findings.
pub(in crate::store) async fn findings_of(path: &Path) -> Result<Vec<String>, StoreError> {
    let mut connection = SqliteConnection::connect(&sqlite_url(path, "ro")).await?;
    let found = findings(&mut connection, "PRAGMA integrity_check(4)").await;
    connection.close().await?;
    match found.map_err(StoreError::from) {
        Err(error) if error.is_damage() => Ok(vec![error.to_string()]),
        found => found,
    }
}

/// Runs a check of SQLite; returns the findings.
pub(in crate::store) async fn findings(
    connection: &mut SqliteConnection,
    check: &str,
) -> Result<Vec<String>, sqlx::Error> {
    let rows = sqlx::query(check).fetch_all(connection).await?;
    let texts = rows.iter().map(|row| row.try_get::<String, _>(0));
    let mut found = texts.collect::<Result<Vec<String>, _>>()?;
    found.retain(|text| text != "ok");
    found.truncate(MAX_FINDINGS);
    Ok(found)
}

/// The damage that an error of the database reports; `None` for other errors.
pub(in crate::store) fn damage_in(error: &sqlx::Error) -> Option<FoundDamage> {
    let (is_damage, is_of_pages) = match error {
        sqlx::Error::ColumnNotFound(_) | sqlx::Error::ColumnDecode { .. } | sqlx::Error::Decode(_) => {
            (true, false)
        }
        sqlx::Error::Database(error) => {
            let is_of_pages = error.code().is_some_and(|code| is_damage_code(&code));
            (is_of_pages || error.message().starts_with("no such "), is_of_pages)
        }
        _ => (false, false),
    };
    is_damage.then(|| FoundDamage { what: format!("database: {error}"), is_of_pages })
}

/// Whether an SQLite code, whose lower byte is the primary code, says that the file is damaged. PostgreSQL
/// SQLSTATEs have five characters.
fn is_damage_code(code: &str) -> bool {
    code.len() < 5 && code.parse::<u32>().is_ok_and(|code| [11, 26].contains(&(code & 0xff)))
}

/// The error of a damaged database.
pub(in crate::store) fn damaged(path: &Path, what: String) -> StoreError {
    StoreError::DatabaseDamaged { path: path.display().to_string(), what }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::database::Database;

    /// Waits until the known damage is as wanted.
    async fn until(damage: &Damage, is_so: impl Fn(&Option<KnownDamage>) -> bool) {
        tokio::time::timeout(Duration::from_secs(60), async {
            while !is_so(&damage.known()) {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        })
        .await
        .expect("within a minute");
    }

    #[tokio::test]
    async fn reported_damage_of_pages_counts_until_the_file_is_checked() {
        let folder = tempfile::tempdir().unwrap();
        let database = Database::open_folder(folder.path()).await.unwrap();
        let path = database.path.clone().unwrap();
        let Database { damage, .. } = &database;
        damage.suspect("a page that the disk did not read", path.clone());
        assert!(damage.get().is_some(), "nothing is written during the check");
        until(damage, Option::is_none).await;

        database.close().await;
        // The kind of every page but the first.
        let mut bytes = std::fs::read(&path).unwrap();
        for page in (4096..bytes.len()).step_by(4096) {
            bytes[page] = 0xff;
        }
        std::fs::write(&path, bytes).unwrap();
        damage.suspect("a damaged page", path);
        until(damage, |known| known.as_ref().is_some_and(|known| known.is_confirmed)).await;
        assert_eq!(damage.get().as_deref(), Some("a damaged page"));
    }

    #[test]
    fn damage_that_a_check_in_the_background_finds_or_fails_at_is_recorded() {
        let known_after = |outcome| {
            let damage = Damage::default();
            damage.checked(Path::new("flankwatch.db"), outcome);
            damage.get()
        };
        assert_eq!(known_after(Ok(Vec::new())), None);
        assert_eq!(
            known_after(Ok(vec!["page 7".into(), "page 9".into()])).as_deref(),
            Some("page 7; page 9")
        );
        assert!(known_after(Err(sqlx::Error::ColumnNotFound("quick_check".into()))).is_some());
        assert_eq!(known_after(Err(sqlx::Error::PoolTimedOut)), None);
    }

    #[tokio::test]
    async fn damage_of_a_value_stays_when_the_pages_are_intact() {
        let folder = tempfile::tempdir().unwrap();
        let database = Database::open_folder(folder.path()).await.unwrap();
        let Database { damage, path, .. } = &database;
        let handles = Arc::strong_count(&damage.known);
        damage.suspect("a page that the disk did not read", path.clone().unwrap());
        damage.confirm("a value that cannot be read");
        // The check ends and drops its handle.
        while Arc::strong_count(&damage.known) > handles {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        assert_eq!(damage.get().as_deref(), Some("a value that cannot be read"));
    }
}
