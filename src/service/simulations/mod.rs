//! The library of each asset, simulated once in the background. Records wait for none: until theirs is there
//! they are folded without it, and then again.

mod failures;
mod job;
mod source;
mod status;
mod turns;

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use tokio::sync::{mpsc, watch};

use super::keys::{analysis_keys, fold_key};
use crate::asset::{AssetId, AssetSpec};
use crate::estimate::{ChannelEstimator, EstimatorSettings, MissingLibrary};
use crate::library::{Ensemble, EnsembleSettings, GridSettings, LibraryCache, library_id};
use job::{Ensembles, Job, lock};
pub(crate) use source::LibrarySource;
pub use status::{Readiness, Simulation, SimulationProgress, SimulationStage};
use turns::Turns;

/// How long a record waits until it is known whether its library is kept from before: where it is, a history
/// that was folded with it goes on.
const KNOWN_WITHIN: Duration = Duration::from_secs(10);

/// An estimator and what identifies everything that it depends on.
#[derive(Debug, Clone)]
pub(crate) struct KeyedEstimator {
    pub(crate) estimator: ChannelEstimator,
    /// A fold under another key has to begin again.
    pub(crate) fold_key: String,
    /// Features under another key cannot go in.
    pub(crate) feature_key: Arc<str>,
    /// Why it compares with no library; none where it does.
    lack: Option<MissingLibrary>,
}

impl KeyedEstimator {
    /// Whether there will be another one when the asset's library is there.
    pub(crate) fn awaits_library(&self) -> bool {
        self.lack == Some(MissingLibrary::Simulating)
    }

    /// Whether it compares with no library.
    pub(crate) fn is_without_library(&self) -> bool {
        self.lack.is_some()
    }
}

/// A library that assets ask for.
struct Asked {
    simulation: watch::Receiver<Simulation>,
    cancel: Arc<AtomicBool>,
    /// The assets, as they were described then.
    by: HashMap<AssetId, AssetSpec>,
}

impl Asked {
    fn is_over(&self) -> bool {
        let simulation = self.simulation.borrow();
        !simulation.is_loading && simulation.progress.is_none()
    }

    fn has_failed(&self) -> bool {
        self.simulation.borrow().error.is_some()
    }
}

/// By library id.
type AllAsked = Mutex<HashMap<String, Asked>>;

/// The libraries in use.
pub struct Simulations {
    source: LibrarySource,
    /// For module 6 mm; each pair's own is [`GridSettings::for_pair`].
    grid: GridSettings,
    asked: Arc<AllAsked>,
    /// By fold key, also those of histories that are being computed again.
    estimators: Mutex<HashMap<String, KeyedEstimator>>,
    neighbours: EnsembleSettings,
    ensembles: Arc<Ensembles>,
    /// Told the assets whose library has come, has got more members, or will not come.
    changed: mpsc::UnboundedSender<Vec<AssetId>>,
    /// One library is loaded at a time.
    loading: Arc<Mutex<()>>,
    turns: Arc<Turns>,
}

impl Simulations {
    /// What was folded of the assets that `changed` is told is to be folded again.
    pub(crate) fn new(
        source: LibrarySource,
        grid: GridSettings,
        neighbours: EnsembleSettings,
        changed: mpsc::UnboundedSender<Vec<AssetId>>,
    ) -> Self {
        Self {
            changed,
            source,
            grid,
            asked: Arc::default(),
            estimators: Mutex::default(),
            neighbours,
            ensembles: Arc::default(),
            loading: Arc::default(),
            turns: Arc::default(),
        }
    }

    /// The folder of all libraries. Its methods block on the disk.
    pub fn cache(&self) -> Arc<LibraryCache> {
        Arc::clone(self.source.cache())
    }

    /// The identifier of an asset's library, and how far it is; starts it where nobody has asked for it yet.
    pub fn of(&self, spec: &AssetSpec) -> (Option<String>, Simulation) {
        match self.ask(spec) {
            Some((id, simulation)) => (Some(id), simulation.borrow().clone()),
            None => (None, Simulation::none()),
        }
    }

    /// Starts an asset's library in the background where nobody has asked for it yet.
    pub fn start(&self, spec: &AssetSpec) {
        self.ask(spec);
    }

    /// Takes a description: its library is started in the background, one that failed, also before the last
    /// restart, again where the description is another than before; what it asked for before is stopped where
    /// no other asset asks for it.
    pub fn describe(&self, spec: &AssetSpec) {
        let id = self.id_of(spec);
        self.release_except(&spec.id, id.as_deref());
        let Some(id) = id else { return };
        let failed = {
            let mut all = lock(&self.asked);
            // What every asset describes is asked for at the start: this is another description.
            let is_new = all.get(&id).is_none_or(|asked| asked.by.get(&spec.id) != Some(spec));
            let is_over = all.get(&id).is_none_or(Asked::has_failed);
            if is_new && is_over {
                self.source.failures().forget(&id);
                all.remove(&id)
            } else {
                None
            }
        };
        self.ask(spec);
        if let Some(asked) = lock(&self.asked).get_mut(&id) {
            asked.by.extend(failed.into_iter().flat_map(|failed| failed.by));
            asked.by.insert(spec.id.clone(), spec.clone());
        }
    }

    /// Forgets an asset that is gone: what is simulated for it alone is stopped.
    pub(crate) fn release(&self, asset: &AssetId) {
        self.release_except(asset, None);
    }

