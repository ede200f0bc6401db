//! Simulating the grid: each state's worn geometry, mesh cycle, response, and features.

use std::sync::atomic::{AtomicUsize, Ordering};

use jiff::Timestamp;
use rayon::prelude::*;
use serde::Serialize;

use super::file::{FORMAT_VERSION, hex};
use super::{CycleTable, GridSettings, Library, LibraryError, LibraryState, Manifest};
use crate::gear::{self, FlankWear, GearPair, MODEL_VERSION, MeshCycle, PairSpec, RunSettings};
use crate::signal::{AnalysisSettings, Analyzer, MeshContext, OperatingPoint, PREPROCESSING, Record};

/// Positions of the mesh cycle that the dynamics use.
const CYCLE_POINTS: usize = 1000;

/// Every how many-th of them is kept in the library for display.
const KEPT_EVERY: usize = 5;

#[derive(Serialize)]
struct Inputs<'a> {
    format: u32,
    model: &'a str,
    preprocessing: &'a str,
    pair: &'a PairSpec,
    grid: &'a GridSettings,
}

/// The name of the library that these inputs give: a hash of all of them, of the model's version and of the file format.
pub fn library_id(pair: &PairSpec, grid: &GridSettings) -> String {
    let inputs = Inputs {
        format: FORMAT_VERSION,
        model: MODEL_VERSION,
        preprocessing: PREPROCESSING,
        pair,
        grid,
    };
    let bytes = serde_json::to_vec(&inputs).expect("numbers, strings and lists always serialise");
    hex(&bytes)[..16].to_owned()
}

/// Simulates every state of the grid, in parallel; `progress` is called with the states done and their number.
///
/// The result depends on the inputs alone, not on the number of threads.
pub fn build(spec: &PairSpec, grid: &GridSettings, progress: &(dyn Fn(usize, usize) + Sync)) -> Result<Library, LibraryError> {
    grid.validate()?;
    let pair = spec.resolve()?;
    let depths_mm: Vec<f64> = (0..grid.states).map(|index| grid.wear_um(index) * 1e-3).collect();
    let worn = FlankWear::from_shape_at(&pair, &depths_mm)?;
    let done = AtomicUsize::new(0);
    let states = (0..grid.states)
        .into_par_iter()
        .map_init(
            || Analyzer::new(AnalysisSettings::default()),
            |analyzer, index| {
                let state = simulate_state(analyzer, spec, &pair, grid, (index, &worn[index]))?;
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, grid.states);
                Ok(state)
            },
        )
        .collect::<Result<Vec<_>, LibraryError>>()?;
    let manifest = Manifest {
        id: library_id(spec, grid),
        model_version: MODEL_VERSION.to_owned(),
        preprocessing: PREPROCESSING.to_owned(),
        pair: spec.clone(),
        grid: *grid,
    };
    Ok(Library::from_parts(manifest, states))
}

fn simulate_state(
    analyzer: &mut Analyzer,
    spec: &PairSpec,
    pair: &GearPair,
    grid: &GridSettings,
    (index, wear): (usize, &FlankWear),
) -> Result<LibraryState, LibraryError> {
    let wear_um = grid.wear_um(index);
    let cycle = MeshCycle::compute(pair, wear, CYCLE_POINTS)?;
    let run = RunSettings {
        sample_rate_hz: grid.sample_rate_hz,
        seconds: grid.seconds,
        shaft_speed_hz: spec.operation.shaft_speed_hz,
        torque_nm: spec.operation.torque_nm,
        seed: grid.seed,
        start_phase_turns: 0.0,
    };
    let response = gear::simulate(pair, &cycle, &run)?;
    let samples = response.iter().map(|&a| a as f32).collect();
    let unusable = |source| LibraryError::Response { index, source };
    let speed = OperatingPoint {
        shaft_speed_hz: Some(run.shaft_speed_hz),
        torque_nm: Some(run.torque_nm),
    };
    let record = Record::new("simulated", Timestamp::UNIX_EPOCH, grid.sample_rate_hz, "m/s2", samples)
        .and_then(|record| record.with_operating_point(speed))
        .map_err(unusable)?;
    let mesh = MeshContext {
        teeth: spec.geometry.teeth[0],
        nominal_shaft_speed_hz: run.shaft_speed_hz,
        tolerance: 0.0,
        nominal_is_exact: true,
    };
    let analysis = analyzer.analyze(&record, &mesh);
    Ok(LibraryState {
        index,
        wear_um,
        indicators: analysis.indicators,
        features: analysis.features,
        cycle: CycleTable::thinned(&cycle),
    })
}

impl GridSettings {
    /// Greatest wear depth of a state in µm.
    pub fn wear_um(&self, index: usize) -> f64 {
        self.max_wear_um * index as f64 / (self.states - 1) as f64
    }

    fn validate(&self) -> Result<(), LibraryError> {
        let refuse = |field, value, expected| Err(LibraryError::Grid { field, value, expected });
        if !(2..=10_000).contains(&self.states) {
            return refuse("states", self.states as f64, "a number from 2 to 10000");
        }
        if !(self.max_wear_um > 0.0 && self.max_wear_um.is_finite()) {
            return refuse("max_wear_um", self.max_wear_um, "a finite depth above 0");
        }
        if !(0.1..=600.0).contains(&self.seconds) {
            return refuse("seconds", self.seconds, "a length from 0.1 to 600 s");
        }
        if !(1000.0..=1e6).contains(&self.sample_rate_hz) {
            return refuse("sample_rate_hz", self.sample_rate_hz, "a rate from 1000 to 1000000 Hz");
        }
        Ok(())
    }
}

impl CycleTable {
    fn thinned(cycle: &MeshCycle) -> Self {
        fn every<T: Copy>(values: &[T]) -> Vec<T> {
            values.iter().copied().step_by(KEPT_EVERY).collect()
        }
        Self {
            phi1_rad: every(&cycle.phi1_rad),
            stiffness_n_per_m: every(&cycle.stiffness_n_per_m),
            uste_rad: every(&cycle.uste_rad),
            pairs_in_contact: every(&cycle.pairs_in_contact),
        }
    }
}
