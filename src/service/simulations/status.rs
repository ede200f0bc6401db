//! The status of the simulation of an asset's library.

use std::sync::Arc;
use std::time::Instant;

use crate::library::Library;

/// Whether an asset's library is ready.
#[derive(Debug, Clone)]
pub enum Readiness {
    /// The asset describes no gear pair.
    None,
    /// Being simulated or loaded.
    Building,
    /// Ready for use.
    Ready(Arc<Library>),
    /// The simulation failed, for this reason.
    Failed(String),
}

impl Readiness {
    /// `none`, `building`, `ready` or `failed`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Building => "building",
            Self::Ready(_) => "ready",
            Self::Failed(_) => "failed",
        }
    }
}

/// The stage of the simulation of an asset's library.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SimulationStage {
    /// Waiting while the library of another asset is being simulated.
    Waiting,
    /// The pair as described.
    Library,
    /// The first neighbouring pairs, needed for a first estimate.
    FirstMembers,
    /// The remaining neighbouring pairs; estimates are computed meanwhile.
    Members,
}

/// The progress of a stage.
#[derive(Debug, Clone, Copy)]
pub struct SimulationProgress {
    /// The stage.
    pub stage: SimulationStage,
    done: usize,
    total: usize,
    /// When the first piece was done, and how many were done then: some may come from an earlier build.
    first: Option<(Instant, usize)>,
}

impl SimulationProgress {
    pub(super) fn begin(stage: SimulationStage) -> Self {
        Self { stage, done: 0, total: 0, first: None }
    }

    /// Records how many pieces are done at a time; calls from several threads may arrive out of order.
    pub(super) fn update(&mut self, done: usize, total: usize, now: Instant) {
        self.done = self.done.max(done);
        self.total = total;
        self.first.get_or_insert((now, done));
    }

    /// The number of pieces done since a time, if the stage began then; 0 if some of them come from an
    /// earlier build, which are done at once.
    pub(super) fn pieces_since(&self, began: Instant, now: Instant) -> usize {
        let took = now.duration_since(began);
        let is_resumed = self.first.is_none_or(|(first, _)| first.duration_since(began) < took / 20);
        if is_resumed { 0 } else { self.done }
    }

    /// The fraction of the stage that is done, 0 to 1.
    pub fn fraction(&self) -> f64 {
        if self.total == 0 {
            return 0.0;
        }
        self.done as f64 / self.total as f64
    }

    /// The remaining time of the stage in seconds, at its speed so far; `None` until that is known.
    pub fn remaining_s(&self, now: Instant) -> Option<f64> {
        let (began, before) = self.first?;
        let since = self.done.checked_sub(before).filter(|since| *since > 0)?;
        let left = self.total.saturating_sub(self.done);
        Some(now.duration_since(began).as_secs_f64() * left as f64 / since as f64)
    }
}

/// The status of an asset's library.
#[derive(Debug, Clone)]
pub struct Simulation {
    /// Whether it is ready.
    pub readiness: Readiness,
    /// Progress of the current stage; `None` if nothing is being simulated.
    pub progress: Option<SimulationProgress>,
    /// Why the library, or its ensemble, could not be simulated.
    pub error: Option<String>,
    /// Whether it is still being loaded from the cache.
    pub(super) is_loading: bool,
}

impl Simulation {
    pub(super) fn begin() -> Self {
        Self { readiness: Readiness::Building, progress: None, error: None, is_loading: true }
    }

    pub(super) fn none() -> Self {
        Self { readiness: Readiness::None, is_loading: false, ..Self::begin() }
    }

    /// Ends the simulation with an error; a library that is ready stays ready.
    pub(super) fn fail(&mut self, reason: String) {
        if !matches!(self.readiness, Readiness::Ready(_)) {
            self.readiness = Readiness::Failed(reason.clone());
        }
        self.error = Some(reason);
        self.progress = None;
        self.is_loading = false;
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn the_remaining_time_follows_the_speed_so_far() {
        let began = Instant::now();
        let after = |s: u64| began + Duration::from_secs(s);
        let mut progress = SimulationProgress::begin(SimulationStage::Library);
        assert_eq!((progress.fraction(), progress.remaining_s(after(1))), (0.0, None));
        // 40 of 100 come from an earlier build.
        progress.update(40, 100, began);
        assert_eq!(progress.remaining_s(after(5)), None);
        progress.update(50, 100, after(10));
        progress.update(49, 100, after(10));
        assert_eq!((progress.fraction(), progress.remaining_s(after(10))), (0.5, Some(50.0)));
    }

    #[test]
    fn pieces_of_an_earlier_build_are_not_measured() {
        let began = Instant::now();
        let after = |s: u64| began + Duration::from_secs(s);
        let mut progress = SimulationProgress::begin(SimulationStage::Library);
        assert_eq!(progress.pieces_since(began, after(1)), 0);
        progress.update(8, 50, after(3));
        progress.update(50, 50, after(20));
        assert_eq!(progress.pieces_since(began, after(20)), 50);
        assert_eq!(progress.pieces_since(after(3), after(20)), 0);
    }

    #[test]
    fn a_failure_is_reported() {
        let mut simulation = Simulation::begin();
        simulation.fail("no".to_owned());
        assert_eq!(simulation.readiness.name(), "failed");
        assert!(!simulation.is_loading && simulation.error.is_some());
    }
}
