//! Raw recordings as immutable objects named by the hash of their bytes, in a folder or in a bucket; and
//! libraries that processes share.

#[cfg(feature = "s3")]
mod bucket;
mod disk;
mod folder;
mod mark;
mod notes;
mod quarantine;

use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;
use ring::digest::{SHA256, digest};

use super::StoreError;

pub use disk::{Disk, SystemDisk};
pub(super) use folder::{file_error, if_exists};
pub use mark::StoreMark;
pub use notes::{AssetNote, RecordNote, RemovalNote};
pub use quarantine::Quarantined;

/// Path of the file written to check for write access; nothing reads it.
const WRITE_PROBE: &str = "probes/write";

/// Immutable objects named by the SHA-256 of their bytes.
///
/// Every method blocks on the disk or the network: to be called on a blocking or worker thread, not on an
/// async one.
#[derive(Debug)]
pub struct Objects {
    backend: Backend,
}

#[derive(Debug)]
enum Backend {
    Folder(folder::Folder),
    #[cfg(feature = "s3")]
    Bucket(bucket::Bucket),
}

/// An entry in a list of objects.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedObject {
    /// Its name.
    pub name: String,
    /// Its size in bytes.
    pub bytes: u64,
    /// When it was last written, by the clock of the object store.
    pub written_at: Timestamp,
}

/// An entry in a list of files.
#[derive(Debug, Clone, PartialEq, Eq)]
struct ListedFile {
    path: String,
    bytes: u64,
}

impl Objects {
    /// Opens a folder, which is created if missing, and removes the files of interrupted writes.
    pub fn open(folder: impl Into<PathBuf>) -> Result<Self, StoreError> {
        Self::open_on(folder, Arc::new(SystemDisk))
    }

    /// Opens a folder on the given disk.
    pub(super) fn open_on(folder: impl Into<PathBuf>, disk: Arc<dyn Disk>) -> Result<Self, StoreError> {
        Ok(Self { backend: Backend::Folder(folder::Folder::open(folder.into(), disk)?) })
    }

    /// Opens an existing folder without removing unfinished files, which another process may be writing.
    pub(super) fn open_to_read(folder: impl Into<PathBuf>) -> Self {
        Self { backend: Backend::Folder(folder::Folder::open_to_read(folder.into())) }
    }

    /// Opens objects that other processes write to as well. Must be called inside a Tokio runtime, which
    /// performs the requests to a bucket.
    #[cfg(feature = "postgres")]
    pub(super) fn open_shared(settings: &super::ObjectsSettings) -> Result<Self, StoreError> {
        let backend = match settings {
            super::ObjectsSettings::Folder(folder) => {
                Backend::Folder(folder::Folder::open_shared(folder.clone())?)
            }
            #[cfg(feature = "s3")]
            super::ObjectsSettings::Bucket(bucket) => Backend::Bucket(bucket::Bucket::open(bucket)?),
        };
        Ok(Self { backend })
    }

    /// The name under which bytes are stored: their SHA-256 in lower-case hexadecimal.
    pub fn name(bytes: &[u8]) -> String {
        // Every record is hashed: without SHA instructions this implementation is twice as fast as the one
        // that hashes keys elsewhere.
        hex::encode(digest(&SHA256, bytes).as_ref())
    }

    /// Stores every object under its [`name`](Self::name), with the note needed to decode `records` from
    /// them; bytes and names are durable once this returns.
    pub fn put_all(&self, objects: &[(String, Bytes)], records: &[RecordNote]) -> Result<(), StoreError> {
        let note = self.note_of(records)?;
        match &self.backend {
            Backend::Folder(folder) => folder.put_all(objects, note),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.put_all(objects, note),
        }
    }

    /// Reads an object and checks its bytes against its name.
    pub fn get(&self, name: &str) -> Result<Bytes, StoreError> {
        let bytes = self.file(&self.object_path(name))?;
        whole(name, bytes.ok_or_else(|| StoreError::ObjectMissing(name.to_owned()))?)
    }

