//! Simulation of a run: from one mesh period to the vibration measured by a sensor at the bearings.

mod run;
#[cfg(test)]
mod tests;

use std::sync::atomic::AtomicBool;

use run::Run;

use super::dynamics::Motion;
use super::{GearError, GearPair, MeshCycle, RunSettings};

/// Number of records simulated in parallel.
const PARALLEL_RECORDS: usize = 8;
/// Smallest number of integration steps per sample; even.
const MIN_OVERSAMPLING: usize = 8;
/// Largest number of explicit steps per sample: stiffer systems vibrate above the record's band, and use the
/// [implicit method](super::stiff_step).
const MAX_OVERSAMPLING: usize = 16;
/// Smallest and largest number of implicit steps per sample; even. One costs as much as two explicit steps.
const STIFF_OVERSAMPLING: (usize, usize) = (8, 10);
/// Longest explicit step relative to the reciprocal of the fastest rate.
const STEP_PER_RATE: f64 = 0.4;
/// Smallest distance in shaft rates between mesh lines and images of mesh lines about the step rate.
const CLEAR_SHAFTS: f64 = 4.0;

/// Simulates the pair and returns the acceleration in m/s² of its response coordinate at `sample_rate_hz`,
/// without the start-up, low-passed below half the sampling rate (flat to 0.4 of it).
///
/// The integrator's step is at most an eighth of a sample. An explicit step resolves the fastest rate of the
/// system if a sixteenth of a sample suffices; otherwise an unconditionally stable method is used. The step
/// ends exactly at jumps of the mesh stiffness. Accelerations are second differences of the position over a
/// step, so a jump of the error contributes its whole impulse.
///
/// # Errors
/// [`GearError::Field`] for invalid settings; [`GearError::Unstable`] for vibration that grows without bound.
pub fn simulate(pair: &GearPair, cycle: &MeshCycle, run: &RunSettings) -> Result<Vec<f64>, GearError> {
    let mut records = simulate_together(pair, &[cycle], run, None)?;
    Ok(records.pop().unwrap_or_default())
}

/// Simulates the same run with several mesh cycles of one pair in parallel, which is faster than one by one,
/// and returns one record per cycle as [`simulate`] does. If supports or damping require a shorter step or a
/// longer start-up, all records use those of the most demanding one.
///
/// # Errors
/// [`GearError::Field`] for invalid settings; [`GearError::Unstable`] for vibration that grows without bound;
/// [`GearError::Stopped`] soon after `stop` becomes true.
pub fn simulate_together(
    pair: &GearPair,
    cycles: &[&MeshCycle],
    run: &RunSettings,
    stop: Option<&AtomicBool>,
) -> Result<Vec<Vec<f64>>, GearError> {
    run.check()?;
    let mut records = Vec::with_capacity(cycles.len());
    for together in cycles.chunks(PARALLEL_RECORDS) {
        let motions = motions(pair, together, run);
        let steps = Steps::of(f64::from(pair.gears[0].teeth), together, &motions, run);
        records.extend(match together {
            [_] => Run::<1>::new(pair, together, run, &motions, steps).records(stop)?,
            _ => Run::<PARALLEL_RECORDS>::new(pair, together, run, &motions, steps).records(stop)?,
        });
    }
    // Once a record is not finite, it stays so.
    if records.iter().any(|record| record.last().is_some_and(|sample| !sample.is_finite())) {
        let shaft_speed_hz = run.shaft_speed_hz;
        return Err(GearError::Unstable { shaft_speed_hz });
    }
    Ok(records)
}

/// Like [`simulate_together`] for at most 8 cycles with `oversampling` explicit steps per sample.
#[cfg(test)]
pub(crate) fn simulate_refined(
    pair: &GearPair,
    cycles: &[&MeshCycle],
    run: &RunSettings,
    oversampling: usize,
) -> Vec<Vec<f64>> {
    let steps = Steps { oversampling, stiff: false };
    let run = Run::<PARALLEL_RECORDS>::new(pair, cycles, run, &motions(pair, cycles, run), steps);
    run.records(None).unwrap()
}

/// Returns whether [`simulate_together`] uses implicit steps.
#[cfg(test)]
pub(crate) fn is_stiff(pair: &GearPair, cycles: &[&MeshCycle], run: &RunSettings) -> bool {
    Steps::of(f64::from(pair.gears[0].teeth), cycles, &motions(pair, cycles, run), run).stiff
}

fn motions(pair: &GearPair, cycles: &[&MeshCycle], run: &RunSettings) -> Vec<Motion> {
    cycles.iter().map(|cycle| Motion::new(pair, cycle, run.torque_nm)).collect()
}

/// Integration steps of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Steps {
    /// Steps per sample; even.
    oversampling: usize,
    /// Whether the steps are implicit.
    stiff: bool,
}

impl Steps {
    /// Selects the smallest number of steps that resolves the system, or its part within the record's band,
    /// and keeps images of mesh lines away from mesh lines. There lie the shaft sidebands of worn gears,
    /// weaker by a factor of a million than the impacts. If no allowed number does, the longest step is used.
    fn of(teeth: f64, cycles: &[&MeshCycle], motions: &[Motion], run: &RunSettings) -> Self {
        let fastest = cycles.iter().zip(motions).map(|(cycle, motion)| {
            let stiffness = cycle.pieces.iter().flat_map(|piece| &piece.stiffness_n_per_m);
            motion.fastest_rate(stiffness.copied().fold(0.0, f64::max))
        });
        let needed = fastest.fold(0.0, f64::max) / STEP_PER_RATE / run.sample_rate_hz;
        let stiff = needed > MAX_OVERSAMPLING as f64;
        let resolved = (needed.ceil() as usize).next_multiple_of(2);
        let (least, most) =
            if stiff { STIFF_OVERSAMPLING } else { (resolved.max(MIN_OVERSAMPLING), MAX_OVERSAMPLING) };
        let is_clear = |oversampling: &usize| {
            // Steps and their middles.
            [1.0, 2.0].iter().all(|part| {
                let mesh_lines =
                    part * *oversampling as f64 * run.sample_rate_hz / (run.shaft_speed_hz * teeth);
                (mesh_lines - mesh_lines.round()).abs() * teeth > CLEAR_SHAFTS
            })
        };
        Self { oversampling: (least..=most).step_by(2).find(is_clear).unwrap_or(least), stiff }
    }
}
