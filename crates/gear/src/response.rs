//! Simulation of a run: from one mesh period to the vibration measured by a sensor at the bearings.

use std::sync::atomic::{AtomicBool, Ordering};

use super::decimator::Decimator;
use super::dynamics::{Excitation, LaneMotion, Lanes, Motion, State};
use super::excitation::{ExcitationLanes, LaneExcitation};
use super::stiff_step::{STAGE_TIMES, STAGES, StiffStep};
use super::transmission_error::{RandomError, long_period_m};
use super::{Errors, GearError, GearPair, MeshCycle, ResponseCoordinate, RunSettings};

/// Number of records simulated in parallel.
const PARALLEL_RECORDS: usize = 8;
/// Smallest number of integration steps per sample; even.
const MIN_OVERSAMPLING: usize = 8;
/// Number of steps between two checks of the stop flag.
const STEPS_PER_STOP_CHECK: i64 = 4096;
/// Largest number of explicit steps per sample: stiffer systems vibrate above the record's band, and use the
/// [implicit method](StiffStep).
const MAX_OVERSAMPLING: usize = 16;
/// Smallest and largest number of implicit steps per sample; even. One costs as much as two explicit steps.
const STIFF_OVERSAMPLING: (usize, usize) = (8, 10);
/// Longest explicit step relative to the reciprocal of the fastest rate.
const STEP_PER_RATE: f64 = 0.4;
/// Smallest distance in shaft rates between mesh lines and images of mesh lines about the step rate.
const CLEAR_SHAFTS: f64 = 4.0;
/// Decay of the start-up transient before the record starts, in nepers.
const SETTLING_NEPERS: f64 = 16.0;
/// Longest start-up in seconds, and in mesh periods.
const MAX_SETTLING_S: f64 = 2.0;
const MAX_SETTLING_PERIODS: f64 = 250.0;

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

struct Run<'a, const LANES: usize> {
    settings: &'a RunSettings,
    response: ResponseCoordinate,
    /// Parameters shared by all lanes, except those in `differing`.
    motion: Motion,
    differing: LaneMotion<LANES>,
    excitation: ExcitationLanes<LANES>,
    common: CommonError<'a>,
    steps: Steps,
    settling_s: f64,
    mesh_hz: f64,
    teeth: f64,
    /// Number of lanes with a record of their own; the others repeat the last one.
    used: usize,
}

impl<'a, const LANES: usize> Run<'a, LANES> {
    /// `cycles` and `motions` have from one to `LANES` entries.
    fn new(
        pair: &'a GearPair,
        cycles: &[&MeshCycle],
        settings: &'a RunSettings,
        motions: &[Motion],
        steps: Steps,
    ) -> Self {
        let used = cycles.len();
        let of_lane = |lane: usize| lane.min(used - 1);
        let lanes: [&MeshCycle; LANES] = std::array::from_fn(|lane| cycles[of_lane(lane)]);
        let decays = motions
            .iter()
            .zip(cycles)
            .map(|(motion, cycle)| motion.slowest_decay(cycle.mean_stiffness_n_per_m()));
        let teeth = f64::from(pair.gears[0].teeth);
        let mesh_hz = settings.shaft_speed_hz * teeth;
        Self {
            settings,
            response: pair.spec.dynamics.response,
            motion: motions[0],
            differing: LaneMotion {
                mesh_damping_n_s_per_m: std::array::from_fn(|lane| {
                    motions[of_lane(lane)].mesh_damping_n_s_per_m
                }),
                backlash_m: std::array::from_fn(|lane| motions[of_lane(lane)].backlash_m),
            },
            excitation: ExcitationLanes::new(&lanes, pair),
            common: CommonError::new(&pair.errors, settings),
            steps,
            settling_s: (SETTLING_NEPERS / decays.fold(f64::INFINITY, f64::min))
                .min(MAX_SETTLING_S)
                .min(MAX_SETTLING_PERIODS / mesh_hz),
            mesh_hz,
            teeth,
            used,
        }
    }

