//! Backup of a data folder while a service uses it, and restore.
//!
//! Live streams are copied first, then a snapshot of the database: a record that is no longer pending in a
//! copied journal is in the copied database. Objects exist before the rows that reference them, and are
//! copied last.

use std::collections::HashSet;
use std::fs::{self, File};
use std::path::Path;
use std::time::Duration;

use jiff::Timestamp;
use sqlx::{AnyConnection, Connection};

use super::database::integrity;
use super::database::rows::get;
use super::database::sqlite_url;
use super::objects::{file_error, if_exists};
use super::streams::copies::StreamCopies;
use super::{Objects, StoreError, StoreMark, identity, tokens};

const DATABASE: &str = "flankwatch.db";

/// The result of a backup or restore.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Copied {
    /// Raw objects in the copy.
    pub objects: u64,
    /// Raw objects that the copy did not have before.
    pub new: u64,
    /// Raw objects of an earlier backup that nothing refers to any more, and that are now in its quarantine.
    pub unreferenced: u64,
    /// Live streams copied.
    pub streams: u64,
    /// Objects and streams that could not be copied, each with the reason.
    pub failed: Vec<String>,
}

/// Copies a data folder into another folder; objects that an earlier backup already has are kept. Those to
/// which the copied database does not refer move into the quarantine of the backup for `quarantined_for`, as
/// in the data folder, unless something could not be copied or the database is not that of the objects.
///
/// # Errors
/// The database is missing or damaged; the folder contains a backup of another store; files cannot be
/// written.
pub async fn back_up(data: &Path, to: &Path, quarantined_for: Duration) -> Result<Copied, StoreError> {
    let (database, copy) = (data.join(DATABASE), to.join(DATABASE));
    if !database.exists() {
        return Err(unfit(data, "has no flankwatch.db, expected a data folder"));
    }
    integrity::check_header(&database)?;
    if to.join("lock").exists() {
        return Err(unfit(to, "is a data folder, expected an empty folder or an earlier backup"));
    }
    let (source, raw) = (Objects::open_to_read(data.join("raw")), Objects::open(to.join("raw"))?);
    // Read before that of the database, whose generation is raised first.
    let among = source.mark()?;
    let mark = mark_of(&database).await?;
    let is_current = among.is_some_and(|among| identity::reason(&mark, &among).is_none());
    if raw.mark()?.is_some_and(|there| there.store != mark.store) {
        return Err(unfit(to, "is a backup of another store"));
    }
    let mut streams = StreamCopies::make(data, to, false)?;
    copy_database(&database, &copy).await?;
    for left in ["flankwatch.db-wal", "flankwatch.db-shm"] {
        remove_file(&to.join(left))?;
    }
    let (names, mark) = (names_in(&copy).await?, mark_of(&copy).await?);
    let mut copied = copy_objects(&source, &raw, &names)?;
    source.copy_metadata(&raw, true)?;
    if is_current && copied.failed.is_empty() {
        let assets = texts_in(&copy, "SELECT id FROM assets").await?;
        raw.remove_metadata_missing_in(&source, &assets)?;
        copied.unreferenced = quarantine_all_but(&names, &raw, quarantined_for)?;
    }
    raw.set_mark(&mark)?;
    copied.failed.append(&mut streams.failed);
    copied.streams = streams.replace()?;
    copy_tokens(data, to).await?;
    sync(to)?;
    Ok(copied)
}

/// The error of a folder that cannot be copied from or to.
fn unfit(folder: &Path, what: &'static str) -> StoreError {
    StoreError::Folder { path: folder.to_path_buf(), what }
}

/// Restores a backup into a data folder without a database. Existing objects, metadata files and streams are
/// kept: they are newer than the backup. The mark of existing objects says so too, so that the next start
/// reports it.
///
/// # Errors
/// The data folder has a database, or the backup has none; files cannot be written.
pub async fn restore_backup(from: &Path, data: &Path) -> Result<Copied, StoreError> {
    let (backup, database) = (from.join(DATABASE), data.join(DATABASE));
    if !backup.exists() {
        return Err(unfit(from, "has no flankwatch.db, expected a backup"));
    }
    integrity::check_header(&backup)?;
    if database.exists() {
        return Err(unfit(
            data,
            "has a database already, expected a folder without one: move its flankwatch.db* files away first",
        ));
    }
    let (names, mark) = (names_in(&backup).await?, mark_of(&backup).await?);
    let (source, raw) = (Objects::open_to_read(from.join("raw")), Objects::open(data.join("raw"))?);
    let mut copied = copy_objects(&source, &raw, &names)?;
    source.copy_metadata(&raw, false)?;
    match raw.mark()? {
        // Metadata may have changed since the generation was raised.
        Some(there) if there.store == mark.store && there.generation <= mark.generation => {
            raw.set_mark(&StoreMark { generation: mark.generation + 1, ..mark })?;
        }
        Some(_) => {}
        None => raw.set_mark(&mark)?,
    }
    let mut streams = StreamCopies::make(from, data, true)?;
    copied.failed.append(&mut streams.failed);
    copied.streams = streams.add()?;
    copy_tokens(from, data).await?;
    // The database comes last, so that an interrupted restore can be repeated.
    let part = data.join("flankwatch.db.part");
    fs::copy(&backup, &part).map_err(|source| file_error("copy", &backup, source))?;
    sync(&part)?;
    for left in ["flankwatch.db-wal", "flankwatch.db-shm"] {
        remove_file(&data.join(left))?;
    }
    fs::rename(&part, &database).map_err(|source| file_error("rename to", &database, source))?;
    sync(data)?;
    Ok(copied)
}

