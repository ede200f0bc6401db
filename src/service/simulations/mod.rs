//! The library of each asset, simulated once in the background. Records do not wait for it: they are folded
//! without it at first, and again once it is ready.

mod cost;
mod estimators;
mod failures;
mod job;
mod simulation_queue;
mod source;
mod status;

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use tokio::sync::{mpsc, watch};

use super::error::ServiceError;
use super::keys::{analysis_keys, fold_key};
use super::limits::WorkLimits;
use crate::asset::{AssetId, AssetSpec};
use crate::estimate::{ChannelEstimator, EstimatorSettings, MissingLibrary};
use crate::library::{Ensemble, EnsembleSettings, GridSettings, LibraryCache, ensemble_id, library_id};
use cost::Cost;
use estimators::Estimators;
pub(crate) use estimators::KeyedEstimator;
use job::{Ensembles, Job, lock};
use simulation_queue::SimulationQueue;
pub(crate) use source::LibrarySource;
pub use status::{Readiness, Simulation, SimulationProgress, SimulationStage};

/// How long a record waits for its library to be loaded from the cache, so that its history continues with
/// the library it was folded with.
const MAX_LOAD_WAIT: Duration = Duration::from_secs(10);

/// A library that assets need.
struct RequestedLibrary {
    simulation: watch::Receiver<Simulation>,
    cancel: Arc<AtomicBool>,
    /// The assets with their descriptions at the time of the request.
    assets: HashMap<AssetId, AssetSpec>,
}

impl RequestedLibrary {
    fn has_failed(&self) -> bool {
        self.simulation.borrow().error.is_some()
    }
}

/// By library id.
type RequestedLibraries = Mutex<HashMap<String, RequestedLibrary>>;

/// The libraries in use.
pub struct Simulations {
    source: LibrarySource,
    /// For module 6 mm; [`GridSettings::for_pair`] gives the settings for a pair.
    grid: GridSettings,
    requested: Arc<RequestedLibraries>,
    estimators: Mutex<Estimators>,
    ensemble_settings: EnsembleSettings,
    ensembles: Arc<Ensembles>,
    /// Receives the assets whose library is ready, has more members, or has failed.
    changed: mpsc::UnboundedSender<Vec<AssetId>>,
    /// One library is loaded at a time.
    loading: Arc<Mutex<()>>,
    queue: Arc<SimulationQueue>,
    cost: Arc<Cost>,
}

impl Simulations {
    /// Creates the simulations; `changed` receives assets whose histories have to be folded again.
    ///
    /// # Errors
    /// The threads cannot be started.
    pub(crate) fn new(
        source: LibrarySource,
        grid: GridSettings,
        limits: &WorkLimits,
        changed: mpsc::UnboundedSender<Vec<AssetId>>,
    ) -> Result<Self, ServiceError> {
        let queue = SimulationQueue::new(limits.simulation_threads)?;
        Ok(Self {
            cost: Arc::new(Cost::new(queue.threads())),
            changed,
            source,
            grid,
            requested: Arc::default(),
            estimators: Mutex::default(),
            ensemble_settings: limits.ensemble,
            ensembles: Arc::default(),
            loading: Arc::default(),
            queue: Arc::new(queue),
        })
    }

    /// The cache of all libraries. Its methods block on the disk.
    pub fn cache(&self) -> Arc<LibraryCache> {
        Arc::clone(self.source.cache())
    }

    /// The identifier and status of an asset's library; starts its simulation if it was not requested before.
    pub fn of(&self, spec: &AssetSpec) -> (Option<String>, Simulation) {
        match self.request(spec) {
            Some((id, simulation)) => (Some(id), simulation.borrow().clone()),
            None => (None, Simulation::none()),
        }
    }

    /// The expected seconds from the start of the simulation of an asset's library until the first estimates,
    /// without what is in the folder of libraries; `None` if the asset describes no pair.
    pub fn estimated_s(&self, spec: &AssetSpec) -> Option<f64> {
        let pair = spec.pair()?;
        let (grid, cache) = (self.grid.for_pair(pair), self.source.cache());
        let id = library_id(pair, &grid);
        let has_members = |settings| cache.has_ensemble(&ensemble_id(&id, &settings));
        let library_s = if cache.has(&id) { 0.0 } else { self.cost.library_s(&grid) };
        let members_s = if has_members(self.ensemble_settings) || has_members(self.ensemble_settings.first())
        {
            0.0
        } else {
            self.cost.first_members_s(self.ensemble_settings)
        };
        Some(library_s + members_s)
    }

