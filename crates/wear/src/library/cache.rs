//! The folder where libraries are kept, each under the hash of its inputs.

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

/// Ending of library files.
const EXTENSION: &str = "fwlib";

/// A folder of libraries.
#[derive(Debug, Clone)]
pub struct LibraryCache {
    folder: PathBuf,
}

impl LibraryCache {
    /// A cache in a folder, which is made when the first library is kept.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The library of these inputs: loaded where it is kept and whole, else built and kept.
    ///
    /// A damaged file, or one of other inputs under this name, is reported, never used, and replaced. Parts
    /// that a stopped build has left beside it are taken up.
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
                tracing::warn!(library = %id, "the kept library was made from other inputs; building it again")
            }
            Ok(None) => {}
            Err(error @ (LibraryError::Damaged(_) | LibraryError::Version { .. })) => {
                tracing::warn!(library = %id, %error, "the kept library cannot be used; building it again");
            }
            Err(error) => return Err(error),
        }
        build_into(&self.path(&id), pair, grid, control).map(Arc::new)
    }

    /// The ensemble around a library: loaded where it is kept and whole, else simulated and kept.
    ///
    /// # Errors
    /// Those of [`Ensemble::build`]; [`LibraryError::Io`] where it cannot be kept.
    pub fn ensemble(
        &self,
        library: Arc<Library>,
        settings: &EnsembleSettings,
        control: &BuildControl<'_>,
    ) -> Result<Ensemble, LibraryError> {
        if let Some(kept) = self.get_ensemble(&library, settings)? {
            return Ok(kept);
        }
        let ensemble = Ensemble::build(library, settings, control)?;
        self.put_ensemble(&ensemble)?;
        Ok(ensemble)
    }

    /// The ensemble around a library, where it is kept; one that is damaged is reported and counts as not
    /// kept.
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
                tracing::warn!(ensemble = %id, %error, "failed to read the kept ensemble; simulating it again");
                Ok(None)
            }
        }
    }

    /// Keeps an ensemble.
    ///
    /// # Errors
    /// [`LibraryError::Io`].
    pub fn put_ensemble(&self, ensemble: &Ensemble) -> Result<(), LibraryError> {
        write_atomically(&self.ensemble_path(ensemble.id()), &encode_ensemble(ensemble))
    }

    fn ensemble_path(&self, id: &str) -> PathBuf {
        self.folder.join("ensembles").join(id).with_extension("fwens")
    }

    /// Keeps a library.
    pub fn put(&self, library: &Library) -> Result<(), LibraryError> {
        save_library(&self.path(library.id()), library)
    }

    /// The library with this name, where it is kept.
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
                        "it says that it is {:?}, expected {id:?}",
                        library.id()
                    )));
                }
                Ok(Some(Arc::new(library)))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(LibraryError::Io { path, source }),
        }
    }

    /// What is on the cache, by name; files that cannot be used are left out and reported.
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
                Err(error) => tracing::warn!(file = %path.display(), %error, "left out"),
            }
        }
        manifests.sort_by(|a, b| a.id.cmp(&b.id));
        Ok(manifests)
    }

    fn path(&self, id: &str) -> PathBuf {
        self.folder.join(id).with_extension(EXTENSION)
    }
}

/// Builds a library into a file; a build that is stopped goes on from the parts that are kept beside the file
/// until then.
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

/// Writes a library to a file so that a reader sees all of it or none.
pub fn save_library(path: &Path, library: &Library) -> Result<(), LibraryError> {
    write_atomically(path, &encode(library))
}

fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), LibraryError> {
    // Two threads may keep the same library: one that nobody needed any more ends beside its successor.
    static WRITERS: AtomicU64 = AtomicU64::new(0);
    let writer = WRITERS.fetch_add(1, Ordering::Relaxed);
    let failed = |source| LibraryError::Io { path: path.to_owned(), source };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(failed)?;
    let temporary = path.with_extension(format!("{}.{writer}.part", std::process::id()));
    let mut file = File::create(&temporary).map_err(failed)?;
    file.write_all(bytes).and_then(|()| file.sync_all()).map_err(failed)?;
    fs::rename(&temporary, path).map_err(failed)?;
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::super::testing::synthetic_library;
    use super::*;

    #[test]
    fn threads_that_keep_the_same_library_do_not_disturb_each_other() {
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
