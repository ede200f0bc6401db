//! Raw recordings as files named by the hash of their bytes: `ab/abcdef…`.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use sha2::{Digest, Sha256};

use super::StoreError;

/// A folder of immutable objects named by the SHA-256 of their bytes.
///
/// Every method blocks on the disk: call from a worker thread, not from an async one.
#[derive(Debug)]
pub struct Objects {
    folder: PathBuf,
    temporary: PathBuf,
    counter: AtomicU64,
}

impl Objects {
    /// Opens the folder, making it where it is missing and clearing what an interrupted write left behind.
    pub fn open(folder: impl Into<PathBuf>) -> Result<Self, StoreError> {
        let folder = folder.into();
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
        })
    }

    /// The name that bytes are stored under: their SHA-256 in lower-case hexadecimal.
    pub fn name(bytes: &[u8]) -> String {
        hexadecimal(&Sha256::digest(bytes))
    }

    /// Stores every object; when this returns they are on disk, and so are their names.
    ///
    /// `objects` holds (name, bytes) with the names that [`name`](Self::name) gives. One that is there already is left as it is.
    pub fn put_all<'a>(&self, objects: impl IntoIterator<Item = (&'a str, &'a [u8])>) -> Result<(), StoreError> {
        let mut touched: Vec<PathBuf> = Vec::new();
        for (name, bytes) in objects {
            let path = self.path(name);
            let folder = path.parent().unwrap_or(&self.folder).to_path_buf();
            let is_whole = fs::metadata(&path).is_ok_and(|metadata| metadata.len() == bytes.len() as u64);
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

    /// The bytes of an object, checked against its name.
    pub fn get(&self, name: &str) -> Result<Vec<u8>, StoreError> {
        let path = self.path(name);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(StoreError::ObjectMissing(name.to_string())),
            Err(source) => return Err(file_error("read", &path, source)),
        };
        let found = Self::name(&bytes);
        if found == name {
            Ok(bytes)
        } else {
            Err(StoreError::ObjectDamaged {
                expected: name.to_string(),
                found,
            })
        }
    }

    /// Removes an object; one that is not there is no error.
    pub fn remove(&self, name: &str) -> Result<(), StoreError> {
        let path = self.path(name);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(file_error("remove", &path, error)),
            _ => Ok(()),
        }
    }

    /// Names and sizes of the objects whose names begin with this byte.
    pub fn list(&self, shard: u8) -> Result<Vec<(String, u64)>, StoreError> {
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
            let is_object = name.len() == 64 && name.bytes().all(|byte| byte.is_ascii_hexdigit());
            if let Ok(metadata) = entry.metadata()
                && is_object
            {
                found.push((name, metadata.len()));
            }
        }
        Ok(found)
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

pub(super) fn file_error(action: &'static str, path: &Path, source: io::Error) -> StoreError {
    StoreError::File {
        action,
        path: path.to_path_buf(),
        source,
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(objects: &Objects, bytes: &[u8]) -> String {
        let name = Objects::name(bytes);
        objects.put_all([(name.as_str(), bytes)]).unwrap();
        name
    }

    #[test]
    fn an_object_is_named_by_its_sha256() {
        // FIPS 180-2, appendix B.1
        assert_eq!(
            Objects::name(b"abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }

    #[test]
    fn what_is_put_is_got_and_a_repeat_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let name = put(&objects, b"abc");
        assert_eq!(put(&objects, b"abc"), name);
        assert_eq!(objects.get(&name).unwrap(), b"abc");
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
        assert_eq!(objects.get(&name).unwrap(), b"abcdef");
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