    fn records(mut self, stop: Option<&AtomicBool>) -> Result<Vec<Vec<f64>>, GearError> {
        let samples = (self.settings.seconds * self.settings.sample_rate_hz).round().max(1.0) as usize;
        let step = 1.0 / (self.settings.sample_rate_hz * self.steps.oversampling as f64);
        let stiff = self.steps.stiff.then(|| StiffStep::new(&self.motion, step));
        let mut decimator = Decimator::<LANES>::new(self.steps.oversampling);
        let settling = (self.settling_s / step).ceil() as i64;
        let first = -(decimator.reach() as i64);
        let width = step * self.mesh_hz;

        let mut records: Vec<Vec<f64>> = (0..self.used).map(|_| Vec::with_capacity(samples)).collect();
        let mut n = first - settling;
        let mut phase = self.phase_at(n as f64 * step);
        let mut states = self.at_rest(phase, n as f64 * step);
        let mut start = self.with_common(phase, n as f64 * step);
        let mut positions = [self.response_positions(&states); 2];
        let per_square = 1.0 / (step * step);
        while records[0].len() < samples {
            let seconds = n as f64 * step;
            if n % STEPS_PER_STOP_CHECK == 0 && stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
                return Err(GearError::Stopped);
            }
            let cut = self.excitation.cut_within(phase, width);
            let before = if cut == 0 { [[0.0; LANES]; 6] } else { states };
            let end = match &stiff {
                None => self.explicit_step(&mut states, &start, (phase, seconds), step),
                Some(stiff) => self.stiff_step(&mut states, &start, (phase, seconds), stiff),
            };
            for lane in (0..LANES).filter(|lane| cut >> lane & 1 == 1) {
                let state = self.cut_step(lane, before.map(|row| row[lane]), (phase, seconds), step);
                states.iter_mut().zip(state).for_each(|(row, value)| row[lane] = value);
            }
            (start, phase) = (end, (phase + width).fract());
            let after = self.response_positions(&states);
            if n >= first {
                let acceleration = std::array::from_fn(|lane| {
                    (after[lane] - 2.0 * positions[1][lane] + positions[0][lane]) * per_square
                });
                if let Some(sample) = decimator.push(acceleration) {
                    records.iter_mut().zip(sample).for_each(|(record, value)| record.push(value));
                }
            }
            positions = [positions[1], after];
            n += 1;
        }
        Ok(records)
    }

    /// Performs a step of all lanes by the classical Runge–Kutta method and returns the excitation at its
    /// end.
    #[inline(always)]
    fn explicit_step(
        &mut self,
        states: &mut Lanes<LANES>,
        start: &LaneExcitation<LANES>,
        (phase, seconds): (f64, f64),
        step: f64,
    ) -> LaneExcitation<LANES> {
        let mut at =
            |part: f64| self.with_common((phase + part * step * self.mesh_hz).fract(), seconds + part * step);
        let (middle, end) = (at(0.5), at(1.0));
        self.motion.step_lanes(&self.differing, states, [start, &middle, &end], step);
        end
    }

    /// Performs a step of all lanes by the implicit method and returns the excitation at its end.
    #[inline(always)]
    fn stiff_step(
        &mut self,
        states: &mut Lanes<LANES>,
        start: &LaneExcitation<LANES>,
        (phase, seconds): (f64, f64),
        stiff: &StiffStep,
    ) -> LaneExcitation<LANES> {
        let length = stiff.length();
        let inner: [LaneExcitation<LANES>; STAGES - 1] = std::array::from_fn(|stage| {
            let part = STAGE_TIMES[stage + 1] * length;
            self.with_common((phase + part * self.mesh_hz).fract(), seconds + part)
        });
        let places = std::array::from_fn(|stage| if stage == 0 { start } else { &inner[stage - 1] });
        *states = stiff.advance(&self.motion, &self.differing, states, places);
        inner[STAGES - 2]
    }

    /// Performs a step of one lane from a phase and time on, cut where its pieces of the mesh period end.
    fn cut_step(
        &mut self,
        lane: usize,
        mut state: State,
        (mut phase, mut seconds): (f64, f64),
        step: f64,
    ) -> State {
        let motion = self.motion.of_lane(&self.differing, lane);
        let alone = LaneMotion {
            mesh_damping_n_s_per_m: [motion.mesh_damping_n_s_per_m],
            backlash_m: [motion.backlash_m],
        };
        let pieces = &self.excitation.pieces[lane];
        let mut piece = pieces.iter().position(|piece| phase < piece.end).unwrap_or(0);
        let mut rest = step;
        loop {
            let to_end = (pieces[piece].end - phase) / self.mesh_hz;
            let length = rest.min(to_end);
            if length > 0.0 {
                let mut at = |part: f64| {
                    let mut excitation = pieces[piece].at(phase + part * length * self.mesh_hz);
                    excitation.error += self.common.at(seconds + part * length);
                    excitation
                };
                state = if self.steps.stiff {
                    let stages = STAGE_TIMES.map(|place| {
                        let Excitation { stiffness, error } = at(place);
                        [[stiffness], [error]]
                    });
                    let step = StiffStep::new(&motion, length);
                    step.advance(&motion, &alone, &state.map(|part| [part]), stages.each_ref())
                        .map(|[part]| part)
                } else {
                    motion.step(&state, &[at(0.0), at(0.5), at(1.0)], length)
                };
            }
            if to_end > rest {
                return state;
            }
            seconds += length.max(0.0);
            rest -= length.max(0.0);
            piece = (piece + 1) % pieces.len();
            phase = pieces[piece].start;
        }
    }

    /// Returns the static equilibrium of each lane.
    fn at_rest(&mut self, phase: f64, seconds: f64) -> Lanes<LANES> {
        let common = self.common.at(seconds);
        let mut states = [[0.0; LANES]; 6];
        for lane in 0..LANES {
            let motion =
                Motion { mesh_damping_n_s_per_m: self.differing.mesh_damping_n_s_per_m[lane], ..self.motion };
            let pieces = &self.excitation.pieces[lane];
            let piece = pieces.iter().find(|piece| phase < piece.end).unwrap_or(&pieces[0]);
            let mut excitation = piece.at(phase);
            excitation.error += common;
            let state = motion.at_rest(excitation);
            states.iter_mut().zip(state).for_each(|(row, value)| row[lane] = value);
        }
        states
    }

    /// Returns k and the complete e of Eq. (25) of each lane at a phase, which is that of `seconds`.
    #[inline]
    fn with_common(&mut self, phase: f64, seconds: f64) -> LaneExcitation<LANES> {
        let mut excitation = self.excitation.at(phase);
        let common = self.common.at(seconds);
        for error in &mut excitation[1] {
            *error += common;
        }
        excitation
    }

    /// Returns the mesh phase at a time.
    fn phase_at(&self, seconds: f64) -> f64 {
        let turns = self.settings.start_phase_turns + self.settings.shaft_speed_hz * seconds;
        (turns * self.teeth).rem_euclid(1.0).min(1.0 - 1e-12)
    }

    /// Returns the position in m of the response coordinate in each lane.
    #[inline]
    fn response_positions(&self, [x, y1, y2, ..]: &Lanes<LANES>) -> [f64; LANES] {
        match self.response {
            ResponseCoordinate::Bearing1 => *y1,
            ResponseCoordinate::Bearing2 => *y2,
            ResponseCoordinate::Mesh => std::array::from_fn(|lane| x[lane] - y1[lane] + y2[lane]),
        }
    }
}

