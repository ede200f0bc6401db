//! Raw recordings as immutable objects named by the hash of their bytes, in a folder or in a bucket; and
//! libraries that processes share.

#[cfg(feature = "s3")]
mod bucket;
mod disk;
mod folder;
mod mark;
mod metadata;
mod quarantine;

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;
use ring::digest::{Context, SHA256, digest};

use super::StoreError;

pub use disk::{Disk, SystemDisk};
pub(super) use folder::{file_error, if_exists};
pub use mark::StoreMark;
pub use metadata::{AssetMetadata, RecordMetadata, Tombstone};
pub use quarantine::Quarantined;

/// Path of the file written to check for write access; nothing reads it.
const WRITE_PROBE: &str = "probes/write";

/// Bytes of an object that are in memory at once where it is read in pieces.
const PIECE_BYTES: usize = 1 << 20;

/// Immutable objects named by the SHA-256 of their bytes.
///
/// Every method blocks on the disk or the network: to be called on a blocking or worker thread, not on an
/// async one.
#[derive(Debug)]
pub struct Objects {
    backend: Box<dyn Backend>,
}

/// What holds the objects, and files beside them, by path.
trait Backend: fmt::Debug + Send + Sync {
    /// The path of an object.
    fn object_path(&self, name: &str) -> String;

    /// Stores every object, and a metadata file beside them; bytes and names are durable once this returns.
    fn put_all(
        &self,
        objects: &[(String, Bytes)],
        metadata: Option<(String, Bytes)>,
    ) -> Result<(), StoreError>;

    /// Checks that there is free space for a small record.
    fn check_free_space(&self) -> Result<(), StoreError> {
        Ok(())
    }

    /// The first bytes of the names of existing objects and metadata files, in order; all bytes if they are
    /// unknown.
    fn shards(&self) -> Result<Vec<u8>, StoreError> {
        Ok((0..=u8::MAX).collect())
    }

    /// Lists the objects whose names start with this byte.
    fn list(&self, shard: u8) -> Result<Vec<ListedObject>, StoreError>;

    /// Removes all pieces of an upload.
    fn remove_pieces(&self, upload: &str) -> Result<(), StoreError>;

    /// Lists the uploads that have pieces.
    fn uploads(&self) -> Result<Vec<String>, StoreError>;

    /// Writes a file; bytes and name are durable once this returns.
    fn put_file(&self, path: &str, bytes: Bytes) -> Result<(), StoreError>;

    /// Writes a file unless the path exists; returns whether it was written.
    fn create_file(&self, path: &str, bytes: Bytes) -> Result<bool, StoreError>;

    /// Reads a file; returns `None` if it does not exist.
    fn file(&self, path: &str) -> Result<Option<Bytes>, StoreError>;

    /// Reads `length` bytes of a file from `offset` on; `None` if the file does not exist.
    fn part(&self, path: &str, offset: u64, length: usize) -> Result<Option<Bytes>, StoreError>;

    /// The size of a file and when it was last written, by the clock of the object store; `None` if it does
    /// not exist.
    fn metadata(&self, path: &str) -> Result<Option<(u64, Timestamp)>, StoreError>;

    /// Lists all files under a path, including those in subfolders.
    fn files(&self, under: &str) -> Result<Vec<ListedFile>, StoreError>;

    /// Moves a file; a missing file is not an error.
    fn move_file(&self, from: &str, to: &str) -> Result<(), StoreError>;

