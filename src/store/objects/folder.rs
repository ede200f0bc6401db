//! Objects as files: `ab/abcdef…`.

use std::collections::HashSet;
use std::fs;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use jiff::Timestamp;

use super::{Backend, Disk, ListedFile, ListedObject, StoreError, SystemDisk, is_name};

/// Folder of the pieces of uploads.
const UPLOADS: &str = "uploads";

/// Age from which on a temporary file counts as left behind by a process that is gone.
#[cfg(feature = "postgres")]
const UNFINISHED_FOR: jiff::SignedDuration = jiff::SignedDuration::from_hours(24);

/// Bytes written to check for free space.
const PROBE_BYTES: usize = 1 << 20;

/// A folder of objects.
#[derive(Debug)]
pub(super) struct Folder {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    temporary: PathBuf,
    /// Prefix of the names of temporary files, different for each process that shares the folder.
    prefix: String,
    counter: AtomicU64,
    /// Folders of objects whose own names are known to be durable.
    durable: Mutex<HashSet<PathBuf>>,
    /// Whether other processes write to it too: an existing object is then written again, to reset its age.
    is_shared: bool,
}

impl Folder {
    /// Opens the folder, which is created if missing, and removes the files of interrupted writes.
    pub(super) fn open(folder: PathBuf, disk: Arc<dyn Disk>) -> Result<Self, StoreError> {
        let opened = Self::new(folder, String::new(), disk);
        opened.create_folder(&opened.temporary)?;
        // The names of the folder and its parent too: a crash must not lose the whole folder.
        for folder in opened.folder.ancestors().take(2).filter(|folder| !folder.as_os_str().is_empty()) {
            opened.sync_folder(folder)?;
        }
        opened.remove_unfinished(None)?;
        Ok(opened)
    }

    fn new(folder: PathBuf, prefix: String, disk: Arc<dyn Disk>) -> Self {
        Self {
            disk,
            temporary: folder.join("tmp"),
            folder,
            prefix,
            counter: AtomicU64::new(0),
            durable: Mutex::default(),
            is_shared: false,
        }
    }

    /// Opens an existing folder without removing unfinished files, which another process may be writing.
    pub(super) fn open_to_read(folder: PathBuf) -> Self {
        Self::new(folder, String::new(), Arc::new(SystemDisk))
    }

    /// Opens a folder that other processes write to as well, and removes old files of interrupted writes.
    #[cfg(feature = "postgres")]
    pub(super) fn open_shared(folder: PathBuf) -> Result<Self, StoreError> {
        let mut random = [0; 8];
        getrandom::fill(&mut random).map_err(|source| {
            file_error(
                "get a random number for a folder in",
                &folder,
                std::io::Error::other(source.to_string()),
            )
        })?;
        let prefix = format!("{}-", hex::encode(random));
        let opened = Self { is_shared: true, ..Self::new(folder, prefix, Arc::new(SystemDisk)) };
        opened.create_folder(&opened.temporary)?;
        // By the clock of the file system.
        let probe = opened.write_temporary(&[])?;
        let now =
            fs::metadata(&probe).map_err(|source| file_error("read the metadata of", &probe, source))?;
        let _ = opened.disk.remove_file(&probe);
        let before = written_at(&now).saturating_sub(UNFINISHED_FOR);
        opened.remove_unfinished(Some(before.unwrap_or(Timestamp::MIN)))?;
        Ok(opened)
    }

    /// Removes the files of interrupted writes, or only those last written before a time.
    fn remove_unfinished(&self, before: Option<Timestamp>) -> Result<(), StoreError> {
        let mut removed = 0;
        for entry in entries(&self.temporary)? {
            let path = entry.path();
            let Some(metadata) = if_exists("read the metadata of", &path, entry.metadata())? else {
                continue;
            };
            if metadata.is_file() && before.is_none_or(|before| written_at(&metadata) < before) {
                if_exists("remove the unfinished", &path, self.disk.remove_file(&path))?;
                removed += 1;
            }
        }
        if removed > 0 {
            tracing::info!(removed, "removed unfinished raw objects of earlier processes");
        }
        Ok(())
    }

    /// A new path for a temporary file.
    fn temporary_path(&self) -> PathBuf {
        self.temporary.join(format!("{}{}", self.prefix, self.counter.fetch_add(1, Ordering::Relaxed)))
    }

