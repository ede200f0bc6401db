//! Objects as files: `ab/abcdef…`.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use jiff::Timestamp;

use super::{ListedObject, StoreError, is_name};

/// Where the pieces of uploads are.
const UPLOADS: &str = "uploads";

/// A folder of objects.
#[derive(Debug)]
pub(super) struct Folder {
    folder: PathBuf,
    temporary: PathBuf,
    counter: AtomicU64,
    /// Other processes write to it too: an object that is there is written again, so that it counts as new.
    is_shared: bool,
}

impl Folder {
    /// Opens the folder, making it where it is missing and clearing what an interrupted write left behind.
    pub(super) fn open(folder: PathBuf) -> Result<Self, StoreError> {
        let temporary = folder.join("tmp");
        fs::create_dir_all(&temporary).map_err(|source| file_error("create the folder", &temporary, source))?;
        let mut stale = 0;
        for entry in fs::read_dir(&temporary).map_err(|source| file_error("list", &temporary, source))? {
            let path = entry.map_err(|source| file_error("list", &temporary, source))?.path();
            fs::remove_file(&path).map_err(|source| file_error("remove the unfinished", &path, source))?;
            stale += 1;
        }
        if stale > 0 {
            tracing::info!(stale, "removed unfinished raw objects of an earlier run");
        }
        Ok(Self {
            folder,
            temporary,
            counter: AtomicU64::new(0),
            is_shared: false,
        })
    }

    /// Opens a folder that other processes write to as well; what they are writing is left alone.
    #[cfg(feature = "cluster")]
    pub(super) fn open_shared(folder: PathBuf) -> Result<Self, StoreError> {
        let mut unguessable = [0; 8];
        getrandom::fill(&mut unguessable).map_err(|source| file_error("name a folder in", &folder, source.into()))?;
        let temporary = folder.join("tmp").join(hex::encode(unguessable));
        fs::create_dir_all(&temporary).map_err(|source| file_error("create the folder", &temporary, source))?;
        Ok(Self {
            folder,
            temporary,
            counter: AtomicU64::new(0),
            is_shared: true,
        })
    }

    /// Stores every object; when this returns they are on disk, and so are their names. One that is there
    /// already is left as it is.
    pub(super) fn put_all(&self, objects: &[(String, Bytes)]) -> Result<(), StoreError> {
        let mut touched: Vec<PathBuf> = Vec::new();
        for (name, bytes) in objects {
            let path = self.path(name);
            let folder = path.parent().unwrap_or(&self.folder).to_path_buf();
            let is_whole = !self.is_shared && fs::metadata(&path).is_ok_and(|metadata| metadata.len() == bytes.len() as u64);
            if !is_whole {
                if !folder.is_dir() {
                    fs::create_dir_all(&folder).map_err(|source| file_error("create the folder", &folder, source))?;
                    touched.push(self.folder.clone());
                }
                self.write(&path, bytes)?;
            }
            // Also for an object that was there: another thread may have renamed it a moment ago.
            touched.push(folder);
        }
        touched.sort_unstable();
        touched.dedup();
        for folder in touched {
            File::open(&folder)
                .and_then(|folder| folder.sync_all())
                .map_err(|source| file_error("sync the folder", &folder, source))?;
        }
        Ok(())
    }

    /// The bytes under a name.
    pub(super) fn get(&self, name: &str) -> Result<Bytes, StoreError> {
        let path = self.path(name);
        match fs::read(&path) {
            Ok(bytes) => Ok(bytes.into()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Err(StoreError::ObjectMissing(name.to_string())),
            Err(source) => Err(file_error("read", &path, source)),
        }
    }

    /// When an object was last written; none where it is not there.
    pub(super) fn written_at(&self, name: &str) -> Result<Option<Timestamp>, StoreError> {
        let path = self.path(name);
        match fs::metadata(&path) {
            Ok(metadata) => Ok(Some(written_at(&metadata))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(file_error("look at", &path, source)),
        }
    }

    /// Removes an object; one that is not there is no error.
    pub(super) fn remove(&self, name: &str) -> Result<(), StoreError> {
        let path = self.path(name);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(file_error("remove", &path, error)),
            _ => Ok(()),
        }
    }

    /// The objects whose names begin with this byte.
    pub(super) fn list(&self, shard: u8) -> Result<Vec<ListedObject>, StoreError> {
        let folder = self.folder.join(format!("{shard:02x}"));
        let entries = match fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(source) => return Err(file_error("list", &folder, source)),
        };
        let mut found = Vec::new();
        for entry in entries {
            let entry = entry.map_err(|source| file_error("list", &folder, source))?;
            let Ok(name) = entry.file_name().into_string() else { continue };
            if let Ok(metadata) = entry.metadata()
                && is_name(&name)
            {
                found.push(ListedObject {
                    name,
                    bytes: metadata.len(),
                    written_at: written_at(&metadata),
                });
            }
        }
        Ok(found)
    }

