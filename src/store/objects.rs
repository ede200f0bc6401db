//! Raw recordings as immutable objects named by the hash of their bytes, in a folder or in a bucket; and
//! libraries that processes share.

#[cfg(feature = "cluster")]
mod bucket;
mod folder;

use std::path::PathBuf;

use bytes::Bytes;
use jiff::Timestamp;
use ring::digest::{SHA256, digest};

use super::StoreError;

pub(super) use folder::file_error;

/// Immutable objects named by the SHA-256 of their bytes.
///
/// Every method blocks on the disk or the network: call from a worker thread, not from an async one.
#[derive(Debug)]
pub struct Objects {
    backend: Backend,
}

#[derive(Debug)]
enum Backend {
    Folder(folder::Folder),
    #[cfg(feature = "cluster")]
    Bucket(bucket::Bucket),
}

/// An object as it is listed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedObject {
    /// Its name.
    pub name: String,
    /// Its size in bytes.
    pub bytes: u64,
    /// When it was last written, by the clock of where it is kept.
    pub written_at: Timestamp,
}

impl Objects {
    /// Opens a folder, making it where it is missing and clearing what an interrupted write left behind.
    pub fn open(folder: impl Into<PathBuf>) -> Result<Self, StoreError> {
        Ok(Self {
            backend: Backend::Folder(folder::Folder::open(folder.into())?),
        })
    }

    /// Opens a folder that other processes write to as well.
    #[cfg(feature = "cluster")]
    pub(super) fn open_shared_folder(folder: PathBuf) -> Result<Self, StoreError> {
        Ok(Self {
            backend: Backend::Folder(folder::Folder::open_shared(folder)?),
        })
    }

    /// Opens a bucket. To be called inside the runtime, which then does the requests.
    #[cfg(feature = "cluster")]
    pub(super) fn open_bucket(settings: &super::BucketSettings) -> Result<Self, StoreError> {
        Ok(Self {
            backend: Backend::Bucket(bucket::Bucket::open(settings)?),
        })
    }

    /// The name that bytes are stored under: their SHA-256 in lower-case hexadecimal.
    pub fn name(bytes: &[u8]) -> String {
        // Every record is hashed: on a processor without instructions for it this is twice as fast as what
        // hashes keys elsewhere.
        hex::encode(digest(&SHA256, bytes).as_ref())
    }

    /// Stores every object under the name that [`name`](Self::name) gives its bytes; when this returns they
    /// are durable, and so are their names.
    pub fn put_all(&self, objects: &[(String, Bytes)]) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.put_all(objects),
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.put_all(objects),
        }
    }

    /// The bytes of an object, checked against its name.
    pub fn get(&self, name: &str) -> Result<Bytes, StoreError> {
        let bytes = match &self.backend {
            Backend::Folder(folder) => folder.get(name)?,
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.get(name)?,
        };
        whole(name, bytes)
    }

    /// Removes an object; one that is not there is no error.
    pub fn remove(&self, name: &str) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.remove(name),
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.remove(name),
        }
    }

    /// When an object was last written; none where it is not there.
    pub fn written_at(&self, name: &str) -> Result<Option<Timestamp>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.written_at(name),
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.written_at(name),
        }
    }

    /// Keeps the file of a library under the library's name, for every process.
    pub fn put_library(&self, id: &str, bytes: Bytes) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.put_library(id, &bytes),
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.put_library(id, bytes),
        }
    }

    /// The file of a library that a process keeps under its name; none where there is none.
    pub fn library(&self, id: &str) -> Result<Option<Bytes>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.library(id),
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.library(id),
        }
    }

    /// Keeps a piece of an upload and returns its name, which is the hash of its bytes; when this returns it
    /// is durable.
    pub fn put_piece(&self, upload: &str, bytes: Bytes) -> Result<String, StoreError> {
        let name = Self::name(&bytes);
        match &self.backend {
            Backend::Folder(folder) => folder.put_piece(upload, &name, &bytes)?,
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.put_piece(upload, &name, bytes)?,
        }
        Ok(name)
    }

    /// A piece of an upload, checked against its name.
    pub fn piece(&self, upload: &str, name: &str) -> Result<Bytes, StoreError> {
        let bytes = match &self.backend {
            Backend::Folder(folder) => folder.piece(upload, name)?,
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.piece(upload, name)?,
        };
        whole(name, bytes)
    }

    /// Removes everything that is kept of an upload.
    pub fn remove_pieces(&self, upload: &str) -> Result<(), StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.remove_pieces(upload),
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.remove_pieces(upload),
        }
    }

    /// The uploads of which there are pieces.
    pub fn uploads(&self) -> Result<Vec<String>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.uploads(),
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.uploads(),
        }
    }

    /// The objects whose names begin with this byte.
    pub fn list(&self, shard: u8) -> Result<Vec<ListedObject>, StoreError> {
        match &self.backend {
            Backend::Folder(folder) => folder.list(shard),
            #[cfg(feature = "cluster")]
            Backend::Bucket(bucket) => bucket.list(shard),
        }
    }
}

/// Bytes that are what their name says.
fn whole(name: &str, bytes: Bytes) -> Result<Bytes, StoreError> {
    let found = Objects::name(&bytes);
    if found == name {
        Ok(bytes)
    } else {
        Err(StoreError::ObjectDamaged {
            expected: name.to_string(),
            found,
        })
    }
}

/// Whether a text can be the name of an object.
fn is_name(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_is_named_by_its_sha256() {
        // FIPS 180-2, appendix B.1
        assert_eq!(
            Objects::name(b"abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }
}
