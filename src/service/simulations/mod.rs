//! The library of each asset: simulated once in the background, waited for by the first record that needs it.

mod source;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{mpsc, watch};

use super::error::ServiceError;
use super::keys::{analysis_keys, fold_key};
use super::sensor_group::described;
use crate::asset::{AssetId, AssetSpec};
use crate::estimate::{ChannelEstimator, EstimatorSettings};
use crate::library::{Ensemble, EnsembleSettings, GridSettings, Library, LibraryShelf, ensemble_id, library_id};
use crate::store::{Asset, Store};
pub(crate) use source::LibrarySource;

/// The error of an asset whose library is not there yet.
const SIMULATING: ServiceError = ServiceError::Busy {
    what: "the asset's library is being simulated",
    retry_after_s: 5,
};

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

/// An estimator and what identifies everything that it depends on.
#[derive(Debug, Clone)]
pub(crate) struct KeyedEstimator {
    pub(crate) estimator: ChannelEstimator,
    /// A fold under another key has to begin again.
    pub(crate) fold_key: String,
    /// Features under another key cannot go in.
    pub(crate) feature_key: Arc<str>,
}

/// The libraries in use.
pub struct Simulations {
    source: LibrarySource,
    /// For module 6 mm; each pair's own is [`GridSettings::for_pair`].
    grid: GridSettings,
    wait: Duration,
    /// By library id.
    asked: Mutex<HashMap<String, watch::Receiver<Readiness>>>,
    /// By fold key, also those of histories that are being computed again.
    estimators: Mutex<HashMap<String, KeyedEstimator>>,
    neighbours: EnsembleSettings,
    /// By the id of the library that they are around.
    ensembles: Arc<Mutex<HashMap<String, Arc<Ensemble>>>>,
    /// Told the id of each library whose neighbours have come.
    complete: mpsc::UnboundedSender<String>,
    /// One build at a time: each one uses every core by itself.
    building: Arc<Mutex<()>>,
}

impl Simulations {
    /// Each id that `complete` is told is of a library whose neighbours have come: what was folded without
    /// them is to be folded again.
    pub(crate) fn new(
        source: LibrarySource,
        grid: GridSettings,
        neighbours: EnsembleSettings,
        wait: Duration,
        complete: mpsc::UnboundedSender<String>,
    ) -> Self {
        Self {
            complete,
            source,
            grid,
            wait,
            asked: Mutex::default(),
            estimators: Mutex::default(),
            neighbours,
            ensembles: Arc::default(),
            building: Arc::default(),
        }
    }

    /// The folder of all libraries. Its methods block on the disk.
    pub fn shelf(&self) -> Arc<LibraryShelf> {
        Arc::clone(self.source.shelf())
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
        let grid = self.grid.for_pair(&pair);
        let id = library_id(&pair, &grid);
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(progress) = asked.get(&id)
            && !(again && matches!(*progress.borrow(), Readiness::Failed(_)))
        {
            return Some((id, progress.clone()));
        }
        let (sender, receiver) = watch::channel(Readiness::Building { done: 0, total: 0 });
        asked.insert(id.clone(), receiver.clone());
        let (source, building) = (self.source.clone(), Arc::clone(&self.building));
        let (neighbours, ensembles, complete) = (self.neighbours, Arc::clone(&self.ensembles), self.complete.clone());
        let built_id = id.clone();
        // A thread of its own, not one of the runtime's: a build may take a minute and must not hold up the
        // end of the process.
        let build = move || {
            let _turn = building.lock().unwrap_or_else(PoisonError::into_inner);
            tracing::info!(library = %built_id, "building or loading the library");
            let progress = |done, total| {
                sender.send_replace(Readiness::Building { done, total });
            };
            let built = source.get_or_build(&pair, &grid, &progress);
            let library = match built {
                Ok(library) => library,
                Err(error) => {
                    tracing::error!(library = %built_id, %error, "failed to build the library");
                    sender.send_replace(Readiness::Failed(error.to_string()));
                    return;
                }
            };
            tracing::info!(library = %built_id, "library ready");
            let keep = |ensemble: Ensemble| {
                let mut ensembles = ensembles.lock().unwrap_or_else(PoisonError::into_inner);
                ensembles.insert(built_id.clone(), Arc::new(ensemble));
            };
            let alone = || Ensemble::of(Arc::clone(&library));
            if neighbours.members == 0 {
                sender.send_replace(Readiness::Ready(library));
                return;
            }
            // Records wait for the first members alone: when the rest are there, histories are folded again with them.
            let first = source.ensemble(&alone(), &neighbours.first()).unwrap_or_else(|error| {
                tracing::error!(library = %built_id, %error, "failed to simulate the first members of the ensemble");
                alone()
            });
            keep(first.clone());
            sender.send_replace(Readiness::Ready(Arc::clone(&library)));
            match source.ensemble(&first, &neighbours) {
                Ok(ensemble) => {
                    tracing::info!(library = %built_id, members = ensemble.members().len(), "ensemble ready");
                    keep(ensemble);
                }
                Err(error) => tracing::error!(library = %built_id, %error, "failed to simulate the ensemble"),
            }
            // Nobody is told where the service has ended meanwhile.
            let _ = complete.send(built_id);
        };
        if let Err(error) = std::thread::Builder::new().name("library".into()).spawn(build) {
            tracing::error!(%error, "failed to start a thread for a library");
        }
        Some((id, receiver))
    }

