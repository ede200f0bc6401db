//! Simulation of the grid: each wear state's geometry, its mesh cycle at each torque, its response at each
//! speed, and its features.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use jiff::Timestamp;
use rayon::prelude::*;
use serde::Serialize;

use super::control::{BuildControl, Counter};
use super::file::{FORMAT_VERSION, hex};
use super::operating::{FeatureCurves, curves, state_curves};
use super::part::Part;
use super::{CycleTable, GridSettings, Library, LibraryError, LibraryState, Manifest};
use flankwatch_gear::{
    ContactRule, ElasticBodies, FlankWear, GearPair, MODEL_VERSION, MeshCycle, PairSpec, RunSettings,
};
use flankwatch_signal::{
    Analysis, AnalysisSettings, Analyzer, MeshContext, OperatingPoint, PREPROCESSING, Precision, Record,
    RecordError,
};

/// Positions of the mesh cycle that the dynamics use.
const CYCLE_POINTS: usize = 1000;

/// Stride of the positions that the library stores for display.
const CYCLE_STRIDE: usize = 5;

/// Most wear states of a part, the unit of work in a checkpoint.
const PART_STATES: usize = 8;

#[derive(Serialize)]
struct Inputs<'a> {
    format: u32,
    model: &'a str,
    preprocessing: &'a str,
    pair: &'a PairSpec,
    grid: &'a GridSettings,
}

/// Returns the id of a library: a hash of its inputs, of the model's version and of the file format.
pub fn library_id(pair: &PairSpec, grid: &GridSettings) -> String {
    let inputs =
        Inputs { format: FORMAT_VERSION, model: MODEL_VERSION, preprocessing: PREPROCESSING, pair, grid };
    let bytes = serde_json::to_vec(&inputs).expect("numbers, strings and lists always serialise");
    hex(&bytes)[..16].to_owned()
}

/// Simulates every point of the grid, in parallel.
///
/// The result depends on the inputs alone, not on the number of threads or on whether the build was
/// interrupted and resumed.
///
/// # Errors
/// [`LibraryError::Grid`] and [`LibraryError::Gear`] for inputs that cannot be simulated,
/// [`LibraryError::Cancelled`], and an I/O error for a checkpoint that cannot be written.
pub fn build(
    spec: &PairSpec,
    grid: &GridSettings,
    control: &BuildControl<'_>,
) -> Result<Library, LibraryError> {
    grid.validate()?;
    let pair = spec.resolve()?;
    let depths_mm: Vec<f64> = (0..grid.states).map(|index| grid.wear_um(index) * 1e-3).collect();
    let id = library_id(spec, grid);
    let finished = control.checkpoint().map_or(Ok(Vec::new()), |checkpoint| checkpoint.open(&id))?;
    let build = Build {
        grid,
        worn: FlankWear::from_shape_at(&pair, &depths_mm)?,
        pair,
        control,
        counter: Counter::new(control, grid.simulations()),
        analyzers: Mutex::default(),
    };
    let parts = build.parts(finished)?;
    let manifest = Manifest {
        id,
        model_version: MODEL_VERSION.to_owned(),
        preprocessing: PREPROCESSING.to_owned(),
        pair: spec.clone(),
        grid: grid.clone(),
    };
    Ok(assemble(manifest, parts))
}

struct Build<'a> {
    grid: &'a GridSettings,
    pair: GearPair,
    worn: Vec<FlankWear>,
    control: &'a BuildControl<'a>,
    counter: Counter<'a>,
    /// Idle analyzers, reused for their transforms' plans.
    analyzers: Mutex<Vec<Analyzer>>,
}