    /// Makes the names in a folder durable, and its own name in its parents.
    fn sync_up_from(&self, folder: &Path) -> Result<(), StoreError> {
        let inside = folder.ancestors().take_while(|folder| folder.starts_with(&self.folder));
        for folder in inside {
            self.sync_folder(folder)?;
        }
        Ok(())
    }

    fn sync_folder(&self, folder: &Path) -> Result<(), StoreError> {
        self.disk.sync_folder(folder).map_err(|source| file_error("sync the folder", folder, source))
    }

    fn create_folder(&self, folder: &Path) -> Result<(), StoreError> {
        self.disk.create_folder(folder).map_err(|source| file_error("create the folder", folder, source))
    }

    fn durable(&self) -> MutexGuard<'_, HashSet<PathBuf>> {
        self.durable.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        let temporary = self.write_temporary(bytes)?;
        self.disk.rename(&temporary, path).map_err(|source| file_error("rename to", path, source))
    }

    /// Writes bytes durably to a temporary file.
    fn write_temporary(&self, bytes: &[u8]) -> Result<PathBuf, StoreError> {
        let temporary = self.temporary_path();
        if let Err(source) = self.disk.write_synced(&temporary, bytes) {
            // A full disk must not also keep the partial file.
            let _ = self.disk.remove_file(&temporary);
            return Err(file_error("write", &temporary, source));
        }
        Ok(temporary)
    }
}

impl Backend for Folder {
    /// An object that exists intact is not written again.
    fn put_all(
        &self,
        objects: &[(String, Bytes)],
        metadata: Option<(String, Bytes)>,
    ) -> Result<(), StoreError> {
        let mut touched: Vec<PathBuf> = Vec::new();
        let files =
            objects.iter().map(|(name, bytes)| (self.folder.join(self.object_path(name)), bytes, true));
        let metadata = metadata.as_ref().map(|(path, bytes)| (self.folder.join(path), bytes, false));
        for (path, bytes, is_object) in files.chain(metadata) {
            let folder = path.parent().unwrap_or(&self.folder).to_path_buf();
            let is_whole = is_object && !self.is_shared && is_file_of(&path, bytes);
            if !is_whole {
                self.create_folder(&folder)?;
                self.write(&path, bytes)?;
            }
            if !self.durable().contains(&folder) {
                // Another thread may have created it a moment ago.
                touched.push(self.folder.clone());
            }
            // Also for an existing object: another thread may have renamed it a moment ago.
            touched.push(folder);
        }
        touched.sort_unstable();
        touched.dedup();
        for folder in &touched {
            self.sync_folder(folder)?;
        }
        self.durable().extend(touched);
        Ok(())
    }

    fn shards(&self) -> Result<Vec<u8>, StoreError> {
        let names = entries(&self.folder)?;
        let mut found: Vec<u8> =
            names.iter().filter_map(|entry| shard_of(entry.file_name().to_str()?)).collect();
        found.sort_unstable();
        Ok(found)
    }

    fn list(&self, shard: u8) -> Result<Vec<ListedObject>, StoreError> {
        let folder = self.folder.join(format!("{shard:02x}"));
        let listed = entries(&folder)?.into_iter().filter_map(|entry| {
            let name = entry.file_name().into_string().ok().filter(|name| is_name(name))?;
            let metadata = entry.metadata().ok()?;
            Some(ListedObject { name, bytes: metadata.len(), written_at: written_at(&metadata) })
        });
        Ok(listed.collect())
    }

    fn put_file(&self, path: &str, bytes: Bytes) -> Result<(), StoreError> {
        let path = self.folder.join(path);
        let folder = path.parent().unwrap_or(&self.folder);
        self.create_folder(folder)?;
        self.write(&path, &bytes)?;
        self.sync_up_from(folder)
    }

    fn create_file(&self, path: &str, bytes: Bytes) -> Result<bool, StoreError> {
        let path = self.folder.join(path);
        let temporary = self.write_temporary(&bytes)?;
        // Unlike a rename, a link does not replace an existing file.
        let linked = self.disk.link(&temporary, &path);
        let _ = self.disk.remove_file(&temporary);
        match linked {
            Ok(()) => self.sync_up_from(&self.folder).map(|()| true),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            Err(source) => Err(file_error("write", &path, source)),
        }
    }

    fn file(&self, path: &str) -> Result<Option<Bytes>, StoreError> {
        let path = self.folder.join(path);
        Ok(if_exists("read", &path, self.disk.read(&path))?.map(Bytes::from))
    }