    /// Starts the simulation of an asset's library in the background if it was not requested before.
    pub fn start(&self, spec: &AssetSpec) {
        self.request(spec);
    }

    /// Sets the description of an asset and starts to simulate its library in the background. If the
    /// description is new, a library that failed, also before a restart, is tried again. The library of the
    /// previous description is stopped if no other asset needs it.
    pub fn describe(&self, spec: &AssetSpec) {
        let id = self.id_of(spec);
        self.release_except(&spec.id, id.as_deref());
        let Some(id) = id else { return };
        let failed = {
            let mut all = lock(&self.requested);
            // The libraries of all assets are requested at the start, so this is a new description.
            let is_new = all.get(&id).is_none_or(|requested| requested.assets.get(&spec.id) != Some(spec));
            let is_over = all.get(&id).is_none_or(RequestedLibrary::has_failed);
            if is_new && is_over {
                self.source.failures().remove(&id);
                all.remove(&id)
            } else {
                None
            }
        };
        self.request(spec);
        if let Some(requested) = lock(&self.requested).get_mut(&id) {
            requested.assets.extend(failed.into_iter().flat_map(|failed| failed.assets));
            requested.assets.insert(spec.id.clone(), spec.clone());
        }
    }

    /// Forgets a deleted asset: simulations for this asset alone are stopped.
    pub(crate) fn release(&self, asset: &AssetId) {
        self.release_except(asset, None);
        lock(&self.estimators).keep_only(asset, &[]);
    }

    /// Forgets the estimators of an asset's earlier histories; those with these fold keys are served.
    pub(crate) fn keep_estimators(&self, spec: &AssetSpec, served: impl IntoIterator<Item = String>) {
        let current = self.estimator(spec).fold_key;
        let kept: Vec<String> = served.into_iter().chain([current]).collect();
        lock(&self.estimators).keep_only(&spec.id, &kept);
    }

    fn release_except(&self, asset: &AssetId, kept: Option<&str>) {
        lock(&self.requested).retain(|id, requested| {
            if Some(id.as_str()) == kept
                || requested.assets.remove(asset).is_none()
                || !requested.assets.is_empty()
            {
                return true;
            }
            // Before the ensemble is removed, so that the simulation adds none after that.
            requested.cancel.store(true, Ordering::Relaxed);
            lock(&self.ensembles).remove(id);
            false
        });
    }

    fn request(&self, spec: &AssetSpec) -> Option<(String, watch::Receiver<Simulation>)> {
        let pair = spec.pair()?.clone();
        let grid = self.grid.for_pair(&pair);
        let id = library_id(&pair, &grid);
        let mut all = lock(&self.requested);
        if let Some(requested) = all.get_mut(&id) {
            requested.assets.entry(spec.id.clone()).or_insert_with(|| spec.clone());
            return Some((id, requested.simulation.clone()));
        }
        let (sender, receiver) = watch::channel(Simulation::begin());
        let cancel = Arc::<AtomicBool>::default();
        let requested = RequestedLibrary {
            simulation: receiver.clone(),
            cancel: Arc::clone(&cancel),
            assets: HashMap::from([(spec.id.clone(), spec.clone())]),
        };
        all.insert(id.clone(), requested);
        let (requested, changed, library) =
            (Arc::downgrade(&self.requested), self.changed.clone(), id.clone());
        let job = Job {
            id: id.clone(),
            pair,
            grid,
            ensemble_settings: self.ensemble_settings,
            source: self.source.clone(),
            loading: Arc::clone(&self.loading),
            queue: Arc::clone(&self.queue),
            cost: Arc::clone(&self.cost),
            ensembles: Arc::clone(&self.ensembles),
            simulation: sender,
            cancel,
            notify: Box::new(move || notify(&requested, &library, &changed)),
        };
        // A separate thread, not one of the runtime: a build may take a minute and must not delay the exit of
        // the process.
        if let Err(error) = std::thread::Builder::new().name("library".into()).spawn(move || job.run()) {
            tracing::error!(%error, "failed to start a thread for the simulation of a library");
            // The next request tries again.
            all.remove(&id);
        }
        Some((id, receiver))
    }

