//! The sources of libraries: the folder of this process, else, on a shared store, the process that built it,
//! else a build.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::runtime::Handle;

use super::failures::Failures;
use crate::gear::PairSpec;
use crate::library::{
    BuildControl, Ensemble, EnsembleSettings, GridSettings, Library, LibraryCache, LibraryError, decode,
    decode_ensemble, encode, encode_ensemble, ensemble_id, library_id,
};
use crate::service::clock::Clock;
use crate::store::{Store, StoreError};

/// Interval at which a library that another process builds, or an unavailable store, is checked again.
const RETRY_INTERVAL: Duration = Duration::from_secs(2);

/// Interval at which a process renews its right to build a library.
const RENEWAL_INTERVAL: Duration = Duration::from_secs(15);

/// Libraries by the hash of their inputs. Every method blocks: to be called on a separate thread, not on one
/// of the runtime.
#[derive(Clone)]
pub(crate) struct LibrarySource {
    cache: Arc<LibraryCache>,
    shared: Option<Shared>,
}

/// The store through which processes share libraries.
#[derive(Clone)]
struct Shared {
    store: Store,
    clock: Arc<dyn Clock>,
    runtime: Handle,
    /// Whether this process builds libraries; otherwise it waits until another one has.
    builds: bool,
}

impl LibrarySource {
    /// The libraries in a folder, and in the store if it is shared; unless `builds`, other processes build
    /// them there. Must be called inside a Tokio runtime.
    pub(crate) fn new(cache: Arc<LibraryCache>, store: &Store, clock: &Arc<dyn Clock>, builds: bool) -> Self {
        let shared = store.is_shared().then(|| Shared {
            store: store.clone(),
            clock: Arc::clone(clock),
            runtime: Handle::current(),
            builds,
        });
        Self { cache, shared }
    }

    /// The libraries in a folder that no other process uses.
    #[cfg(test)]
    pub(super) fn alone(folder: &std::path::Path) -> Self {
        Self { cache: Arc::new(LibraryCache::new(folder.to_owned())), shared: None }
    }

    /// The folder.
    pub(crate) fn cache(&self) -> &Arc<LibraryCache> {
        &self.cache
    }

    /// Why libraries could not be simulated in this process.
    pub(super) fn failures(&self) -> Failures {
        Failures::new(self.cache.folder().join("failures"))
    }

    /// The cached library of these inputs.
    pub(super) fn cached(&self, pair: &PairSpec, grid: &GridSettings) -> Option<Arc<Library>> {
        kept(&self.cache, pair, grid).or_else(|| {
            let library = self.shared.as_ref()?.fetch(pair, grid).ok()??;
            self.cache.put(&library).ok()?;
            Some(Arc::new(library))
        })
    }

    /// Caches an ensemble for the next start. If that fails, for example on a full disk, the ensemble is used
    /// all the same.
    fn cache_ensemble(&self, ensemble: &Ensemble) {
        if let Err(error) = self.cache.put_ensemble(ensemble) {
            let id = ensemble.id();
            tracing::warn!(ensemble = id, %error, "failed to cache an ensemble; the next start simulates it again");
        }
    }

    /// The library of these inputs; [`LibraryError::Cancelled`] soon after `cancel` becomes true.
    pub(super) fn get_or_build(
        &self,
        pair: &PairSpec,
        grid: &GridSettings,
        progress: &(dyn Fn(usize, usize) + Sync),
        cancel: &AtomicBool,
    ) -> Result<Arc<Library>, LibraryError> {
        // It may have been cancelled while it waited for its turn.
        check(cancel)?;
        match &self.shared {
            Some(shared) => shared.get_or_build(&self.cache, pair, grid, progress, cancel),
            None => {
                let control = BuildControl::with_progress(progress).cancelled_by(cancel);
                self.cache.get_or_build(pair, grid, &control)
            }
        }
    }

    /// The cached ensemble with these settings around a library.
    pub(super) fn cached_ensemble(
        &self,
        library: &Arc<Library>,
        settings: &EnsembleSettings,
    ) -> Option<Ensemble> {
        match self.cache.get_ensemble(library, settings) {
            Ok(None) => {}
            Ok(kept) => return kept,
            Err(error) => {
                tracing::warn!(library = library.id(), %error, "failed to read a cached ensemble; simulating it again");
            }
        }
        let id = ensemble_id(library.id(), settings);
        if let Some(shared) = &self.shared
            && let Ok(Some(bytes)) = shared.store.objects().library(&id)
            && let Ok(ensemble) = decode_ensemble(&bytes, Arc::clone(library))
            && ensemble.id() == id
        {
            self.cache_ensemble(&ensemble);
            return Some(ensemble);
        }
        None
    }

