//! How far the simulation of an asset's library is.

use std::sync::Arc;
use std::time::Instant;

use crate::library::Library;

/// Whether an asset's library is there.
#[derive(Debug, Clone)]
pub enum Readiness {
    /// The asset describes no gear pair.
    None,
    /// Being simulated or loaded.
    Building,
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
            Self::Building => "building",
            Self::Ready(_) => "ready",
            Self::Failed(_) => "failed",
        }
    }
}

/// What of an asset's library is being simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SimulationStage {
    /// Nothing yet: another asset's is.
    Waiting,
    /// The pair as it is described.
    Library,
    /// The pairs around it that a first estimate is made with.
    FirstMembers,
    /// All the others around it; estimates are made meanwhile.
    Members,
}

/// How much of a stage is done.
#[derive(Debug, Clone, Copy)]
pub struct SimulationProgress {
    /// The stage.
    pub stage: SimulationStage,
    done: usize,
    total: usize,
    /// When the first piece was done, and how many were then: some may have been kept from an earlier build.
    first: Option<(Instant, usize)>,
}

impl SimulationProgress {
    pub(super) fn begin(stage: SimulationStage) -> Self {
        Self { stage, done: 0, total: 0, first: None }
    }

    /// Notes how many pieces are done at a time; threads may say so in another order than they count.
    pub(super) fn note(&mut self, done: usize, total: usize, now: Instant) {
        self.done = self.done.max(done);
        self.total = total;
        self.first.get_or_insert((now, done));
    }

    /// The part of the stage that is done, 0 to 1.
    pub fn fraction(&self) -> f64 {
        if self.total == 0 {
            return 0.0;
        }
        self.done as f64 / self.total as f64
    }

    /// How long the stage still takes in s, at the speed it has had so far; none before that is known.
    pub fn remaining_s(&self, now: Instant) -> Option<f64> {
        let (began, before) = self.first?;
        let since = self.done.checked_sub(before).filter(|since| *since > 0)?;
        let left = self.total.saturating_sub(self.done);
        Some(now.duration_since(began).as_secs_f64() * left as f64 / since as f64)
    }
}

/// An asset's library, as far as it is.
#[derive(Debug, Clone)]
pub struct Simulation {
    /// Whether it is there.
    pub readiness: Readiness,
    /// How far what is being simulated is; none where nothing is.
    pub progress: Option<SimulationProgress>,
    /// Why the library, or the pairs around it, could not be simulated.
    pub error: Option<String>,
    /// It is not known yet whether it is kept from before.
    pub(super) is_loading: bool,
}

impl Simulation {
    pub(super) fn begin() -> Self {
        Self { readiness: Readiness::Building, progress: None, error: None, is_loading: true }
    }

    pub(super) fn none() -> Self {
        Self { readiness: Readiness::None, is_loading: false, ..Self::begin() }
    }

    /// Says that it ends here; what is ready stays so.
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
        // 40 of 100 were kept from an earlier build.
        progress.note(40, 100, began);
        assert_eq!(progress.remaining_s(after(5)), None);
        progress.note(50, 100, after(10));
        progress.note(49, 100, after(10));
        assert_eq!((progress.fraction(), progress.remaining_s(after(10))), (0.5, Some(50.0)));
    }

    #[test]
    fn what_fails_later_leaves_what_is_ready() {
        let mut simulation = Simulation::begin();
        simulation.fail("no".to_owned());
        assert_eq!(simulation.readiness.name(), "failed");
        assert!(!simulation.is_loading && simulation.error.is_some());
    }
}