    fn part(&self, path: &str, offset: u64, length: usize) -> Result<Option<Bytes>, StoreError> {
        let path = self.folder.join(path);
        let Some(mut file) = if_exists("read", &path, self.disk.open(&path))? else { return Ok(None) };
        let mut bytes = vec![0; length];
        let read = file.seek(SeekFrom::Start(offset)).and_then(|_| file.read_exact(&mut bytes));
        read.map_err(|source| file_error("read", &path, source))?;
        Ok(Some(bytes.into()))
    }

    fn metadata(&self, path: &str) -> Result<Option<(u64, Timestamp)>, StoreError> {
        let path = self.folder.join(path);
        let found = if_exists("read the metadata of", &path, fs::metadata(&path))?;
        Ok(found.map(|metadata| (metadata.len(), written_at(&metadata))))
    }

    fn files(&self, under: &str) -> Result<Vec<ListedFile>, StoreError> {
        let mut found = Vec::new();
        let mut folders = vec![under.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in entries(&self.folder.join(&folder))? {
                let (Ok(name), Ok(metadata)) = (entry.file_name().into_string(), entry.metadata()) else {
                    continue;
                };
                let path = format!("{folder}/{name}");
                if metadata.is_dir() {
                    folders.push(path);
                } else {
                    let bytes = metadata.len();
                    found.push(ListedFile { path, bytes });
                }
            }
        }
        Ok(found)
    }

    fn move_file(&self, from: &str, to: &str) -> Result<(), StoreError> {
        let (from, to) = (self.folder.join(from), self.folder.join(to));
        let folder = to.parent().unwrap_or(&self.folder);
        self.create_folder(folder)?;
        if if_exists("move", &from, self.disk.rename(&from, &to))?.is_none() {
            return Ok(());
        }
        if let Some(left) = from.parent().filter(|left| *left != folder) {
            self.sync_up_from(left)?;
        }
        self.sync_up_from(folder)
    }

    fn remove_file(&self, path: &str) -> Result<(), StoreError> {
        let path = self.folder.join(path);
        if_exists("remove", &path, self.disk.remove_file(&path)).map(drop)
    }

    fn object_path(&self, name: &str) -> String {
        format!("{}/{name}", name.get(..2).unwrap_or("xx"))
    }

    fn remove_pieces(&self, upload: &str) -> Result<(), StoreError> {
        let folder = self.folder.join(UPLOADS).join(upload);
        if_exists("remove", &folder, self.disk.remove_folder(&folder)).map(drop)
    }

    fn uploads(&self) -> Result<Vec<String>, StoreError> {
        let entries = entries(&self.folder.join(UPLOADS))?;
        Ok(entries.iter().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect())
    }

    /// Writes and removes a file.
    fn check_free_space(&self) -> Result<(), StoreError> {
        let path = self.temporary_path();
        let written = fs::write(&path, vec![1_u8; PROBE_BYTES]);
        let _ = fs::remove_file(&path);
        written.map_err(|source| file_error("write", &path, source))
    }
}

/// The result of an action on a path; `None` if the path does not exist.
pub(in crate::store) fn if_exists<T>(
    action: &'static str,
    path: &Path,
    result: io::Result<T>,
) -> Result<Option<T>, StoreError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(file_error(action, path, source)),
    }
}

/// The entries of a folder; none if it does not exist.
fn entries(folder: &Path) -> Result<Vec<fs::DirEntry>, StoreError> {
    let Some(entries) = if_exists("list", folder, fs::read_dir(folder))? else { return Ok(Vec::new()) };
    entries.collect::<io::Result<_>>().map_err(|source| file_error("list", folder, source))
}

/// The first byte of the names in a folder called `name`.
fn shard_of(name: &str) -> Option<u8> {
    let mut shard = [0];
    hex::decode_to_slice(name, &mut shard).ok()?;
    Some(shard[0])
}

/// Whether a file contains these bytes.
fn is_file_of(path: &Path, bytes: &[u8]) -> bool {
    let has_length = fs::metadata(path).is_ok_and(|metadata| metadata.len() == bytes.len() as u64);
    has_length && fs::read(path).is_ok_and(|found| found == bytes)
}

/// When a file was last written; the latest possible time if the file system does not say.
fn written_at(metadata: &fs::Metadata) -> Timestamp {
    let modified = metadata.modified().ok().and_then(|time| Timestamp::try_from(time).ok());
    modified.unwrap_or(Timestamp::MAX)
}