    /// The estimator of an asset, once its library is there.
    pub(crate) async fn estimator(&self, spec: &AssetSpec) -> Result<KeyedEstimator, ServiceError> {
        let ensemble = match self.ask(spec, false) {
            Some((id, progress)) => {
                let library = self.wait_for(spec, id, progress).await?;
                Some(self.ensemble(library))
            }
            None => None,
        };
        Ok(self.keyed(spec, ensemble))
    }

    /// Waits for the libraries of assets.
    pub(crate) async fn wait_for_all(&self, specs: impl IntoIterator<Item = &AssetSpec>) -> Result<(), ServiceError> {
        for spec in specs {
            self.estimator(spec).await?;
        }
        Ok(())
    }

    /// The description of an asset and its estimator, once its library is there, however long that takes.
    pub(crate) async fn ready_for(&self, store: &Store, asset: &AssetId) -> Result<(Asset, KeyedEstimator), ServiceError> {
        loop {
            let described = described(store, asset).await?;
            match self.estimator(&described.spec).await {
                Err(ServiceError::Busy { retry_after_s, .. }) => tokio::time::sleep(Duration::from_secs(retry_after_s.into())).await,
                Err(error) => return Err(error),
                Ok(estimator) => return Ok((described, estimator)),
            }
        }
    }

    /// The estimator of an asset without waiting: [`ServiceError::Busy`] where the library is not there yet.
    pub(crate) fn estimator_now(&self, spec: &AssetSpec) -> Result<KeyedEstimator, ServiceError> {
        let ensemble = match self.ask(spec, false) {
            None => None,
            Some((_, progress)) => match &*progress.borrow() {
                Readiness::Ready(library) => Some(self.ensemble(Arc::clone(library))),
                _ => return Err(SIMULATING),
            },
        };
        Ok(self.keyed(spec, ensemble))
    }

    /// The identifier of an asset's library; none where it describes no gear pair.
    pub(crate) fn id_for(&self, spec: &AssetSpec) -> Option<String> {
        spec.gear.pair.as_ref().map(|pair| library_id(pair, &self.grid.for_pair(pair)))
    }

    /// Whether neighbours of an asset's library are still to come, so that what is folded now is to be folded
    /// again with them.
    pub(crate) fn awaits_neighbours(&self, spec: &AssetSpec) -> bool {
        let Some(id) = self.id_for(spec) else { return false };
        let ensembles = self.ensembles.lock().unwrap_or_else(PoisonError::into_inner);
        let whole = ensemble_id(&id, &self.neighbours);
        self.neighbours.members > 0 && ensembles.get(&id).is_none_or(|ensemble| ensemble.id() != whole)
    }

    /// The estimator of a fold key, where it was in use since the start.
    pub(crate) fn estimator_of(&self, fold_key: &str) -> Option<KeyedEstimator> {
        let estimators = self.estimators.lock().unwrap_or_else(PoisonError::into_inner);
        estimators.get(fold_key).cloned()
    }

    fn keyed(&self, spec: &AssetSpec, ensemble: Option<Arc<Ensemble>>) -> KeyedEstimator {
        let settings = EstimatorSettings {
            baseline_records: spec.baseline.records,
            limit_um: spec.limits.danger_um.or(spec.limits.warning_um),
        };
        let feature_key = analysis_keys(spec).feature;
        let rules = spec.alarm_rules();
        let fold_key = fold_key(&settings, &feature_key, ensemble.as_deref(), &rules);
        let mut estimators = self.estimators.lock().unwrap_or_else(PoisonError::into_inner);
        let keyed = estimators.entry(fold_key.clone()).or_insert_with(|| KeyedEstimator {
            estimator: ChannelEstimator::new(settings, ensemble, rules),
            fold_key,
            feature_key,
        });
        keyed.clone()
    }

    /// The library with its neighbours; alone while they are being simulated.
    fn ensemble(&self, library: Arc<Library>) -> Arc<Ensemble> {
        let ensembles = self.ensembles.lock().unwrap_or_else(PoisonError::into_inner);
        let ensemble = ensembles.get(library.id()).cloned();
        ensemble.unwrap_or_else(|| Arc::new(Ensemble::of(library)))
    }

    async fn wait_for(&self, spec: &AssetSpec, id: String, mut progress: watch::Receiver<Readiness>) -> Result<Arc<Library>, ServiceError> {
        let failed = |reason: String| ServiceError::Library {
            id: id.clone(),
            asset: spec.id.to_string(),
            reason,
        };
        let over = progress.wait_for(|readiness| !matches!(readiness, Readiness::Building { .. }));
        match tokio::time::timeout(self.wait, over).await {
            Err(_) => Err(SIMULATING),
            Ok(Err(_)) => Err(failed("its building stopped".into())),
            Ok(Ok(readiness)) => match &*readiness {
                Readiness::Ready(library) => Ok(Arc::clone(library)),
                Readiness::Failed(reason) => Err(failed(reason.clone())),
                Readiness::None | Readiness::Building { .. } => Err(failed("it is not there".into())),
            },
        }
    }
}
