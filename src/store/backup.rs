//! A data folder copied while a service works on it, and put back.
//!
//! Live streams are copied first, then the database at one moment: a record that a copied journal no longer
//! has to make is in the copied database. The objects that it refers to are there before their rows, and are
//! copied after.

use std::fs::{self, File};
use std::path::Path;

use sqlx::{AnyConnection, Connection};

use super::database::sqlite_url;
use super::objects::file_error;
use super::rows::get;
use super::stream_copies::StreamCopies;
use super::{Objects, StoreError, StoreMark, integrity, tokens};

const DATABASE: &str = "flankwatch.db";

/// What was copied.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Copied {
    /// Raw objects that the copy has.
    pub objects: u64,
    /// Those of them that were not there before.
    pub new: u64,
    /// Live streams.
    pub streams: u64,
    /// Objects and streams that could not be copied, each with why.
    pub failed: Vec<String>,
}

/// Copies a data folder into another one; what an earlier copy has of it already is left as it is.
///
/// Errors: there is no database or it is damaged; the copy is one of another store; files cannot be written.
pub async fn back_up(data: &Path, to: &Path) -> Result<Copied, StoreError> {
    let (database, copy) = (data.join(DATABASE), to.join(DATABASE));
    if !database.exists() {
        return Err(StoreError::Place {
            path: data.to_path_buf(),
            what: "has no flankwatch.db, expected a data folder",
        });
    }
    integrity::check_header(&database)?;
    if to.join("lock").exists() {
        return Err(StoreError::Place {
            path: to.to_path_buf(),
            what: "is a data folder, expected an empty folder or an earlier backup",
        });
    }
    let raw = Objects::open(to.join("raw"))?;
    let mark = mark_of(&database).await?;
    if raw.mark()?.is_some_and(|there| there.store != mark.store) {
        return Err(StoreError::Place { path: to.to_path_buf(), what: "is a backup of another store" });
    }
    let mut streams = StreamCopies::make(data, to, false)?;
    copy_database(&database, &copy).await?;
    for left in ["flankwatch.db-wal", "flankwatch.db-shm"] {
        remove(&to.join(left))?;
    }
    let (names, mark) = (names_in(&copy).await?, mark_of(&copy).await?);
    let mut copied = copy_objects(&Objects::open_to_read(data.join("raw")), &raw, names)?;
    raw.set_mark(&mark)?;
    copied.failed.append(&mut streams.failed);
    copied.streams = streams.replace()?;
    copy_tokens(data, to).await?;
    sync(to)?;
    Ok(copied)
}

/// Puts a backup into a data folder that has no database. Objects and streams that are there stay, and so does
/// the objects' mark: where they are newer, the next start says so.
///
/// Errors: there is a database, or none in the backup; files cannot be written.
pub async fn put_back(from: &Path, data: &Path) -> Result<Copied, StoreError> {
    let (backup, database) = (from.join(DATABASE), data.join(DATABASE));
    if !backup.exists() {
        return Err(StoreError::Place {
            path: from.to_path_buf(),
            what: "has no flankwatch.db, expected a backup",
        });
    }
    integrity::check_header(&backup)?;
    if database.exists() {
        return Err(StoreError::Place {
            path: data.to_path_buf(),
            what: "has a database already, expected a folder without one: move its flankwatch.db* away first",
        });
    }
    let (names, mark) = (names_in(&backup).await?, mark_of(&backup).await?);
    let raw = Objects::open(data.join("raw"))?;
    let mut copied = copy_objects(&Objects::open_to_read(from.join("raw")), &raw, names)?;
    raw.mark_first(&mark)?;
    let mut streams = StreamCopies::make(from, data, true)?;
    copied.failed.append(&mut streams.failed);
    copied.streams = streams.add()?;
    copy_tokens(from, data).await?;
    // Last, so that what breaks off can be begun again.
    let part = data.join("flankwatch.db.part");
    fs::copy(&backup, &part).map_err(|source| file_error("copy", &backup, source))?;
    sync(&part)?;
    for left in ["flankwatch.db-wal", "flankwatch.db-shm"] {
        remove(&data.join(left))?;
    }
    fs::rename(&part, &database).map_err(|source| file_error("rename to", &database, source))?;
    sync(data)?;
    Ok(copied)
}

fn copy_objects(from: &Objects, to: &Objects, names: Vec<String>) -> Result<Copied, StoreError> {
    let mut copied = Copied::default();
    for name in names {
        copied.objects += 1;
        if to.written_at(&name)?.is_some() {
            continue;
        }
        match from.get(&name) {
            Ok(bytes) => to.put_all(&[(name, bytes)], &[])?,
            Err(error) if error.is_of_object() => {
                copied.failed.push(error.to_string());
                copied.objects -= 1;
                continue;
            }
            Err(error) => return Err(error),
        }
        copied.new += 1;
    }
    from.copy_notes(to)?;
    Ok(copied)
}

/// Copies a database as it is at one moment.
async fn copy_database(from: &Path, to: &Path) -> Result<(), StoreError> {
    let part = to.with_extension("db.part");
    remove(&part)?;
    let mut connection = open(from).await?;
    sqlx::query("VACUUM INTO $1").bind(part.to_string_lossy().into_owned()).execute(&mut connection).await?;
    connection.close().await?;
    sync(&part)?;
    fs::rename(&part, to).map_err(|source| file_error("rename to", to, source))
}

/// Copies the tokens, which are no part of the store, for the owner of the copy alone.
async fn copy_tokens(from: &Path, to: &Path) -> Result<(), StoreError> {
    let (from, to) = (from.join(tokens::FILE), to.join(tokens::FILE));
    if from.exists() {
        copy_database(&from, &to).await?;
        let mode = fs::metadata(&from).map_err(|source| file_error("read", &from, source))?.permissions();
        fs::set_permissions(&to, mode).map_err(|source| file_error("write", &to, source))?;
    }
    Ok(())
}

/// Opens a database to read it.
async fn open(database: &Path) -> Result<AnyConnection, StoreError> {
    sqlx::any::install_default_drivers();
    Ok(AnyConnection::connect(&sqlite_url(database, "ro")).await?)
}

async fn names_in(database: &Path) -> Result<Vec<String>, StoreError> {
    let mut connection = open(database).await?;
    let rows = sqlx::query("SELECT DISTINCT sha256 FROM raw_objects ORDER BY sha256")
        .fetch_all(&mut connection)
        .await?;
    connection.close().await?;
    rows.iter().map(|row| get(row, "sha256")).collect()
}

async fn mark_of(database: &Path) -> Result<StoreMark, StoreError> {
    let mut connection = open(database).await?;
    let row = sqlx::query("SELECT store, generation FROM store_identity WHERE one = 1")
        .fetch_one(&mut connection)
        .await?;
    connection.close().await?;
    Ok(StoreMark { store: get(&row, "store")?, generation: get(&row, "generation")? })
}

fn remove(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(file_error("remove", path, error)),
        _ => Ok(()),
    }
}

fn sync(path: &Path) -> Result<(), StoreError> {
    let synced = File::open(path).and_then(|file| file.sync_all());
    synced.map_err(|source| file_error("sync", path, source))
}
