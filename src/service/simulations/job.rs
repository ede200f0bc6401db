//! The simulation of one library and of the neighbouring pairs, on a separate thread.

use std::any::Any;
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tokio::sync::watch;

use super::cost::Cost;
use super::simulation_queue::SimulationQueue;
use super::source::LibrarySource;
use super::status::{Readiness, Simulation, SimulationProgress, SimulationStage};
use crate::gear::PairSpec;
use crate::library::{
    BuildControl, Ensemble, EnsembleSettings, GridSettings, Library, LibraryError, VARIANTS,
};

/// Pairs simulated in one round, a few seconds on two cores, so that an asset waiting for its library is
/// served in between.
const MEMBERS_PER_ROUND: usize = 32 * VARIANTS;

/// Ensembles by the id of their central library.
pub(super) type Ensembles = Mutex<HashMap<String, Arc<Ensemble>>>;

/// The simulation of one requested library.
pub(super) struct Job {
    pub(super) id: String,
    pub(super) pair: PairSpec,
    pub(super) grid: GridSettings,
    pub(super) ensemble_settings: EnsembleSettings,
    pub(super) source: LibrarySource,
    /// Libraries are loaded one after the other.
    pub(super) loading: Arc<Mutex<()>>,
    pub(super) queue: Arc<SimulationQueue>,
    pub(super) cost: Arc<Cost>,
    pub(super) ensembles: Arc<Ensembles>,
    pub(super) simulation: watch::Sender<Simulation>,
    /// Set when the library is no longer needed.
    pub(super) cancel: Arc<AtomicBool>,
    /// Notifies the assets that the library is ready, has more members, or has failed.
    pub(super) notify: Box<dyn Fn() + Send + Sync>,
}

impl Job {
    /// Loads or simulates the library and publishes the outcome.
    pub(super) fn run(self) {
        match self.load_or_simulate() {
            Ok(()) => tracing::info!(library = %self.id, "library ready"),
            Err(JobError::Cancelled) => {
                tracing::info!(library = %self.id, "stopped the simulation of a library that no asset needs");
                return;
            }
            Err(JobError::FailedBefore(reason)) => {
                tracing::error!(library = %self.id, reason, "skipped the simulation of a library: it failed before");
                self.simulation.send_modify(|simulation| simulation.fail(reason));
            }
            Err(JobError::Failed { reason, is_permanent }) => {
                tracing::error!(library = %self.id, reason, "failed to simulate a library");
                if is_permanent {
                    self.source.failures().store(&self.id, &reason);
                }
                self.simulation.send_modify(|simulation| simulation.fail(reason));
            }
        }
        (self.notify)();
    }

    fn load_or_simulate(&self) -> Result<(), JobError> {
        if catch_panics(|| Ok(self.load()))? {
            return Ok(());
        }
        let Some(reason) = self.source.failures().reason(&self.id) else {
            return catch_panics(|| self.simulate());
        };
        // The library itself exists if only its ensemble failed.
        let is_ready = matches!(self.simulation.borrow().readiness, Readiness::Ready(_));
        if !is_ready && let Some(library) = self.source.cached(&self.pair, &self.grid) {
            let alone = Ensemble::of(Arc::clone(&library));
            self.ready(library, alone, None);
        }
        Err(JobError::FailedBefore(reason))
    }