    /// Removes a file; a missing file is not an error.
    fn remove_file(&self, path: &str) -> Result<(), StoreError>;
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
        Ok(Self { backend: Box::new(folder::Folder::open(folder.into(), disk)?) })
    }

    /// Opens an existing folder without removing unfinished files, which another process may be writing.
    pub(super) fn open_to_read(folder: impl Into<PathBuf>) -> Self {
        Self { backend: Box::new(folder::Folder::open_to_read(folder.into())) }
    }

    /// Opens objects that other processes write to as well. Must be called inside a Tokio runtime, which
    /// performs the requests to a bucket.
    #[cfg(feature = "postgres")]
    pub(super) fn open_shared(settings: &super::ObjectsSettings) -> Result<Self, StoreError> {
        let backend: Box<dyn Backend> = match settings {
            super::ObjectsSettings::Folder(folder) => Box::new(folder::Folder::open_shared(folder.clone())?),
            #[cfg(feature = "s3")]
            super::ObjectsSettings::Bucket(bucket) => Box::new(bucket::Bucket::open(bucket)?),
        };
        Ok(Self { backend })
    }

    /// The name under which bytes are stored: their SHA-256 in lower-case hexadecimal.
    pub fn name(bytes: &[u8]) -> String {
        // Every record is hashed: without SHA instructions this implementation is twice as fast as the one
        // that hashes keys elsewhere.
        hex::encode(digest(&SHA256, bytes).as_ref())
    }

    /// Stores every object under its [`name`](Self::name), with the metadata file needed to decode `records`
    /// from them; bytes and names are durable once this returns.
    pub fn put_all(&self, objects: &[(String, Bytes)], records: &[RecordMetadata]) -> Result<(), StoreError> {
        self.backend.put_all(objects, self.file_of(records)?)
    }

    /// Reads an object and checks its bytes against its name.
    pub fn get(&self, name: &str) -> Result<Bytes, StoreError> {
        let bytes = self.backend.file(&self.backend.object_path(name))?;
        whole(name, bytes.ok_or_else(|| StoreError::ObjectMissing(name.to_owned()))?)
    }

    /// Reads the piece of an object of `bytes` bytes that starts at `offset`; it is not checked.
    pub fn object_piece(&self, name: &str, bytes: u64, offset: u64) -> Result<Bytes, StoreError> {
        let length = usize::try_from(bytes.saturating_sub(offset)).unwrap_or(usize::MAX).min(PIECE_BYTES);
        let piece = self.backend.part(&self.backend.object_path(name), offset, length)?;
        let piece = piece.filter(|piece| !piece.is_empty());
        piece.ok_or_else(|| StoreError::ObjectMissing(name.to_owned()))
    }

    /// Checks the bytes of an object against its name, piece by piece; returns their number.
    pub fn check(&self, name: &str) -> Result<u64, StoreError> {
        let found = self.backend.metadata(&self.backend.object_path(name))?;
        let (bytes, _) = found.ok_or_else(|| StoreError::ObjectMissing(name.to_owned()))?;
        let (mut hash, mut offset) = (Context::new(&SHA256), 0);
        while offset < bytes {
            let piece = self.object_piece(name, bytes, offset)?;
            hash.update(&piece);
            offset += piece.len() as u64;
        }
        let found = hex::encode(hash.finish().as_ref());
        if found == name {
            return Ok(bytes);
        }
        Err(StoreError::ObjectDamaged { expected: name.to_owned(), found })
    }

    /// Checks that an object exists with this number of bytes. Its bytes are read only if its size differs.
    pub(super) fn check_size(&self, name: &str, bytes: u64) -> Result<(), StoreError> {
        match self.backend.metadata(&self.backend.object_path(name))? {
            None => Err(StoreError::ObjectMissing(name.to_owned())),
            Some((found, _)) if found == bytes => Ok(()),
            Some(_) => self.get(name).map(|_| ()),
        }
    }

    /// Checks that there is free space for a small record; always succeeds for a bucket.
    pub fn check_free_space(&self) -> Result<(), StoreError> {
        self.backend.check_free_space()
    }

    /// Checks that a file can be written beside the objects.
    pub fn check_writable(&self) -> Result<(), StoreError> {
        self.backend.put_file(WRITE_PROBE, Bytes::new())
    }

    /// Removes an object; a missing object is not an error.
    pub fn remove(&self, name: &str) -> Result<(), StoreError> {
        self.backend.remove_file(&self.backend.object_path(name))
    }

    /// When an object was last written; `None` if it does not exist.
    pub fn written_at(&self, name: &str) -> Result<Option<Timestamp>, StoreError> {
        self.file_written_at(&self.backend.object_path(name))
    }

    fn file_written_at(&self, path: &str) -> Result<Option<Timestamp>, StoreError> {
        Ok(self.backend.metadata(path)?.map(|(_, written_at)| written_at))
    }

    /// Stores the file of a library under its name, shared by all processes.
    pub fn put_library(&self, id: &str, bytes: Bytes) -> Result<(), StoreError> {
        self.backend.put_file(&library_path(id), bytes)
    }

    /// Reads the shared file of a library; `None` if it does not exist.
    pub fn library(&self, id: &str) -> Result<Option<Bytes>, StoreError> {
        self.backend.file(&library_path(id))
    }

    /// Stores a piece of an upload and returns its name, which is the hash of its bytes; durable once this
    /// returns.
    pub fn put_piece(&self, upload: &str, bytes: Bytes) -> Result<String, StoreError> {
        let name = Self::name(&bytes);
        self.backend.put_file(&piece_path(upload, &name), bytes)?;
        Ok(name)
    }

    /// Reads a piece of an upload and checks its bytes against its name.
    pub fn piece(&self, upload: &str, name: &str) -> Result<Bytes, StoreError> {
        let bytes = self.backend.file(&piece_path(upload, name))?;
        whole(name, bytes.ok_or_else(|| StoreError::ObjectMissing(name.to_owned()))?)
    }

    /// Removes all pieces of an upload.
    pub fn remove_pieces(&self, upload: &str) -> Result<(), StoreError> {
        self.backend.remove_pieces(upload)
    }

    /// Lists the uploads that have pieces.
    pub fn uploads(&self) -> Result<Vec<String>, StoreError> {
        self.backend.uploads()
    }

    /// The first bytes of the names of existing objects and metadata files, in order; in a bucket all bytes.
    pub fn shards(&self) -> Result<Vec<u8>, StoreError> {
        self.backend.shards()
    }

    /// Lists the objects whose names start with this byte.
    pub fn list(&self, shard: u8) -> Result<Vec<ListedObject>, StoreError> {
        self.backend.list(shard)
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

    #[test]
    fn an_object_is_checked_and_read_in_pieces() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path()).unwrap();
        let bytes: Bytes = (0..PIECE_BYTES + 10).map(|n| (n % 251) as u8).collect::<Vec<_>>().into();
        let name = Objects::name(&bytes);
        objects.put_all(&[(name.clone(), bytes.clone())], &[]).unwrap();
        let size = objects.check(&name).unwrap();
        assert_eq!(size, bytes.len() as u64);
        assert_eq!(objects.object_piece(&name, size, 0).unwrap(), bytes[..PIECE_BYTES]);
        assert_eq!(objects.object_piece(&name, size, PIECE_BYTES as u64).unwrap(), bytes[PIECE_BYTES..]);
        std::fs::write(folder.path().join(&name[..2]).join(&name), b"other").unwrap();
        assert!(matches!(objects.check(&name), Err(StoreError::ObjectDamaged { .. })));
        assert!(matches!(objects.check(&Objects::name(b"")), Err(StoreError::ObjectMissing(_))));
    }
}