/// Errors common to all states in a run: once-per-turn and random error.
struct CommonError<'a> {
    spec: &'a Errors,
    settings: &'a RunSettings,
    random: RandomError,
}

impl<'a> CommonError<'a> {
    fn new(spec: &'a Errors, settings: &'a RunSettings) -> Self {
        Self { spec, settings, random: RandomError::new(spec, settings.seed) }
    }

    /// Returns the error in m at a time.
    #[inline]
    fn at(&mut self, seconds: f64) -> f64 {
        let turns = self.settings.start_phase_turns + self.settings.shaft_speed_hz * seconds;
        long_period_m(self.spec, turns) + self.random.at(seconds)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::{Complex, Matrix3, Vector3};

    use super::super::mesh_cycle::CyclePiece;
    use super::super::testing::{shen2022, shen2022_spec};
    use std::sync::atomic::AtomicBool;

    use super::{Motion, RunSettings, simulate, simulate_refined, simulate_together};
    use crate::{FlankWear, MeshCycle, ResponseCoordinate};

    fn rms(signal: &[f64]) -> f64 {
        (signal.iter().map(|value| value * value).sum::<f64>() / signal.len() as f64).sqrt()
    }

    fn worn(depth_mm: f64) -> (crate::GearPair, MeshCycle) {
        let pair = shen2022();
        let cycle =
            MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth_mm).unwrap(), 1000).unwrap();
        (pair, cycle)
    }

    #[test]
    fn with_constant_stiffness_the_response_is_the_transfer_function() {
        let mut spec = shen2022_spec();
        spec.errors.random_um = Some(0.0);
        spec.errors.long_period_um = Some(0.0);
        let (k, f) = (6e8, 16.64 * 24.0);
        for (response, row) in [
            (ResponseCoordinate::Bearing1, 1),
            (ResponseCoordinate::Bearing2, 2),
            (ResponseCoordinate::Mesh, 3),
        ] {
            spec.dynamics.response = response;
            let pair = spec.resolve().unwrap();
            let mut cycle = MeshCycle::compute(&pair, &FlankWear::none(), 1000).unwrap();
            cycle.pieces = vec![CyclePiece {
                start: 0.0,
                end: 1.0,
                stiffness_n_per_m: vec![k; 1025],
                uste_rad: vec![0.0; 1025],
            }];
            let motion = Motion::new(&pair, &cycle, 1300.0);
            // m_j q̈_j = s_j F_m − support, F_m = (k + iωc)(x − y₁ + y₂ − e), for e = 15 µm e^{iωt}.
            let omega = TAU * f;
            let mesh = Complex::new(k, omega * motion.mesh_damping_n_s_per_m);
            let support =
                Complex::new(motion.support_stiffness_n_per_m, omega * motion.support_damping_n_s_per_m);
            let signs = [1.0, -1.0, 1.0];
            let mut dynamic = Matrix3::from_fn(|i, j| mesh * signs[i] * signs[j]);
            for i in 0..3 {
                dynamic[(i, i)] += -omega * omega / motion.inverse_mass_per_kg[i];
            }
            dynamic[(1, 1)] += support;
            dynamic[(2, 2)] += support;
            let force = Vector3::from_fn(|i, _| mesh * signs[i] * 15e-6);
            let solved = dynamic.lu().solve(&force).unwrap();
            let q = if row == 3 { solved[0] - solved[1] + solved[2] } else { solved[row] };
            let wanted = -omega * omega * q;

            let run = RunSettings::nominal(&pair, 20_000.0, 0.5);
            let signal = simulate(&pair, &cycle, &run).unwrap();
            // e = A sin: the imaginary part of wanted·e^{iωt}.
            let worst = signal.iter().enumerate().map(|(n, value)| {
                (value - (wanted * Complex::from_polar(1.0, omega * n as f64 / 20_000.0)).im).abs()
            });
            let worst = worst.fold(0.0, f64::max);
            assert!(worst < 1e-4 * wanted.norm(), "{response:?}: {worst} of {}", wanted.norm());
        }
    }

    #[test]
    fn halving_the_step_changes_nothing_that_matters() {
        let (pair, cycle) = worn(0.12);
        let settings = RunSettings::nominal(&pair, 20_000.0, 0.25);
        let with = |oversampling| simulate_refined(&pair, &[&cycle], &settings, oversampling).remove(0);
        let (used, halved) = (with(8), with(16));
        let difference: Vec<f64> = used.iter().zip(&halved).map(|(a, b)| a - b).collect();
        assert!(rms(&difference) < 1e-3 * rms(&halved), "{} of {}", rms(&difference), rms(&halved));
        assert!((rms(&used) / rms(&halved) - 1.0).abs() < 2e-4, "{}", rms(&used) / rms(&halved) - 1.0);
    }

    #[test]
    fn no_wear_state_shows_spikes() {
        for depth in [0.0, 0.03, 0.1, 0.245] {
            let (pair, cycle) = worn(depth);
            let signal = simulate(&pair, &cycle, &RunSettings::nominal(&pair, 20_000.0, 1.0)).unwrap();
            assert_eq!(signal.len(), 20_000);
            let mean_square = rms(&signal).powi(2);
            let kurtosis = signal.iter().map(|value| value.powi(4)).sum::<f64>()
                / signal.len() as f64
                / mean_square.powi(2);
            assert!((3.0..25.0).contains(&kurtosis), "kurtosis {kurtosis} at {depth} mm");
            // Every mesh period has its impact: the largest is no outlier of the typical one.
            let mut peaks: Vec<f64> = signal
                .chunks(50)
                .map(|period| period.iter().fold(0.0, |most: f64, value| most.max(value.abs())))
                .collect();
            peaks.sort_by(f64::total_cmp);
            assert!(
                peaks[peaks.len() - 1] < 2.0 * peaks[peaks.len() / 2],
                "{} {}",
                peaks[peaks.len() - 1],
                peaks[peaks.len() / 2]
            );
        }
    }

    #[test]
    fn a_run_may_start_anywhere_in_the_turn() {
        let mut spec = shen2022_spec();
        spec.errors.random_um = Some(0.0);
        let pair = spec.resolve().unwrap();
        let cycle = MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, 0.1).unwrap(), 1000).unwrap();
        let from_zero = simulate(&pair, &cycle, &RunSettings::nominal(&pair, 20_000.0, 0.2)).unwrap();
        let mut run = RunSettings::nominal(&pair, 20_000.0, 0.1);
        run.start_phase_turns = 16.64 * 0.1;
        let later = simulate(&pair, &cycle, &run).unwrap();
        let difference: Vec<f64> = later.iter().zip(&from_zero[2000..]).map(|(a, b)| a - b).collect();
        assert!(rms(&difference) < 1e-5 * rms(&later), "{}", rms(&difference) / rms(&later));
    }

    #[test]
    fn seed_torque_and_speed_are_the_runs_own() {
        let (pair, cycle) = worn(0.05);
        let run = RunSettings::nominal(&pair, 20_000.0, 0.1);
        let base = simulate(&pair, &cycle, &run).unwrap();
        assert_eq!(simulate(&pair, &cycle, &run).unwrap(), base);
        for changed in [
            RunSettings { seed: 2, ..run },
            RunSettings { torque_nm: 900.0, ..run },
            RunSettings { shaft_speed_hz: 15.0, ..run },
        ] {
            assert_ne!(simulate(&pair, &cycle, &changed).unwrap(), base);
        }
        // A longer record begins with the shorter one.
        let longer = simulate(&pair, &cycle, &RunSettings { seconds: 0.15, ..run }).unwrap();
        assert_eq!(&longer[..2000], &base[..]);
    }

    /// Lanes know nothing of each other but for the length of the start-up.
    #[test]
    fn records_simulated_together_equal_single_ones() {
        let pair = shen2022();
        let worn = |depth: f64| {
            MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth).unwrap(), 1000).unwrap()
        };
        let cycles: Vec<MeshCycle> = (0..10).map(|i| worn(0.02 * f64::from(i))).collect();
        let run = RunSettings::nominal(&pair, 20_000.0, 0.05);
        let together = simulate_together(&pair, &cycles.iter().collect::<Vec<_>>(), &run, None).unwrap();
        assert_eq!(together.len(), 10);
        for (cycle, record) in cycles.iter().zip(together) {
            let alone = simulate(&pair, cycle, &run).unwrap();
            let difference: Vec<f64> = alone.iter().zip(&record).map(|(a, b)| a - b).collect();
            assert!(rms(&difference) < 1e-6 * rms(&alone), "{}", rms(&difference) / rms(&alone));
        }
        let stop = AtomicBool::new(true);
        let stopped = simulate_together(&pair, &[&cycles[0]], &run, Some(&stop)).unwrap_err();
        assert!(matches!(stopped, crate::GearError::Stopped));
    }
}