    fn simulate(&self) -> Result<(), LibraryError> {
        if matches!(self.simulation.borrow().readiness, Readiness::Ready(_)) {
            (self.notify)();
        } else {
            self.begin(SimulationStage::Waiting);
        }
        let library = {
            let permit = self.queue.wait(SimulationStage::Library);
            let build = || self.source.get_or_build(&self.pair, &self.grid, &self.progress(), &self.cancel);
            self.measured(SimulationStage::Library, || permit.run(build))?
        };
        let alone = Ensemble::of(Arc::clone(&library));
        if self.ensemble_settings.members == 0 {
            self.ready(library, alone, None);
            return Ok(());
        }
        // Estimates wait only for the first members; histories are folded again when the rest are ready.
        let first = {
            let permit = self.queue.wait(SimulationStage::FirstMembers);
            let build = || self.members(&alone, &self.ensemble_settings.first(), &self.progress());
            self.measured(SimulationStage::FirstMembers, || permit.run(build))
        };
        let first = match first {
            Ok(first) => first,
            Err(LibraryError::Cancelled) => return Err(LibraryError::Cancelled),
            Err(error) => {
                self.ready(library, alone, None);
                return Err(error);
            }
        };
        self.ready(Arc::clone(&library), first.clone(), Some(SimulationStage::Members));
        (self.notify)();
        let whole = self.remaining(first)?;
        self.ready(library, whole, None);
        Ok(())
    }

    /// Begins a stage and, if it succeeds, measures its speed for the estimates of later simulations.
    fn measured<T>(
        &self,
        stage: SimulationStage,
        simulate: impl FnOnce() -> Result<T, LibraryError>,
    ) -> Result<T, LibraryError> {
        self.begin(stage);
        let began = Instant::now();
        let done = simulate()?;
        let now = Instant::now();
        let progress = self.simulation.borrow().progress;
        let pieces = progress.map_or(0, |progress| progress.pieces_since(began, now));
        self.cost.observe(stage, pieces, now.duration_since(began));
        Ok(done)
    }

    /// Simulates all members, some more in each round.
    fn remaining(&self, first: Ensemble) -> Result<Ensemble, LibraryError> {
        let (begin, all) = (self.ensemble_settings.first().members, self.ensemble_settings.members);
        let progress = self.progress();
        let mut ensemble = first;
        for done in (begin..all).step_by(MEMBERS_PER_ROUND) {
            let before = (done - begin) / VARIANTS;
            let of_all = |more: usize, _: usize| progress(before + more, (all - begin).div_ceil(VARIANTS));
            let permit = self.queue.wait(SimulationStage::Members);
            let settings = EnsembleSettings { members: done + MEMBERS_PER_ROUND };
            if settings.members >= all {
                return permit.run(|| self.members(&ensemble, &self.ensemble_settings, &of_all));
            }
            let control = BuildControl::with_progress(&of_all).cancelled_by(&self.cancel);
            ensemble = permit.run(|| ensemble.extended(&settings, &control))?;
        }
        Ok(ensemble)
    }

    /// Loads the library and its members from the cache, only the first members if not all are cached;
    /// returns whether everything was loaded.
    fn load(&self) -> bool {
        let _guard = lock(&self.loading);
        let Some(library) = self.source.cached(&self.pair, &self.grid) else {
            return false;
        };
        let kept = |settings: &EnsembleSettings| match settings.members {
            0 => Some(Ensemble::of(Arc::clone(&library))),
            _ => self.source.cached_ensemble(&library, settings),
        };
        if let Some(whole) = kept(&self.ensemble_settings) {
            self.ready(Arc::clone(&library), whole, None);
            return true;
        }
        if let Some(first) = kept(&self.ensemble_settings.first()) {
            self.ready(Arc::clone(&library), first, Some(SimulationStage::Waiting));
        }
        false
    }

    fn members(
        &self,
        smaller: &Ensemble,
        settings: &EnsembleSettings,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Ensemble, LibraryError> {
        let control = BuildControl::with_progress(progress).cancelled_by(&self.cancel);
        self.source.ensemble(smaller, settings, &control)
    }

    fn begin(&self, stage: SimulationStage) {
        self.simulation.send_modify(|simulation| {
            simulation.is_loading = false;
            simulation.progress = Some(SimulationProgress::begin(stage));
        });
    }

    fn progress(&self) -> impl Fn(usize, usize) + Sync + use<'_> {
        |done, total| {
            self.simulation.send_modify(|simulation| {
                if let Some(progress) = &mut simulation.progress {
                    progress.update(done, total, Instant::now());
                }
            });
        }
    }