impl Build<'_> {
    /// Returns all parts by torque and first state; `finished` are those of an earlier build.
    fn parts(&self, finished: Vec<Part>) -> Result<Vec<Part>, LibraryError> {
        let finished: BTreeMap<(usize, usize), Part> =
            finished.into_iter().map(|part| ((part.first, part.torque), part)).collect();
        let groups = self.grid.states.div_ceil(PART_STATES);
        let start = |group: usize| group * self.grid.states / groups;
        let mut parts: Vec<Part> = (0..groups)
            .into_par_iter()
            .map(|group| self.group(start(group)..start(group + 1), &finished))
            .collect::<Result<Vec<_>, LibraryError>>()?
            .into_iter()
            .flatten()
            .collect();
        parts.sort_by_key(|part| (part.torque, part.first));
        Ok(parts)
    }

    /// Returns the parts of neighbouring wear states, whose bodies are computed once for all torques.
    fn group(
        &self,
        states: Range<usize>,
        finished: &BTreeMap<(usize, usize), Part>,
    ) -> Result<Vec<Part>, LibraryError> {
        let mut bodies: Option<Vec<Option<ElasticBodies>>> = None;
        let mut parts = Vec::with_capacity(self.grid.torque_factors.len());
        for torque in 0..self.grid.torque_factors.len() {
            if let Some(part) = finished.get(&(states.start, torque)).filter(|part| self.fits(part, &states))
            {
                self.counter.add(states.len() * self.grid.speed_factors.len());
                parts.push(part.clone());
                continue;
            }
            let bodies = match &bodies {
                Some(bodies) => bodies,
                None => bodies.insert(self.bodies(states.clone())?),
            };
            let part = self.part(states.clone(), torque, bodies)?;
            if let Some(checkpoint) = self.control.checkpoint() {
                checkpoint.add(&part)?;
            }
            parts.push(part);
        }
        Ok(parts)
    }

    fn fits(&self, part: &Part, states: &Range<usize>) -> bool {
        let nominal = self.grid.torque_factors[part.torque] == 1.0;
        part.states.len() == if nominal { states.len() } else { 0 }
            && part.features.len() == self.grid.speed_factors.len()
            && part.features.iter().all(|features| features.len() == states.len())
    }

    fn bodies(&self, states: Range<usize>) -> Result<Vec<Option<ElasticBodies>>, LibraryError> {
        let loaded = self.pair.spec.dynamics.contact == ContactRule::Loaded;
        self.worn[states]
            .par_iter()
            .map(|wear| {
                self.control.check()?;
                Ok(loaded.then(|| ElasticBodies::new(&self.pair, wear)).transpose()?)
            })
            .collect()
    }

    fn part(
        &self,
        states: Range<usize>,
        torque: usize,
        bodies: &[Option<ElasticBodies>],
    ) -> Result<Part, LibraryError> {
        let factor = self.grid.torque_factors[torque];
        let pair = self.pair.spec.with_torque(factor).resolve()?;
        let cycles: Vec<MeshCycle> = self.worn[states.clone()]
            .par_iter()
            .zip(bodies)
            .map(|(wear, bodies)| {
                self.control.check()?;
                Ok(match bodies {
                    Some(bodies) => MeshCycle::loaded(&pair, bodies, wear, CYCLE_POINTS)?,
                    None => MeshCycle::compute(&pair, wear, CYCLE_POINTS)?,
                })
            })
            .collect::<Result<_, LibraryError>>()?;
        let mut part = Part {
            first: states.start,
            torque,
            states: Vec::new(),
            features: Vec::with_capacity(self.grid.speed_factors.len()),
        };
        for speed_factor in &self.grid.speed_factors {
            let run = RunSettings {
                sample_rate_hz: self.grid.sample_rate_hz,
                seconds: self.grid.seconds,
                shaft_speed_hz: pair.spec.operation.shaft_speed_hz * speed_factor,
                torque_nm: pair.spec.operation.torque_nm,
                seed: self.grid.seed,
                start_phase_turns: 0.0,
            };
            let analyses = self.analyses(&pair, &cycles, &run, states.start)?;
            if factor == 1.0 && *speed_factor == 1.0 {
                let whole = analyses.iter().zip(&cycles).zip(states.clone());
                part.states = whole
                    .map(|((analysis, cycle), index)| LibraryState {
                        index,
                        wear_um: self.grid.wear_um(index),
                        driving_turns: self.worn[index].driving_turns(),
                        indicators: analysis.indicators.clone(),
                        features: analysis.features.clone(),
                        cycle: CycleTable::thinned(cycle),
                    })
                    .collect();
            }
            part.features.push(analyses.into_iter().map(|analysis| analysis.features).collect());
        }
        Ok(part)
    }

    /// Simulates and analyses responses to neighbouring states' cycles; `first` is the first one's index.
    fn analyses(
        &self,
        pair: &GearPair,
        cycles: &[MeshCycle],
        run: &RunSettings,
        first: usize,
    ) -> Result<Vec<Analysis>, LibraryError> {
        let cycles: Vec<&MeshCycle> = cycles.iter().collect();
        let responses = flankwatch_gear::simulate_together(pair, &cycles, run, self.control.cancel())?;
        let analyses = responses
            .into_par_iter()
            .enumerate()
            .map(|(i, response)| self.analyze(run, &response, first + i))
            .collect::<Result<_, LibraryError>>()?;
        self.counter.add(cycles.len());
        Ok(analyses)
    }

    fn analyze(&self, run: &RunSettings, response: &[f64], index: usize) -> Result<Analysis, LibraryError> {
        let lock = || self.analyzers.lock().unwrap_or_else(PoisonError::into_inner);
        let idle = lock().pop();
        // A simulated record has no noise to hide the rounding of single precision.
        let settings = AnalysisSettings { precision: Precision::Double, ..AnalysisSettings::default() };
        let mut analyzer = idle.unwrap_or_else(|| Analyzer::new(settings));
        let analysis = analyze(&mut analyzer, self.pair.gears[0].teeth, run, response);
        lock().push(analyzer);
        analysis.map_err(|source| LibraryError::Response { index, source })
    }
}

