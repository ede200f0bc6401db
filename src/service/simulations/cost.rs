//! The expected time of a simulation before it starts, from the speed of earlier ones on this machine.

use std::sync::Mutex;
use std::time::Duration;

use super::job::lock;
use super::status::SimulationStage;
use crate::library::{EnsembleSettings, FIRST_MEMBERS, GridSettings, VARIANTS};

/// Processor time in seconds for one of the 50 wear states of the paper's pair (docs/model.md), until this
/// process has measured its own.
const STATE_S: f64 = 1.04 / 50.0;

/// The same for a group of ensemble members that are simulated together: in all 8 times as many instructions as
/// the library (benches/RESULTS.md).
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

    /// Records how long a stage with this many pieces took.
    pub(super) fn note(&self, stage: SimulationStage, pieces: usize, took: Duration) {
        if pieces == 0 {
            return;
        }
        let piece_s = took.as_secs_f64() / pieces as f64;
        let mut times = lock(&self.pieces);
        match stage {
            SimulationStage::Library => times.state_s = piece_s,
            SimulationStage::FirstMembers => times.group_s = piece_s,
            SimulationStage::Waiting | SimulationStage::Members => {}
        }
    }

    /// The expected seconds until the library and the first members are ready.
    pub(super) fn estimated_s(&self, grid: &GridSettings, neighbours: EnsembleSettings) -> f64 {
        let times = lock(&self.pieces);
        let groups = neighbours.first().members.div_ceil(VARIANTS);
        times.state_s * grid.simulations() as f64 + times.group_s * groups as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_estimate_follows_the_last_measurement() {
        let (grid, neighbours) = (GridSettings::default(), EnsembleSettings::default());
        let cost = Cost::new(2);
        assert!((cost.estimated_s(&grid, neighbours) - 9.0 * 1.04 / 2.0).abs() < 1e-9);
        assert!((cost.estimated_s(&grid, EnsembleSettings::described_alone()) - 0.52).abs() < 1e-9);
        cost.note(SimulationStage::Library, 50, Duration::from_secs(10));
        cost.note(SimulationStage::FirstMembers, 24, Duration::from_secs(48));
        // A library that was fetched, and a stage that no estimate contains.
        cost.note(SimulationStage::Library, 0, Duration::from_secs(1));
        cost.note(SimulationStage::Members, 100, Duration::from_secs(1));
        assert!((cost.estimated_s(&grid, neighbours) - 58.0).abs() < 1e-9);
        let twice = GridSettings { torque_factors: vec![0.5, 1.0], ..grid };
        assert!((cost.estimated_s(&twice, neighbours) - 68.0).abs() < 1e-9);
    }
}
