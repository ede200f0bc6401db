//! Where streams are stored: in folders of this process, or in rows that other processes read and write too.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use jiff::Timestamp;
use tokio::runtime::Handle;

use super::state::StreamState;
use crate::asset::AssetId;
use crate::service::clock::Clock;
use crate::service::error::ServiceError;
use crate::store::{Disk, Store};

/// Maximum number of streams of one asset.
const MAX_OF_ASSET: usize = 16;

/// Where the streams of a service are.
#[derive(Debug, Clone)]
pub(super) enum StreamStorage {
    /// In a folder, each in `asset/name`.
    Folder { disk: Arc<dyn Disk>, folder: PathBuf },
    /// In rows of a shared store.
    Shared(Arc<SharedRows>),
}

/// Where one stream is.
#[derive(Debug, Clone)]
pub(crate) enum StreamLocation {
    /// Files in a folder.
    Folder { disk: Arc<dyn Disk>, folder: PathBuf },
    /// Rows of a shared store.
    Shared { rows: Arc<SharedRows>, asset: AssetId, name: String },
}

/// The rows of streams in a shared store, as one process uses them. The methods of streams block.
pub(crate) struct SharedRows {
    pub(super) store: Store,
    pub(super) runtime: Handle,
    pub(super) clock: Arc<dyn Clock>,
    /// A random number of this process.
    pub(super) process: i64,
}

impl std::fmt::Debug for SharedRows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SharedRows").field("process", &self.process).finish_non_exhaustive()
    }
}

impl SharedRows {
    pub(super) fn new(store: Store, clock: Arc<dyn Clock>) -> Self {
        let process = random();
        Self { store, runtime: Handle::current(), clock, process }
    }
}

/// A random positive number.
pub(super) fn random() -> i64 {
    // Without a source of random numbers, two processes would have to start within the same nanosecond.
    let number = getrandom::u64().unwrap_or_else(|_| Timestamp::now().as_nanosecond() as u64);
    (number >> 1) as i64
}

impl StreamStorage {
    /// The location of a stream.
    pub(super) fn of(&self, asset: &AssetId, name: &str) -> StreamLocation {
        match self {
            Self::Folder { disk, folder } => StreamLocation::Folder {
                disk: Arc::clone(disk),
                folder: folder.join(asset.as_str()).join(name),
            },
            Self::Shared(rows) => {
                StreamLocation::Shared { rows: Arc::clone(rows), asset: asset.clone(), name: name.to_owned() }
            }
        }
    }

    /// The rows, if other processes use the streams too.
    pub(super) fn shared(&self) -> Option<&Arc<SharedRows>> {
        match self {
            Self::Folder { .. } => None,
            Self::Shared(rows) => Some(rows),
        }
    }
}

impl StreamLocation {
    #[cfg(test)]
    pub(crate) fn in_folder(folder: &Path) -> Self {
        Self::Folder { disk: Arc::new(crate::store::SystemDisk), folder: folder.to_path_buf() }
    }

    /// Whether other processes use the stream too.
    pub(super) fn is_shared(&self) -> bool {
        matches!(self, Self::Shared { .. })
    }

    /// Whether there is a stream; true if that is not known.
    pub(super) fn exists(&self) -> bool {
        match self {
            Self::Folder { folder, .. } => folder.exists(),
            Self::Shared { .. } => true,
        }
    }

    /// Whether the stream exists, or the asset may have one more. The rows of a shared store are counted when
    /// the stream is created.
    pub(super) fn has_room(&self) -> bool {
        let Self::Folder { folder, .. } = self else { return true };
        let others = folder.parent().and_then(|asset| std::fs::read_dir(asset).ok());
        folder.exists() || others.map_or(0, Iterator::count) < MAX_OF_ASSET
    }

    /// Removes the stream. Rows are removed with their asset.
    pub(super) fn remove(&self) -> Result<(), ServiceError> {
        let Self::Folder { disk, folder } = self else { return Ok(()) };
        match disk.remove_folder(folder) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(ServiceError::File { action: "remove", path: folder.clone(), source: error })
            }
            _ => Ok(()),
        }
    }
}

impl SharedRows {
    /// Creates a stream, unless another process has.
    pub(super) fn create(
        &self,
        asset: &AssetId,
        name: &str,
        state: &StreamState,
    ) -> Result<(), ServiceError> {
        let (created_at, checkpoint) = (state.asset_created_at, state.checkpoint());
        let created = self.store.create_stream(asset, created_at, name, &checkpoint, MAX_OF_ASSET);
        if self.runtime.block_on(created)? { Ok(()) } else { Err(too_many(name)) }
    }
}

/// The asset has as many streams as it may have.
pub(super) fn too_many(name: &str) -> ServiceError {
    let expected = format!("one of the asset's existing streams, which are at the maximum of {MAX_OF_ASSET}");
    ServiceError::Field { field: "name", value: name.to_owned(), expected: expected.into() }
}

/// The assets and names of the streams in a folder.
pub(super) fn streams_in(folder: &Path) -> Vec<(AssetId, String)> {
    let names = |folder: &Path| -> Vec<String> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().into_string().ok()).collect()
    };
    let assets = names(folder).into_iter().filter_map(|asset| AssetId::new(asset).ok());
    assets
        .flat_map(|asset| {
            let streams = names(&folder.join(asset.as_str())).into_iter();
            streams
                .filter(|name| check_name(name).is_ok())
                .map(move |name| (asset.clone(), name))
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Checks a stream name, which is part of a path.
pub(super) fn check_name(name: &str) -> Result<(), ServiceError> {
    AssetId::new(name).map(|_| ()).map_err(|_| ServiceError::Field {
        field: "name",
        value: format!("{:?}", name.chars().take(64).collect::<String>()),
        expected: "1 to 64 characters of a-z, 0-9, - and _, starting with a letter or digit".into(),
    })
}