/// Analyses a response in m/s².
pub(super) fn analyze(
    analyzer: &mut Analyzer,
    teeth: u32,
    run: &RunSettings,
    response: &[f64],
) -> Result<Analysis, RecordError> {
    let mesh = MeshContext::at_exact_speed([teeth, 0], run.shaft_speed_hz);
    Ok(analyzer.analyze(&response_record(run, response)?, &mesh))
}

/// Makes a record of a simulated response in m/s².
pub fn response_record(run: &RunSettings, response: &[f64]) -> Result<Record, RecordError> {
    let samples = response.iter().map(|&a| a as f32).collect();
    let point = OperatingPoint {
        shaft_speed_hz: Some(run.shaft_speed_hz),
        torque_nm: Some(run.torque_nm),
        ..OperatingPoint::default()
    };
    Record::new("simulated", Timestamp::UNIX_EPOCH, run.sample_rate_hz, "m/s2", samples)?
        .with_operating_point(point)
}

/// Assembles the parts, sorted by torque and first state.
fn assemble(manifest: Manifest, parts: Vec<Part>) -> Library {
    let grid = &manifest.grid;
    if grid.operating_points() == 1 {
        let states: Vec<LibraryState> = parts.into_iter().flat_map(|part| part.states).collect();
        let tables = vec![state_curves(&states)];
        return Library::from_parts(manifest, states, tables);
    }
    let mut tables: Vec<FeatureCurves> = Vec::with_capacity(grid.operating_points());
    for torque in 0..grid.torque_factors.len() {
        let here: Vec<&Part> = parts.iter().filter(|part| part.torque == torque).collect();
        for speed in 0..grid.speed_factors.len() {
            tables.push(curves(here.iter().flat_map(|part| &part.features[speed])));
        }
    }
    let states = parts.into_iter().flat_map(|part| part.states).collect();
    Library::from_parts(manifest, states, tables)
}

impl CycleTable {
    fn thinned(cycle: &MeshCycle) -> Self {
        fn every<T: Copy>(values: &[T]) -> Vec<T> {
            values.iter().copied().step_by(CYCLE_STRIDE).collect()
        }
        Self {
            phi1_rad: every(&cycle.phi1_rad),
            stiffness_n_per_m: every(&cycle.stiffness_n_per_m),
            uste_rad: every(&cycle.uste_rad),
            pairs_in_contact: every(&cycle.pairs_in_contact),
        }
    }
}