    /// Publishes the library and its ensemble; the stage `next` is simulated meanwhile.
    fn ready(&self, library: Arc<Library>, ensemble: Ensemble, next: Option<SimulationStage>) {
        {
            let mut ensembles = lock(&self.ensembles);
            if !self.cancel.load(Ordering::Relaxed) {
                ensembles.insert(self.id.clone(), Arc::new(ensemble));
            }
        }
        self.simulation.send_modify(|simulation| {
            simulation.readiness = Readiness::Ready(library);
            simulation.progress = next.map(SimulationProgress::begin);
            simulation.is_loading = false;
        });
    }
}

/// Why a simulation ends without success.
#[derive(Debug, PartialEq, Eq)]
enum JobError {
    Cancelled,
    /// It failed at an earlier start, for this reason.
    FailedBefore(String),
    Failed {
        reason: String,
        /// Whether the pair is the cause and it would fail again; otherwise, for example with a full disk,
        /// the next start may succeed.
        is_permanent: bool,
    },
}

fn catch_panics<T>(simulate: impl FnOnce() -> Result<T, LibraryError>) -> Result<T, JobError> {
    // State left by a panic is read only if it is complete.
    match catch_unwind(AssertUnwindSafe(simulate)) {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(LibraryError::Cancelled)) => Err(JobError::Cancelled),
        Ok(Err(error)) => {
            use LibraryError::{Gear, Grid, Response};
            let is_permanent = matches!(error, Gear(_) | Grid { .. } | Response { .. });
            Err(JobError::Failed { reason: error.to_string(), is_permanent })
        }
        Err(panic) => {
            let reason = format!("the simulation panicked: {}", panic_message(panic.as_ref()));
            Err(JobError::Failed { reason, is_permanent: true })
        }
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("without a message")
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_and_panics_become_reasons() {
        assert_eq!(catch_panics(|| Ok(())), Ok(()));
        assert_eq!(catch_panics::<()>(|| Err(LibraryError::Cancelled)), Err(JobError::Cancelled));
        let damaged = catch_panics::<()>(|| Err(LibraryError::Damaged("torn".into())));
        let reason = "damaged library file: torn".to_owned();
        assert_eq!(damaged, Err(JobError::Failed { reason, is_permanent: false }));
        let teeth = 0;
        let reason = "the simulation panicked: 0 teeth".to_owned();
        let panicked = catch_panics::<()>(|| panic!("{teeth} teeth"));
        assert_eq!(panicked, Err(JobError::Failed { reason, is_permanent: true }));
    }

    /// The final status of a job for a valid pair, with this many wear states.
    fn run_job(folder: &std::path::Path, id: &str, states: usize) -> Simulation {
        let (simulation, receiver) = watch::channel(Simulation::begin());
        let job = Job {
            id: id.to_owned(),
            pair: PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml")).unwrap(),
            grid: GridSettings { states, seconds: 0.3, ..GridSettings::default() },
            ensemble_settings: EnsembleSettings { members: 0 },
            source: LibrarySource::alone(folder),
            loading: Arc::default(),
            queue: Arc::new(SimulationQueue::new(2).unwrap()),
            cost: Arc::new(Cost::new(2)),
            ensembles: Arc::default(),
            simulation,
            cancel: Arc::default(),
            notify: Box::new(|| {}),
        };
        job.run();
        receiver.borrow().clone()
    }

    #[test]
    fn a_failed_simulation_is_skipped_until_its_failure_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let failed = run_job(folder.path(), "a1", 0);
        let reason = failed.error.unwrap();
        assert!(reason.contains("states"), "{reason}");
        // It would succeed now, but is skipped.
        let again = run_job(folder.path(), "a1", 3);
        assert_eq!((again.readiness.name(), again.error), ("failed", Some(reason)));
        LibrarySource::alone(folder.path()).failures().remove("a1");
        assert_eq!(run_job(folder.path(), "a1", 3).readiness.name(), "ready");
    }
}
