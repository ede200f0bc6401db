//! The expected time of a simulation before it starts, from the speed of earlier ones on this machine.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::status::SimulationStage;
use crate::library::{EnsembleSettings, FIRST_MEMBERS, GridSettings, VARIANTS};

/// Processor time in seconds for one of the 50 wear states of the paper's pair (docs/model.md), until this
/// process has measured its own.
const STATE_S: f64 = 1.04 / 50.0;

/// The same for a group of ensemble members that are simulated together: in all 8 times as many instructions
/// as the library (benches/RESULTS.md).
const GROUP_S: f64 = 8.0 * 1.04 / (FIRST_MEMBERS / VARIANTS) as f64;

/// The time of one piece of each stage, on all threads for simulations.
#[derive(Debug)]
pub(super) struct Cost {
    pieces: Mutex<PieceTimes>,
}

#[derive(Debug)]
struct PieceTimes {
    state_s: f64,
    group_s: f64,
}

impl Cost {
    pub(super) fn new(threads: usize) -> Self {
        let threads = threads as f64;
        Self { pieces: Mutex::new(PieceTimes { state_s: STATE_S / threads, group_s: GROUP_S / threads }) }
    }

    fn pieces(&self) -> MutexGuard<'_, PieceTimes> {
        self.pieces.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records how long a stage with this many pieces took.
    pub(super) fn observe(&self, stage: SimulationStage, pieces: usize, took: Duration) {
        if pieces == 0 {
            return;
        }
        let piece_s = took.as_secs_f64() / pieces as f64;
        let mut times = self.pieces();
        match stage {
            SimulationStage::Library => times.state_s = piece_s,
            SimulationStage::FirstMembers => times.group_s = piece_s,
            SimulationStage::Waiting | SimulationStage::Members => {}
        }
    }

    /// The expected seconds until a library is ready.
    pub(super) fn library_s(&self, grid: &GridSettings) -> f64 {
        self.pieces().state_s * grid.simulations() as f64
    }

    /// The expected seconds from then on until the first members of its ensemble are ready.
    pub(super) fn first_members_s(&self, ensemble_settings: EnsembleSettings) -> f64 {
        self.pieces().group_s * ensemble_settings.first().members.div_ceil(VARIANTS) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_estimate_follows_the_last_measurement() {
        let (grid, ensemble_settings) = (GridSettings::default(), EnsembleSettings::default());
        let cost = Cost::new(2);
        let both_s = |grid: &GridSettings| cost.library_s(grid) + cost.first_members_s(ensemble_settings);
        assert!((both_s(&grid) - 9.0 * 1.04 / 2.0).abs() < 1e-9);
        assert!((cost.library_s(&grid) - 0.52).abs() < 1e-9);
        assert_eq!(cost.first_members_s(EnsembleSettings::described_alone()), 0.0);
        cost.observe(SimulationStage::Library, 50, Duration::from_secs(10));
        cost.observe(SimulationStage::FirstMembers, 24, Duration::from_secs(48));
        // A library that was fetched, and a stage that no estimate contains.
        cost.observe(SimulationStage::Library, 0, Duration::from_secs(1));
        cost.observe(SimulationStage::Members, 100, Duration::from_secs(1));
        assert!((both_s(&grid) - 58.0).abs() < 1e-9);
        let twice = GridSettings { torque_factors: vec![0.5, 1.0], ..grid.clone() };
        assert!((both_s(&twice) - 68.0).abs() < 1e-9);
    }
}