fn copy_objects(from: &Objects, to: &Objects, names: &[String]) -> Result<Copied, StoreError> {
    let mut copied = Copied::default();
    for name in names {
        copied.objects += 1;
        if to.written_at(name)?.is_some() {
            continue;
        }
        match from.get(name) {
            Ok(bytes) => to.put_all(&[(name.clone(), bytes)], &[])?,
            Err(error) if error.is_object_error() => {
                copied.failed.push(error.to_string());
                copied.objects -= 1;
                continue;
            }
            Err(error) => return Err(error),
        }
        copied.new += 1;
    }
    Ok(copied)
}

/// Moves all objects but those of these names into quarantine, and removes those whose quarantine has
/// expired; returns the number moved.
fn quarantine_all_but(names: &[String], raw: &Objects, quarantined_for: Duration) -> Result<u64, StoreError> {
    let (names, now): (HashSet<&String>, _) = (names.iter().collect(), Timestamp::now());
    let mut moved = 0;
    for shard in raw.shards()? {
        for object in raw.list(shard)?.iter().filter(|object| !names.contains(&object.name)) {
            raw.quarantine(&object.name, now)?;
            moved += 1;
        }
    }
    raw.remove_quarantined(quarantined_for, now)?;
    for shard in raw.shards()? {
        raw.remove_orphaned_metadata(raw.orphaned_metadata(shard, |_| true)?, |_| true)?;
    }
    Ok(moved)
}

/// Copies a snapshot of a database.
async fn copy_database(from: &Path, to: &Path) -> Result<(), StoreError> {
    let part = to.with_extension("db.part");
    remove_file(&part)?;
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
    texts_in(database, "SELECT DISTINCT sha256 AS id FROM raw_objects ORDER BY sha256").await
}

/// The texts `id` of the rows that a query finds.
async fn texts_in(database: &Path, query: &'static str) -> Result<Vec<String>, StoreError> {
    let mut connection = open(database).await?;
    let rows = sqlx::query(query).fetch_all(&mut connection).await?;
    connection.close().await?;
    rows.iter().map(|row| get(row, "id")).collect()
}

async fn mark_of(database: &Path) -> Result<StoreMark, StoreError> {
    let mut connection = open(database).await?;
    let row = sqlx::query("SELECT store, generation FROM store_identity WHERE one = 1")
        .fetch_one(&mut connection)
        .await?;
    connection.close().await?;
    Ok(StoreMark { store: get(&row, "store")?, generation: get(&row, "generation")? })
}

fn remove_file(path: &Path) -> Result<(), StoreError> {
    if_exists("remove", path, fs::remove_file(path)).map(drop)
}

