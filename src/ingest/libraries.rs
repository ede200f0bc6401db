//! The library of each asset: built once in the background, waited for by the first record that needs it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use sha2::{Digest, Sha256};
use tokio::sync::watch;

use super::IngestError;
use crate::asset::AssetSpec;
use crate::estimate::{EstimatorSettings, Tracker};
use crate::library::{GridSettings, Library, LibraryShelf, library_id};
use crate::signal::PREPROCESSING;

/// How far an asset's library is.
#[derive(Debug, Clone)]
pub enum Readiness {
    /// The asset describes no gear pair.
    None,
    /// Being simulated or loaded.
    Building {
        /// States that are done.
        done: usize,
        /// States in all; 0 before the first one is done.
        total: usize,
    },
    /// There.
    Ready(Arc<Library>),
    /// Not to be had.
    Failed(String),
}

impl Readiness {
    /// `none`, `building`, `ready` or `failed`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Building { .. } => "building",
            Self::Ready(_) => "ready",
            Self::Failed(_) => "failed",
        }
    }
}

/// A tracker and what identifies everything that it depends on.
#[derive(Debug, Clone)]
pub(super) struct KeyedTracker {
    pub(super) tracker: Arc<Tracker>,
    /// A fold under another key has to begin again.
    pub(super) fold_key: String,
}

/// The libraries in use.
#[derive(Debug)]
pub struct Libraries {
    shelf: Arc<LibraryShelf>,
    grid: GridSettings,
    wait: Duration,
    /// By library id.
    asked: Mutex<HashMap<String, watch::Receiver<Readiness>>>,
    trackers: Mutex<HashMap<String, Arc<Tracker>>>,
    /// One build at a time: each one uses every core by itself.
    building: Arc<Mutex<()>>,
}

impl Libraries {
    pub(super) fn new(shelf: Arc<LibraryShelf>, grid: GridSettings, wait: Duration) -> Self {
        Self {
            shelf,
            grid,
            wait,
            asked: Mutex::default(),
            trackers: Mutex::default(),
            building: Arc::default(),
        }
    }

    /// The folder of all libraries. Its methods block on the disk.
    pub fn shelf(&self) -> Arc<LibraryShelf> {
        Arc::clone(&self.shelf)
    }

    /// The identifier of an asset's library, and how far it is; starts it where nobody has asked for it yet.
    pub fn readiness(&self, spec: &AssetSpec) -> (Option<String>, Readiness) {
        match self.ask(spec, false) {
            Some((id, progress)) => (Some(id), progress.borrow().clone()),
            None => (None, Readiness::None),
        }
    }

    /// Starts an asset's library in the background; one that failed is tried again.
    pub fn prepare(&self, spec: &AssetSpec) {
        self.ask(spec, true);
    }

    fn ask(&self, spec: &AssetSpec, again: bool) -> Option<(String, watch::Receiver<Readiness>)> {
        let pair = spec.gear.pair.clone()?;
        let id = library_id(&pair, &self.grid);
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(progress) = asked.get(&id)
            && !(again && matches!(*progress.borrow(), Readiness::Failed(_)))
        {
            return Some((id, progress.clone()));
        }
        let (sender, receiver) = watch::channel(Readiness::Building { done: 0, total: 0 });
        asked.insert(id.clone(), receiver.clone());
        let (shelf, grid, building) = (Arc::clone(&self.shelf), self.grid, Arc::clone(&self.building));
        let built_id = id.clone();
        // A thread of its own, not one of the runtime's: a build may take a minute and must not hold up the end of the process.
        let build = move || {
            let _turn = building.lock().unwrap_or_else(PoisonError::into_inner);
            tracing::info!(library = %built_id, "library asked for");
            let built = shelf.get_or_build(&pair, &grid, &|done, total| {
                sender.send_replace(Readiness::Building { done, total });
            });
            sender.send_replace(match built {
                Ok(library) => {
                    tracing::info!(library = %built_id, "library ready");
                    Readiness::Ready(library)
                }
                Err(error) => {
                    tracing::error!(library = %built_id, %error, "library failed");
                    Readiness::Failed(error.to_string())
                }
            });
        };
        if let Err(error) = std::thread::Builder::new().name("library".into()).spawn(build) {
            tracing::error!(%error, "no thread for a library");
        }
        Some((id, receiver))
    }

    /// The tracker of an asset, once its library is there.
    pub(super) async fn tracker(&self, spec: &AssetSpec) -> Result<KeyedTracker, IngestError> {
        let library = match self.ask(spec, false) {
            Some((id, progress)) => Some(self.wait_for(spec, id, progress).await?),
            None => None,
        };
        let fold_key = fold_key(spec, library.as_deref());
        let mut trackers = self.trackers.lock().unwrap_or_else(PoisonError::into_inner);
        let tracker = trackers.entry(fold_key.clone()).or_insert_with(|| {
            let settings = EstimatorSettings {
                baseline_records: spec.baseline.records,
            };
            Arc::new(Tracker::new(settings, library))
        });
        Ok(KeyedTracker {
            tracker: Arc::clone(tracker),
            fold_key,
        })
    }

    async fn wait_for(&self, spec: &AssetSpec, id: String, mut progress: watch::Receiver<Readiness>) -> Result<Arc<Library>, IngestError> {
        let failed = |reason: String| IngestError::Library {
            id: id.clone(),
            asset: spec.id.to_string(),
            reason,
        };
        let over = progress.wait_for(|readiness| !matches!(readiness, Readiness::Building { .. }));
        match tokio::time::timeout(self.wait, over).await {
            Err(_) => Err(IngestError::Busy {
                what: "the asset's library is being simulated",
                retry_after_s: 5,
            }),
            Ok(Err(_)) => Err(failed("its building stopped".into())),
            Ok(Ok(readiness)) => match &*readiness {
                Readiness::Ready(library) => Ok(Arc::clone(library)),
                Readiness::Failed(reason) => Err(failed(reason.clone())),
                Readiness::None | Readiness::Building { .. } => Err(failed("it is not there".into())),
            },
        }
    }
}

/// Hash of everything but the features that a channel's estimates depend on.
fn fold_key(spec: &AssetSpec, library: Option<&Library>) -> String {
    let mut hash = Sha256::new();
    for part in [
        env!("CARGO_PKG_VERSION"),
        PREPROCESSING,
        library.map_or("", Library::id),
        &spec.baseline.records.to_string(),
    ] {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    hash.finalize().iter().take(16).map(|byte| format!("{byte:02x}")).collect()
}