    fn release_except(&self, asset: &AssetId, kept: Option<&str>) {
        lock(&self.asked).retain(|id, asked| {
            if Some(id.as_str()) == kept || asked.by.remove(asset).is_none() || !asked.by.is_empty() {
                return true;
            }
            let is_there = asked.is_over() && !asked.has_failed();
            if !is_there {
                asked.cancel.store(true, Ordering::Relaxed);
            }
            is_there
        });
    }

    fn ask(&self, spec: &AssetSpec) -> Option<(String, watch::Receiver<Simulation>)> {
        let pair = spec.pair()?.clone();
        let grid = self.grid.for_pair(&pair);
        let id = library_id(&pair, &grid);
        let mut all = lock(&self.asked);
        if let Some(asked) = all.get_mut(&id) {
            asked.by.entry(spec.id.clone()).or_insert_with(|| spec.clone());
            return Some((id, asked.simulation.clone()));
        }
        let (sender, receiver) = watch::channel(Simulation::begin());
        let cancel = Arc::<AtomicBool>::default();
        let asked = Asked {
            simulation: receiver.clone(),
            cancel: Arc::clone(&cancel),
            by: HashMap::from([(spec.id.clone(), spec.clone())]),
        };
        all.insert(id.clone(), asked);
        let (asked, changed, told) = (Arc::downgrade(&self.asked), self.changed.clone(), id.clone());
        let job = Job {
            id: id.clone(),
            pair,
            grid,
            neighbours: self.neighbours,
            source: self.source.clone(),
            loading: Arc::clone(&self.loading),
            turns: Arc::clone(&self.turns),
            ensembles: Arc::clone(&self.ensembles),
            simulation: sender,
            cancel,
            tell: Box::new(move || tell(&asked, &told, &changed)),
        };
        // A thread of its own, not one of the runtime's: a build may take a minute and must not hold up the
        // end of the process.
        if let Err(error) = std::thread::Builder::new().name("library".into()).spawn(move || job.run()) {
            tracing::error!(%error, "failed to start a thread for a library");
            // Who asks next tries again.
            all.remove(&id);
        }
        Some((id, receiver))
    }

    /// Waits until it is known whether the library of an asset is kept from before.
    pub(crate) async fn known(&self, spec: &AssetSpec) {
        let Some((_, mut simulation)) = self.ask(spec) else {
            return;
        };
        let known = simulation.wait_for(|simulation| !simulation.is_loading);
        // Where it takes longer the record is folded without.
        let _ = tokio::time::timeout(KNOWN_WITHIN, known).await;
    }

    /// The estimator of an asset as it is now: without a library where that is still simulated, or will not
    /// come.
    pub(crate) fn estimator(&self, spec: &AssetSpec) -> KeyedEstimator {
        let (id, simulation) = self.of(spec);
        let lack = match simulation.readiness {
            Readiness::None if spec.gear.is_none() => MissingLibrary::NoMesh,
            Readiness::None => MissingLibrary::NotDescribed,
            Readiness::Building => MissingLibrary::Simulating,
            Readiness::Failed(reason) => MissingLibrary::Failed(reason),
            Readiness::Ready(library) => {
                let kept = id.and_then(|id| lock(&self.ensembles).get(&id).cloned());
                return self.keyed(spec, Ok(kept.unwrap_or_else(|| Arc::new(Ensemble::of(library)))));
            }
        };
        self.keyed(spec, Err(lack))
    }

    fn id_of(&self, spec: &AssetSpec) -> Option<String> {
        spec.pair().map(|pair| library_id(pair, &self.grid.for_pair(pair)))
    }

    /// Whether neighbours of an asset's library are still to come, so that what is folded now is to be folded
    /// again with them.
    pub(crate) fn awaits_neighbours(&self, spec: &AssetSpec) -> bool {
        let Some((_, simulation)) = self.ask(spec) else {
            return false;
        };
        let simulation = simulation.borrow();
        self.neighbours.members > 0 && (simulation.is_loading || simulation.progress.is_some())
    }

    /// The estimator of a fold key, where it was in use since the start.
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
        let mut estimators = lock(&self.estimators);
        let keyed = estimators.entry(fold_key.clone()).or_insert_with(|| {
            let (estimator, lack) = match library {
                Ok(ensemble) if ensemble.is_part_of(&self.neighbours) => {
                    (ChannelEstimator::provisional(settings, ensemble, rules), None)
                }
                Ok(ensemble) => (ChannelEstimator::new(settings, Some(ensemble), rules), None),
                Err(lack) => (ChannelEstimator::without_library(settings, lack.clone(), rules), Some(lack)),
            };
            KeyedEstimator { estimator, fold_key, feature_key, lack }
        });
        keyed.clone()
    }
}

impl Drop for Simulations {
    /// What nobody can ask for any more is not simulated to its end: it would keep every core from others in
    /// this process.
    fn drop(&mut self) {
        for asked in lock(&self.asked).values() {
            asked.cancel.store(true, Ordering::Relaxed);
        }
    }
}

/// Tells the assets that ask for a library.
fn tell(all: &Weak<AllAsked>, library: &str, changed: &mpsc::UnboundedSender<Vec<AssetId>>) {
    let Some(all) = all.upgrade() else { return };
    let assets = lock(&all).get(library).map(|asked| asked.by.keys().cloned().collect());
    // Nobody is told where the service has ended meanwhile.
    let _ = changed.send(assets.unwrap_or_default());
}
