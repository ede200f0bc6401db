//! Backup of a data folder while a service uses it, and restore.
//!
//! Live streams are copied first, then a snapshot of the database: a record that is no longer pending in a
//! copied journal is in the copied database. Objects exist before the rows that reference them, and are
//! copied last.

use std::fs::{self, File};
use std::path::Path;

use sqlx::{AnyConnection, Connection};

use super::database::integrity;
use super::database::rows::get;
use super::database::sqlite_url;
use super::objects::file_error;
use super::streams::copies::StreamCopies;
use super::{Objects, StoreError, StoreMark, tokens};

const DATABASE: &str = "flankwatch.db";

/// The result of a backup or restore.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Copied {
    /// Raw objects in the copy.
    pub objects: u64,
    /// Raw objects that the copy did not have before.
    pub new: u64,
    /// Live streams copied.
    pub streams: u64,
    /// Objects and streams that could not be copied, each with the reason.
    pub failed: Vec<String>,
}

/// Copies a data folder into another folder; objects that an earlier backup already has are kept.
///
/// Errors: the database is missing or damaged; the folder contains a backup of another store; files cannot be
/// written.
pub async fn back_up(data: &Path, to: &Path) -> Result<Copied, StoreError> {
    let (database, copy) = (data.join(DATABASE), to.join(DATABASE));
    if !database.exists() {
        return Err(StoreError::Folder {
            path: data.to_path_buf(),
            what: "has no flankwatch.db, expected a data folder",
        });
    }
    integrity::check_header(&database)?;
    if to.join("lock").exists() {
        return Err(StoreError::Folder {
            path: to.to_path_buf(),
            what: "is a data folder, expected an empty folder or an earlier backup",
        });
    }
    let raw = Objects::open(to.join("raw"))?;
    let mark = mark_of(&database).await?;
    if raw.mark()?.is_some_and(|there| there.store != mark.store) {
        return Err(StoreError::Folder { path: to.to_path_buf(), what: "is a backup of another store" });
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

/// Restores a backup into a data folder without a database. Existing objects and streams are kept, and so is
/// the mark of the objects: if they are newer than the backup, the next start reports it.
///
/// Errors: the data folder has a database, or the backup has none; files cannot be written.
pub async fn put_back(from: &Path, data: &Path) -> Result<Copied, StoreError> {
    let (backup, database) = (from.join(DATABASE), data.join(DATABASE));
    if !backup.exists() {
        return Err(StoreError::Folder {
            path: from.to_path_buf(),
            what: "has no flankwatch.db, expected a backup",
        });
    }
    integrity::check_header(&backup)?;
    if database.exists() {
        return Err(StoreError::Folder {
            path: data.to_path_buf(),
            what: "has a database already, expected a folder without one: move its flankwatch.db* files away first",
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
    // The database comes last, so that an interrupted restore can be repeated.
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
            Err(error) if error.is_object_error() => {
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

/// Copies a snapshot of a database.
async fn copy_database(from: &Path, to: &Path) -> Result<(), StoreError> {
    let part = to.with_extension("db.part");
    remove(&part)?;
    let mut connection = open(from).await?;
    sqlx::query("VACUUM INTO $1").bind(part.to_string_lossy().into_owned()).execute(&mut connection).await?;
    connection.close().await?;
    sync(&part)?;
    fs::rename(&part, to).map_err(|source| file_error("rename to", to, source))
}

/// Copies the database of tokens, which is not part of the store, with its file permissions.
async fn copy_tokens(from: &Path, to: &Path) -> Result<(), StoreError> {
    let (from, to) = (from.join(tokens::FILE), to.join(tokens::FILE));
    if from.exists() {
        copy_database(&from, &to).await?;
        let mode = fs::metadata(&from).map_err(|source| file_error("read", &from, source))?.permissions();
        fs::set_permissions(&to, mode).map_err(|source| file_error("write", &to, source))?;
    }
    Ok(())
}

/// Opens a database for reading.
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