pub(in crate::store) fn file_error(action: &'static str, path: &Path, source: io::Error) -> StoreError {
    StoreError::File { action, path: path.to_path_buf(), source }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Objects;

    fn put(objects: &Objects, bytes: &[u8]) -> String {
        let name = Objects::name(bytes);
        objects.put_all(&[(name.clone(), Bytes::copy_from_slice(bytes))], &[]).unwrap();
        name
    }

    #[test]
    fn objects_are_stored_once() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let name = put(&objects, b"abc");
        assert_eq!(put(&objects, b"abc"), name);
        assert_eq!(objects.get(&name).unwrap(), &b"abc"[..]);
        objects.remove(&name).unwrap();
        objects.remove(&name).unwrap();
        assert!(matches!(objects.get(&name), Err(StoreError::ObjectMissing(_))));
    }

    #[test]
    fn damage_is_found_and_a_damaged_object_is_written_again() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let name = put(&objects, b"abcdef");
        let path = folder.path().join(&name[..2]).join(&name);
        fs::write(&path, b"abcdex").unwrap();
        assert!(matches!(objects.get(&name), Err(StoreError::ObjectDamaged { .. })));
        for damaged in [&b"abcdex"[..], b"abc"] {
            fs::write(&path, damaged).unwrap();
            put(&objects, b"abcdef");
            assert_eq!(objects.get(&name).unwrap(), &b"abcdef"[..]);
        }
    }

    #[test]
    fn the_check_of_free_space_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        objects.check_free_space().unwrap();
        assert_eq!(fs::read_dir(folder.path().join("tmp")).unwrap().count(), 0);
        fs::remove_dir(folder.path().join("tmp")).unwrap();
        assert!(objects.check_free_space().is_err());
    }

    /// Records which folders are synced.
    #[derive(Debug, Default)]
    struct RecordingDisk {
        synced: Mutex<Vec<PathBuf>>,
    }

    impl Disk for RecordingDisk {
        fn sync_folder(&self, path: &Path) -> io::Result<()> {
            self.synced.lock().unwrap().push(path.to_path_buf());
            SystemDisk.sync_folder(path)
        }
    }

    #[test]
    fn the_names_of_folders_are_synced() {
        let data = tempfile::tempdir().unwrap();
        let raw = data.path().join("raw");
        let disk = Arc::new(RecordingDisk::default());
        let folder = Folder::open(raw.clone(), disk.clone()).unwrap();
        let synced = || std::mem::take(&mut *disk.synced.lock().unwrap());
        assert_eq!(synced(), [raw.clone(), data.path().to_path_buf()]);
        let name = Objects::name(b"abc");
        // Like another thread that has not synced yet.
        fs::create_dir(raw.join(&name[..2])).unwrap();
        let object = [(name.clone(), Bytes::from_static(b"abc"))];
        folder.put_all(&object, None).unwrap();
        assert_eq!(synced(), [raw.clone(), raw.join(&name[..2])]);
        folder.put_all(&object, None).unwrap();
        assert_eq!(synced(), [raw.join(&name[..2])], "a name is synced once");
    }

    #[test]
    fn unfinished_writes_are_removed_on_opening() {
        let folder = tempfile::tempdir().unwrap();
        drop(Objects::open(folder.path()).unwrap());
        fs::write(folder.path().join("tmp/7"), b"half").unwrap();
        drop(Objects::open(folder.path()).unwrap());
        assert_eq!(fs::read_dir(folder.path().join("tmp")).unwrap().count(), 0);
    }

    #[cfg(feature = "postgres")]
    #[test]
    fn old_unfinished_writes_of_other_processes_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let settings = crate::store::ObjectsSettings::Folder(folder.path().to_path_buf());
        let objects = Objects::open_shared(&settings).unwrap();
        let temporary = folder.path().join("tmp");
        for (name, hours) in [("old-0", 25), ("young-0", 23)] {
            let file = fs::File::create(temporary.join(name)).unwrap();
            let written_at = std::time::SystemTime::now() - std::time::Duration::from_secs(3600 * hours);
            file.set_modified(written_at).unwrap();
        }
        let other = Objects::open_shared(&settings).unwrap();
        let left: Vec<_> =
            fs::read_dir(&temporary).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(left, ["young-0"]);
        put(&objects, b"abc");
        put(&other, b"def");
    }
}