    /// Checks that an object exists with this number of bytes. Its bytes are read only if its size differs;
    /// in a bucket only its existence is checked.
    pub(super) fn check_size(&self, name: &str, bytes: u64) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => match folder.size(name)? {
                None => Err(StoreError::ObjectMissing(name.to_owned())),
                Some(found) if found == bytes => Ok(()),
                Some(_) => self.get(name).map(|_| ()),
            },
            #[cfg(feature = "s3")]
            Backend::Bucket(_) => match self.written_at(name)? {
                None => Err(StoreError::ObjectMissing(name.to_owned())),
                Some(_) => Ok(()),
            },
        }
    }

    /// Checks that there is free space for a small record; always succeeds for a bucket.
    pub fn check_free_space(&self) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.check_free_space(),
            #[cfg(feature = "s3")]
            Backend::Bucket(_) => Ok(()),
        }
    }

    /// Checks that a file can be written beside the objects.
    pub fn check_writable(&self) -> Result<(), StoreError> {
        self.put_file(WRITE_PROBE, Bytes::new())
    }

    /// Removes an object; a missing object is no error.
    pub fn remove(&self, name: &str) -> Result<(), StoreError> {
        self.remove_file(&self.object_path(name))
    }

    /// When an object was last written; `None` if it does not exist.
    pub fn written_at(&self, name: &str) -> Result<Option<Timestamp>, StoreError> {
        self.file_written_at(&self.object_path(name))
    }

    /// Stores the file of a library under its name, shared by all processes.
    pub fn put_library(&self, id: &str, bytes: Bytes) -> Result<(), StoreError> {
        self.put_file(&library_path(id), bytes)
    }

    /// Reads the shared file of a library; `None` if it does not exist.
    pub fn library(&self, id: &str) -> Result<Option<Bytes>, StoreError> {
        self.file(&library_path(id))
    }

    /// Stores a piece of an upload and returns its name, which is the hash of its bytes; durable once this
    /// returns.
    pub fn put_piece(&self, upload: &str, bytes: Bytes) -> Result<String, StoreError> {
        let name = Self::name(&bytes);
        self.put_file(&piece_path(upload, &name), bytes)?;
        Ok(name)
    }

    /// Reads a piece of an upload and checks its bytes against its name.
    pub fn piece(&self, upload: &str, name: &str) -> Result<Bytes, StoreError> {
        let bytes = self.file(&piece_path(upload, name))?;
        whole(name, bytes.ok_or_else(|| StoreError::ObjectMissing(name.to_owned()))?)
    }

    /// Removes all pieces of an upload.
    pub fn remove_pieces(&self, upload: &str) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.remove_pieces(upload),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.remove_pieces(upload),
        }
    }

    /// Lists the uploads that have pieces.
    pub fn uploads(&self) -> Result<Vec<String>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.uploads(),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.uploads(),
        }
    }

    /// The first bytes of the names of existing objects and notes, in order; in a bucket all bytes.
    pub fn shards(&self) -> Result<Vec<u8>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.shards(),
            #[cfg(feature = "s3")]
            Backend::Bucket(_) => Ok((0..=u8::MAX).collect()),
        }
    }

    /// Lists the objects whose names start with this byte.
    pub fn list(&self, shard: u8) -> Result<Vec<ListedObject>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.list(shard),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.list(shard),
        }
    }
}

/// Files by path: objects, and the files beside them.
impl Objects {
    fn object_path(&self, name: &str) -> String {
        match &self.backend {
            Backend::Folder(_) => folder::Folder::object_path(name),
            #[cfg(feature = "s3")]
            Backend::Bucket(_) => bucket::Bucket::object_path(name),
        }
    }

    fn put_file(&self, path: &str, bytes: Bytes) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.put_file(path, &bytes),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.put_file(path, bytes),
        }
    }

    fn create_file(&self, path: &str, bytes: Bytes) -> Result<bool, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.create_file(path, &bytes),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.create_file(path, bytes),
        }
    }

    fn file(&self, path: &str) -> Result<Option<Bytes>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.file(path),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.file(path),
        }
    }

    fn file_written_at(&self, path: &str) -> Result<Option<Timestamp>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.file_written_at(path),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.file_written_at(path),
        }
    }

    fn files(&self, under: &str) -> Result<Vec<ListedFile>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.files(under),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.files(under),
        }
    }

    fn move_file(&self, from: &str, to: &str) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.move_file(from, to),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.move_file(from, to),
        }
    }

    fn remove_file(&self, path: &str) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.remove_file(path),
            #[cfg(feature = "s3")]
            Backend::Bucket(bucket) => bucket.remove_file(path),
        }
    }
}

fn library_path(id: &str) -> String {
    format!("libraries/{id}.fwlib")
}

fn piece_path(upload: &str, name: &str) -> String {
    format!("uploads/{upload}/{name}")
}

/// Checks bytes against their name.
fn whole(name: &str, bytes: Bytes) -> Result<Bytes, StoreError> {
    let found = Objects::name(&bytes);
    if found == name {
        Ok(bytes)
    } else {
        Err(StoreError::ObjectDamaged { expected: name.to_string(), found })
    }
}

/// Whether a text is a valid object name.
fn is_name(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_is_named_by_its_sha256() {
        // FIPS 180-2, appendix B.1
        assert_eq!(Objects::name(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
