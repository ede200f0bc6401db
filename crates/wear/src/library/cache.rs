//! A cache of libraries in a folder, each under the hash of its inputs.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::checkpoint::Checkpoint;
use super::{
    BuildControl, Ensemble, EnsembleSettings, GridSettings, Library, LibraryError, Manifest, build, decode,
    decode_ensemble, encode, encode_ensemble, ensemble_id, library_id,
};
use flankwatch_gear::PairSpec;

/// Extension of library files.
const EXTENSION: &str = "fwlib";

/// A cache of libraries and ensembles in a folder.
#[derive(Debug, Clone)]
pub struct LibraryCache {
    folder: PathBuf,
}

impl LibraryCache {
    /// Creates a cache in a folder, which is created with the first library.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the library of these inputs, from the cache or else built and added to it.
    ///
    /// A damaged file, or one of other inputs under this id, is logged and replaced. A build that was stopped
    /// is resumed from its checkpoint.
    pub fn get_or_build(
        &self,
        pair: &PairSpec,
        grid: &GridSettings,
        control: &BuildControl<'_>,
    ) -> Result<Arc<Library>, LibraryError> {
        let id = library_id(pair, grid);
        match self.get(&id) {
            Ok(Some(library)) if library.pair() == pair && library.manifest().grid == *grid => {
                return Ok(library);
            }
            Ok(Some(_)) => {
                tracing::warn!(library = %id, "the cached library has other inputs; rebuilding it")
            }
            Ok(None) => {}
            Err(error @ (LibraryError::Damaged(_) | LibraryError::Version { .. })) => {
                tracing::warn!(library = %id, %error, "failed to read the cached library; rebuilding it");
            }
            Err(error) => return Err(error),
        }
        build_into(&self.path(&id), pair, grid, control).map(Arc::new)
    }

    /// Returns the ensemble around a library if it is cached. A damaged file is logged and ignored.
    ///
    /// # Errors
    /// [`LibraryError::Io`].
    pub fn get_ensemble(
        &self,
        library: &Arc<Library>,
        settings: &EnsembleSettings,
    ) -> Result<Option<Ensemble>, LibraryError> {
        let id = ensemble_id(library.id(), settings);
        let path = self.ensemble_path(&id);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(LibraryError::Io { path, source }),
        };
        match decode_ensemble(&bytes, Arc::clone(library)) {
            Ok(ensemble) if ensemble.id() == id => Ok(Some(ensemble)),
            Ok(_) => Ok(None),
            Err(error) => {
                tracing::warn!(ensemble = %id, %error, "failed to read the cached ensemble; simulating it again");
                Ok(None)
            }
        }
    }

    /// Adds an ensemble to the cache.
    ///
    /// # Errors
    /// [`LibraryError::Io`].
    pub fn put_ensemble(&self, ensemble: &Ensemble) -> Result<(), LibraryError> {
        write_atomically(&self.ensemble_path(ensemble.id()), &encode_ensemble(ensemble))
    }

    /// Whether there is a file of a library, which may be damaged.
    pub fn has(&self, id: &str) -> bool {
        self.path(id).is_file()
    }

    /// Whether there is a file of an ensemble, which may be damaged.
    pub fn has_ensemble(&self, id: &str) -> bool {
        self.ensemble_path(id).is_file()
    }

    fn ensemble_path(&self, id: &str) -> PathBuf {
        self.folder.join("ensembles").join(id).with_extension("fwens")
    }

    /// Adds a library to the cache.
    pub fn put(&self, library: &Library) -> Result<(), LibraryError> {
        save_library(&self.path(library.id()), library)
    }

    /// Returns the library with this id if it is cached.
    pub fn get(&self, id: &str) -> Result<Option<Arc<Library>>, LibraryError> {
        if !id.bytes().all(|b| b.is_ascii_alphanumeric()) {
            return Ok(None);
        }
        let path = self.path(id);
        match fs::read(&path) {
            Ok(bytes) => {
                let library = decode(&bytes)?;
                if library.id() != id {
                    return Err(LibraryError::Damaged(format!(
                        "its id is {:?}, expected {id:?}",
                        library.id()
                    )));
                }
                Ok(Some(Arc::new(library)))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(LibraryError::Io { path, source }),
        }
    }

    /// Lists the cached libraries by id; files that cannot be read are logged and skipped.
    pub fn list(&self) -> Result<Vec<Manifest>, LibraryError> {
        let entries = match fs::read_dir(&self.folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(source) => {
                return Err(LibraryError::Io { path: self.folder.clone(), source });
            }
        };
        let mut manifests = Vec::new();
        for entry in entries {
            let path = entry.map_err(|source| LibraryError::Io { path: self.folder.clone(), source })?.path();
            let Some(id) = path
                .file_stem()
                .and_then(|stem| stem.to_str())
                .filter(|_| path.extension().is_some_and(|e| e == EXTENSION))
            else {
                continue;
            };
            match self.get(id) {
                Ok(library) => manifests.extend(library.map(|library| library.manifest().clone())),
                Err(error) => tracing::warn!(file = %path.display(), %error, "skipped unreadable library"),
            }
        }
        manifests.sort_by(|a, b| a.id.cmp(&b.id));
        Ok(manifests)
    }

    fn path(&self, id: &str) -> PathBuf {
        self.folder.join(id).with_extension(EXTENSION)
    }
}

/// Builds a library into a file. A build that is stopped leaves a checkpoint beside the file, from which the
/// next one resumes.
///
/// # Errors
/// Those of [`build`] and [`save_library`].
pub fn build_into(
    path: &Path,
    pair: &PairSpec,
    grid: &GridSettings,
    control: &BuildControl<'_>,
) -> Result<Library, LibraryError> {
    let checkpoint = Checkpoint::for_library(path);
    let library = build(pair, grid, &control.resumed_from(&checkpoint))?;
    save_library(path, &library)?;
    checkpoint.remove()?;
    Ok(library)
}

/// Writes a library to a file atomically.
pub fn save_library(path: &Path, library: &Library) -> Result<(), LibraryError> {
    write_atomically(path, &encode(library))
}

fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), LibraryError> {
    // Two threads may write the same library: an obsolete build may end at the same time as its successor.
    static WRITERS: AtomicU64 = AtomicU64::new(0);
    let writer = WRITERS.fetch_add(1, Ordering::Relaxed);
    let failed = |source| LibraryError::Io { path: path.to_owned(), source };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(failed)?;
    let temporary = path.with_extension(format!("{}.{writer}.part", std::process::id()));
    let mut file = File::create(&temporary).map_err(failed)?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all());
    written.and_then(|()| fs::rename(&temporary, path)).map_err(|source| {
        // The error is why writing failed, whether or not the rest can be removed.
        let _ = fs::remove_file(&temporary);
        failed(source)
    })?;
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::super::testing::synthetic_library;
    use super::*;

    #[test]
    fn a_failed_write_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("library.fwlib");
        fs::create_dir(&path).unwrap();
        assert!(save_library(&path, &synthetic_library()).is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn concurrent_writers_of_the_same_library_do_not_conflict() {
        let folder = tempfile::tempdir().unwrap();
        let (cache, library) = (LibraryCache::new(folder.path()), synthetic_library());
        thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| (0..10).for_each(|_| cache.put(&library).unwrap()));
            }
        });
        assert_eq!(*cache.get(library.id()).unwrap().unwrap(), library);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