    /// Keeps the file of a library.
    pub(super) fn put_library(&self, id: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let path = self.library_path(id);
        let folder = path.parent().unwrap_or(&self.folder);
        fs::create_dir_all(folder).map_err(|source| file_error("create the folder", folder, source))?;
        self.write(&path, bytes)
    }

    /// The file of a library; none where there is none.
    pub(super) fn library(&self, id: &str) -> Result<Option<Bytes>, StoreError> {
        let path = self.library_path(id);
        match fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes.into())),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(file_error("read", &path, source)),
        }
    }

    /// Keeps a piece of an upload.
    pub(super) fn put_piece(&self, upload: &str, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        let folder = self.pieces(upload);
        fs::create_dir_all(&folder).map_err(|source| file_error("create the folder", &folder, source))?;
        self.write(&folder.join(name), bytes)?;
        for folder in [&folder, &self.folder.join(UPLOADS), &self.folder] {
            File::open(folder)
                .and_then(|folder| folder.sync_all())
                .map_err(|source| file_error("sync the folder", folder, source))?;
        }
        Ok(())
    }

    /// A piece of an upload.
    pub(super) fn piece(&self, upload: &str, name: &str) -> Result<Bytes, StoreError> {
        let path = self.pieces(upload).join(name);
        match fs::read(&path) {
            Ok(bytes) => Ok(bytes.into()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Err(StoreError::ObjectMissing(name.to_string())),
            Err(source) => Err(file_error("read", &path, source)),
        }
    }

    /// Removes what is kept of an upload.
    pub(super) fn remove_pieces(&self, upload: &str) -> Result<(), StoreError> {
        let folder = self.pieces(upload);
        match fs::remove_dir_all(&folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(file_error("remove", &folder, error)),
            _ => Ok(()),
        }
    }

    /// The uploads of which there are pieces.
    pub(super) fn uploads(&self) -> Result<Vec<String>, StoreError> {
        let folder = self.folder.join(UPLOADS);
        let entries = match fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(source) => return Err(file_error("list", &folder, source)),
        };
        let names = entries.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
        names
            .collect::<io::Result<Vec<String>>>()
            .map_err(|source| file_error("list", &folder, source))
    }

    fn pieces(&self, upload: &str) -> PathBuf {
        self.folder.join(UPLOADS).join(upload)
    }

    fn library_path(&self, id: &str) -> PathBuf {
        self.folder.join("libraries").join(format!("{id}.fwlib"))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name.get(..2).unwrap_or("xx")).join(name)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        let temporary = self.temporary.join(self.counter.fetch_add(1, Ordering::Relaxed).to_string());
        let written = File::create(&temporary).and_then(|mut file| {
            file.write_all(bytes)?;
            file.sync_all()
        });
        if let Err(source) = written {
            // A full disk must not also keep the part that fitted.
            let _ = fs::remove_file(&temporary);
            return Err(file_error("write", &temporary, source));
        }
        fs::rename(&temporary, path).map_err(|source| file_error("rename to", path, source))
    }
}

/// When a file was last written; never long ago where the file system does not say.
fn written_at(metadata: &fs::Metadata) -> Timestamp {
    let modified = metadata.modified().ok().and_then(|time| Timestamp::try_from(time).ok());
    modified.unwrap_or(Timestamp::MAX)
}

pub(in crate::store) fn file_error(action: &'static str, path: &Path, source: io::Error) -> StoreError {
    StoreError::File {
        action,
        path: path.to_path_buf(),
        source,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Objects;

    fn put(objects: &Objects, bytes: &[u8]) -> String {
        let name = Objects::name(bytes);
        objects.put_all(&[(name.clone(), Bytes::copy_from_slice(bytes))]).unwrap();
        name
    }

    #[test]
    fn what_is_put_is_got_and_a_repeat_changes_nothing() {
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
    fn damage_is_found_and_a_shortened_object_is_written_again() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let name = put(&objects, b"abcdef");
        let path = folder.path().join(&name[..2]).join(&name);
        fs::write(&path, b"abcdex").unwrap();
        assert!(matches!(objects.get(&name), Err(StoreError::ObjectDamaged { .. })));
        fs::write(&path, b"abc").unwrap();
        put(&objects, b"abcdef");
        assert_eq!(objects.get(&name).unwrap(), &b"abcdef"[..]);
    }

    #[test]
    fn an_unfinished_write_is_cleared_on_opening() {
        let folder = tempfile::tempdir().unwrap();
        drop(Objects::open(folder.path()).unwrap());
        fs::write(folder.path().join("tmp/7"), b"half").unwrap();
        drop(Objects::open(folder.path()).unwrap());
        assert_eq!(fs::read_dir(folder.path().join("tmp")).unwrap().count(), 0);
    }
}