fn sync(path: &Path) -> Result<(), StoreError> {
    let synced = File::open(path).and_then(|file| file.sync_all());
    synced.map_err(|source| file_error("sync", path, source))
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;

    use super::*;
    use crate::asset::{AssetId, SegmentId};
    use crate::store::{AssetMetadata, Store, StoreSettings, Tombstone};

    const QUARANTINED_FOR: Duration = Duration::from_secs(3600);

    /// Changes the rows of raw objects.
    async fn execute(database: &Path, text: &'static str) {
        sqlx::any::install_default_drivers();
        let mut connection = AnyConnection::connect(&sqlite_url(database, "rw")).await.unwrap();
        sqlx::query(text).execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
    }

    /// A data folder with an asset and two objects, with the names of these.
    async fn data_folder(folder: &Path) -> [String; 2] {
        let store = Store::open(&StoreSettings::Folder(folder.to_path_buf())).await.unwrap();
        let names = [&b"abc"[..], b"def"].map(|bytes| {
            let name = Objects::name(bytes);
            store.objects().put_all(&[(name.clone(), Bytes::from_static(bytes))], &[]).unwrap();
            name
        });
        store.close().await;
        let database = folder.join(DATABASE);
        let asset = r#"INSERT INTO assets (id, spec, created_at_ns, updated_at_ns)
            VALUES ('pump', '{"id":"pump"}', 0, 0)"#;
        execute(&database, asset).await;
        for name in &names {
            let text = format!("INSERT INTO raw_objects VALUES ('{name}', 'pump', 3, 0)");
            execute(&database, text.leak()).await;
        }
        names
    }

    async fn findings(folder: &Path) -> Vec<crate::store::Finding> {
        let store = Store::open_to_read(&StoreSettings::Folder(folder.to_path_buf())).await.unwrap();
        let audit = store.audit(true, Duration::ZERO).await.unwrap();
        store.close().await;
        audit.findings
    }

    #[tokio::test]
    async fn objects_that_the_database_no_longer_has_leave_a_backup_by_its_quarantine() {
        let place = tempfile::tempdir().unwrap();
        let (data, copy) = (place.path().join("data"), place.path().join("copy"));
        let names = data_folder(&data).await;
        let there = Objects::open(data.join("raw")).unwrap();
        let removal =
            Tombstone { removed_at: Timestamp::UNIX_EPOCH, segments: vec![SegmentId("s".to_owned())] };
        there.put_tombstone(&removal).unwrap();
        let copied = back_up(&data, &copy, QUARANTINED_FOR).await.unwrap();
        assert_eq!((copied.objects, copied.new, copied.unreferenced), (2, 2, 0));
        let raw = Objects::open(copy.join("raw")).unwrap();
        assert_eq!(raw.tombstones().unwrap(), [removal]);

        execute(&data.join(DATABASE), "DELETE FROM raw_objects WHERE sha256 LIKE 'ba78%'").await;
        there.quarantine(&names[0], Timestamp::now()).unwrap();
        there.withdraw_tombstones(&[SegmentId("s".to_owned())].into(), |_| true).unwrap();
        let copied = back_up(&data, &copy, QUARANTINED_FOR).await.unwrap();
        assert_eq!((copied.objects, copied.new, copied.unreferenced), (1, 0, 1));
        assert_eq!(findings(&copy).await, []);
        assert_eq!(raw.quarantined().unwrap()[0].name, names[0]);
        assert_eq!(raw.tombstones().unwrap(), [], "no record is removed");
        back_up(&data, &copy, Duration::ZERO).await.unwrap();
        assert_eq!(raw.quarantined().unwrap(), []);
    }

    #[tokio::test]
    async fn an_older_database_moves_no_object_of_a_backup() {
        let place = tempfile::tempdir().unwrap();
        let (data, copy) = (place.path().join("data"), place.path().join("copy"));
        data_folder(&data).await;
        back_up(&data, &copy, QUARANTINED_FOR).await.unwrap();
        execute(&data.join(DATABASE), "DELETE FROM raw_objects WHERE sha256 LIKE 'ba78%'").await;
        execute(&data.join(DATABASE), "UPDATE store_identity SET generation = generation - 1").await;
        let copied = back_up(&data, &copy, QUARANTINED_FOR).await.unwrap();
        assert_eq!((copied.objects, copied.unreferenced), (1, 0));
    }

    #[tokio::test]
    async fn a_restore_keeps_newer_notes_and_says_that_the_database_is_older() {
        let place = tempfile::tempdir().unwrap();
        let (data, copy) = (place.path().join("data"), place.path().join("copy"));
        data_folder(&data).await;
        let metadata = |second| AssetMetadata {
            spec: serde_json::from_str(r#"{"id":"pump"}"#).unwrap(),
            created_at: Timestamp::UNIX_EPOCH,
            updated_at: Timestamp::from_second(second).unwrap(),
            maintenance: Vec::new(),
            excluded: Vec::new(),
        };
        let (id, raw) = (AssetId::new("pump").unwrap(), Objects::open(data.join("raw")).unwrap());
        raw.put_asset_metadata(&metadata(1)).unwrap();
        back_up(&data, &copy, QUARANTINED_FOR).await.unwrap();
        raw.put_asset_metadata(&metadata(2)).unwrap();
        fs::remove_file(data.join(DATABASE)).unwrap();
        restore_backup(&copy, &data).await.unwrap();
        assert_eq!(raw.asset_metadata(&id).unwrap(), Some(metadata(2)));
        let store = Store::open(&StoreSettings::Folder(data.clone())).await.unwrap();
        assert!(store.removal_hold().is_some_and(|why| why.contains("the database is older")));
        store.close().await;
        let elsewhere = place.path().join("elsewhere");
        restore_backup(&copy, &elsewhere).await.unwrap();
        let store = Store::open(&StoreSettings::Folder(elsewhere)).await.unwrap();
        assert_eq!(
            (store.objects().asset_metadata(&id).unwrap(), store.removal_hold()),
            (Some(metadata(1)), None)
        );
        store.close().await;
    }
}