    /// The ensemble with these settings around the library of a smaller one: from the cache, else simulated
    /// as an extension of the smaller one.
    pub(super) fn ensemble(
        &self,
        smaller: &Ensemble,
        settings: &EnsembleSettings,
        control: &BuildControl<'_>,
    ) -> Result<Ensemble, LibraryError> {
        if let Some(kept) = self.cached_ensemble(smaller.described(), settings) {
            return Ok(kept);
        }
        let ensemble = smaller.extended(settings, control)?;
        self.cache_ensemble(&ensemble);
        if let Some(shared) = &self.shared
            && let Err(error) =
                shared.store.objects().put_library(ensemble.id(), encode_ensemble(&ensemble).into())
        {
            // Another process then simulates the same ensemble, bit for bit.
            tracing::warn!(ensemble = ensemble.id(), %error, "failed to share an ensemble");
        }
        Ok(ensemble)
    }
}

fn has_inputs(library: &Library, pair: &PairSpec, grid: &GridSettings) -> bool {
    library.pair() == pair && library.manifest().grid == *grid
}

/// The library of these inputs in the folder of this process.
fn kept(cache: &LibraryCache, pair: &PairSpec, grid: &GridSettings) -> Option<Arc<Library>> {
    cache.get(&library_id(pair, grid)).ok().flatten().filter(|library| has_inputs(library, pair, grid))
}

/// Returns an error if the build is cancelled.
fn check(cancel: &AtomicBool) -> Result<(), LibraryError> {
    if cancel.load(Ordering::Relaxed) {
        return Err(LibraryError::Cancelled);
    }
    Ok(())
}

impl Shared {
    fn get_or_build(
        &self,
        cache: &LibraryCache,
        pair: &PairSpec,
        grid: &GridSettings,
        progress: &(dyn Fn(usize, usize) + Sync),
        cancel: &AtomicBool,
    ) -> Result<Arc<Library>, LibraryError> {
        if let Some(library) = kept(cache, pair, grid) {
            return Ok(library);
        }
        let id = library_id(pair, grid);
        loop {
            check(cancel)?;
            match self.fetch(pair, grid) {
                Ok(Some(library)) => {
                    cache.put(&library)?;
                    return Ok(Arc::new(library));
                }
                Ok(None) => match self.begin(&id) {
                    Ok(true) => break,
                    // Another process builds it.
                    Ok(false) => std::thread::sleep(RETRY_INTERVAL),
                    Err(error) => self.wait_for_store(&error),
                },
                Err(error) => self.wait_for_store(&error),
            }
        }
        let renewed_at = Mutex::new(Instant::now());
        let progress = |done, total| {
            progress(done, total);
            let mut renewed_at = renewed_at.lock().unwrap_or_else(PoisonError::into_inner);
            if renewed_at.elapsed() >= RENEWAL_INTERVAL {
                *renewed_at = Instant::now();
                // If this fails, another process may build the same library, bit for bit.
                if let Err(error) = self.runtime.block_on(self.store.renew_building(&id, self.clock.now())) {
                    tracing::warn!(%error, "failed to renew the right to build a library");
                }
            }
        };
        let built =
            cache.get_or_build(pair, grid, &BuildControl::with_progress(&progress).cancelled_by(cancel));
        if built.is_err()
            && let Err(error) = self.runtime.block_on(self.store.end_building(&id))
        {
            tracing::warn!(%error, "failed to release the right to build a library; it expires after a minute");
        }
        let library = built?;
        let bytes = encode(&library);
        while let Err(error) = self.store.objects().put_library(&id, bytes.clone().into()) {
            check(cancel)?;
            self.wait_for_store(&error);
        }
        Ok(library)
    }

    /// The library as another process built it; `None` if there is none, or if it cannot be used.
    fn fetch(&self, pair: &PairSpec, grid: &GridSettings) -> Result<Option<Library>, StoreError> {
        let id = library_id(pair, grid);
        let Some(bytes) = self.store.objects().library(&id)? else {
            return Ok(None);
        };
        match decode(&bytes) {
            Ok(library) if library.id() == id && has_inputs(&library, pair, grid) => Ok(Some(library)),
            Ok(_) => Ok(None),
            Err(error) => {
                tracing::warn!(library = id, %error, "failed to decode a shared library; building it again");
                Ok(None)
            }
        }
    }

    fn begin(&self, id: &str) -> Result<bool, StoreError> {
        if !self.builds {
            return Ok(false);
        }
        self.runtime.block_on(self.store.begin_building(id, self.clock.now()))
    }

    fn wait_for_store(&self, error: &StoreError) {
        tracing::warn!(%error, "failed to access the store for a library; retrying");
        std::thread::sleep(RETRY_INTERVAL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ensemble_that_cannot_be_cached_is_used() {
        let folder = tempfile::tempdir().unwrap();
        // A file takes the place of its folder.
        std::fs::write(folder.path().join("ensembles"), "").unwrap();
        let source = LibrarySource::alone(folder.path());
        let pair = PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml")).unwrap();
        let grid = GridSettings { states: 3, seconds: 0.3, ..GridSettings::default() };
        let library = source.get_or_build(&pair, &grid, &|_, _| {}, &AtomicBool::new(false)).unwrap();
        let settings = EnsembleSettings { members: 4 };
        let control = BuildControl::silent();
        let ensemble = source.ensemble(&Ensemble::of(library), &settings, &control).unwrap();
        assert_eq!(ensemble.members().len(), 4);
        assert!(source.cached_ensemble(ensemble.described(), &settings).is_none());
    }
}