    /// Waits until the library of an asset is loaded from the cache or known to be missing there.
    pub(crate) async fn wait_until_loaded(&self, spec: &AssetSpec) {
        let Some((_, mut simulation)) = self.request(spec) else {
            return;
        };
        let known = simulation.wait_for(|simulation| !simulation.is_loading);
        // After the timeout the record is folded without the library.
        let _ = tokio::time::timeout(MAX_LOAD_WAIT, known).await;
    }

    /// The current estimator of an asset: without a library if that is still being simulated, or has failed.
    pub(crate) fn estimator(&self, spec: &AssetSpec) -> KeyedEstimator {
        let (id, simulation) = self.of(spec);
        let lack = match simulation.readiness {
            Readiness::None if spec.gear.is_none() => MissingLibrary::NoMesh,
            Readiness::None => MissingLibrary::NotDescribed,
            Readiness::Building => MissingLibrary::Simulating,
            Readiness::Failed(reason) => MissingLibrary::Failed(reason),
            Readiness::Ready(library) => {
                let ensemble = id.and_then(|id| lock(&self.ensembles).get(&id).cloned());
                return self.keyed(spec, Ok(ensemble.unwrap_or_else(|| Arc::new(Ensemble::of(library)))));
            }
        };
        self.keyed(spec, Err(lack))
    }

    fn id_of(&self, spec: &AssetSpec) -> Option<String> {
        spec.pair().map(|pair| library_id(pair, &self.grid.for_pair(pair)))
    }

    /// Whether the ensemble of an asset's library is still being simulated, so that a history folded now has
    /// to be folded again with it.
    pub(crate) fn awaits_ensemble(&self, spec: &AssetSpec) -> bool {
        let Some((_, simulation)) = self.request(spec) else {
            return false;
        };
        let simulation = simulation.borrow();
        self.ensemble_settings.members > 0 && (simulation.is_loading || simulation.progress.is_some())
    }

    /// The estimator of a fold key, if an asset has used it since the start for its description or for a
    /// history that is still served.
    pub(crate) fn estimator_of(&self, fold_key: &str) -> Option<KeyedEstimator> {
        lock(&self.estimators).get(fold_key).cloned()
    }

    fn keyed(&self, spec: &AssetSpec, library: Result<Arc<Ensemble>, MissingLibrary>) -> KeyedEstimator {
        let settings = EstimatorSettings {
            baseline_records: spec.baseline.records,
            limit_um: spec.limits.danger_um.or(spec.limits.warning_um),
        };
        let feature_key = analysis_keys(spec).feature;
        let rules = spec.alarm_rules();
        let fold_key = fold_key(&settings, &feature_key, library.as_deref(), &rules);
        lock(&self.estimators).of(&spec.id, &fold_key, || {
            let (estimator, lack) = match library {
                Ok(ensemble) if ensemble.is_part_of(&self.ensemble_settings) => {
                    (ChannelEstimator::provisional(settings, ensemble, rules), None)
                }
                Ok(ensemble) => (ChannelEstimator::new(settings, Some(ensemble), rules), None),
                Err(lack) => (ChannelEstimator::without_library(settings, lack.clone(), rules), Some(lack)),
            };
            KeyedEstimator { estimator, fold_key: fold_key.clone(), feature_key, lack }
        })
    }
}

impl Drop for Simulations {
    /// Cancels all simulations: they would keep every core busy although nothing can use their results.
    fn drop(&mut self) {
        for requested in lock(&self.requested).values() {
            requested.cancel.store(true, Ordering::Relaxed);
        }
    }
}

/// Notifies the assets that need a library.
fn notify(all: &Weak<RequestedLibraries>, library: &str, changed: &mpsc::UnboundedSender<Vec<AssetId>>) {
    let Some(all) = all.upgrade() else { return };
    let assets = lock(&all).get(library).map(|requested| requested.assets.keys().cloned().collect());
    // The receiver is gone if the service has ended.
    let _ = changed.send(assets.unwrap_or_default());
}
