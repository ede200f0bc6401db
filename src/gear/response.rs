//! A run of the pair: from one mesh period to the vibration that a sensor at the bearings would record.

use super::decimator::Decimator;
use super::dynamics::{Excitation, Motion, State};
use super::error::{positive, within};
use super::mesh_cycle::CyclePiece;
use super::transmission_error::{RandomError, long_period_m, short_period_m};
use super::{GearError, GearPair, MeshCycle, ResponseCoordinate};

/// Least steps of the integrator for one sample.
const LEAST_OVERSAMPLING: usize = 8;
/// Most steps for one sample: what is stiffer is refused.
const MOST_OVERSAMPLING: f64 = 20_000.0;
/// Longest step as a part of the fastest rate's reciprocal.
const STEP_PER_RATE: f64 = 0.25;
/// Decay of the start-up before the record starts, in nepers.
const SETTLING_NEPERS: f64 = 16.0;
/// Longest start-up in seconds.
const LONGEST_SETTLING_S: f64 = 2.0;
/// Most samples of one run.
const MOST_SAMPLES: f64 = 1e8;

/// One run: what differs from record to record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunSettings {
    /// Samples a second of the record.
    pub sample_rate_hz: f64,
    /// Its length in seconds.
    pub seconds: f64,
    /// Rotational frequency f₁ of the driving gear in hertz.
    pub shaft_speed_hz: f64,
    /// Torque T₁ on the driving gear in N·m; the driven one follows in the pair's proportion.
    pub torque_nm: f64,
    /// Seed of the random error.
    pub seed: u64,
    /// Angle of the driving shaft at the first sample in turns; at 0 a tooth pair is at its nominal start of contact and both sines of Eq. (26) are zero.
    pub start_phase_turns: f64,
}

impl RunSettings {
    /// A run at the pair's own torque, speed and seed from angle 0.
    pub fn nominal(pair: &GearPair, sample_rate_hz: f64, seconds: f64) -> Self {
        Self {
            sample_rate_hz,
            seconds,
            shaft_speed_hz: pair.spec.operation.shaft_speed_hz,
            torque_nm: pair.spec.operation.torque_nm,
            seed: pair.spec.errors.seed,
            start_phase_turns: 0.0,
        }
    }

    fn check(&self) -> Result<(), GearError> {
        positive("sample_rate_hz", self.sample_rate_hz, 1e8)?;
        positive("seconds", self.seconds, 1e8)?;
        positive("shaft_speed_hz", self.shaft_speed_hz, 1e4)?;
        positive("torque_nm", self.torque_nm, 1e9)?;
        within("start_phase_turns", self.start_phase_turns, -1e6, 1e6)?;
        within("seconds × sample_rate_hz", self.seconds * self.sample_rate_hz, 1.0, MOST_SAMPLES)?;
        Ok(())
    }
}

/// Simulates the pair and gives the acceleration in m/s² of its response coordinate at `sample_rate_hz`, start-up removed and low-passed
/// below half the sampling rate (flat to 0.4 of it).
///
/// The integrator's step is at most an eighth of a sample and short against the fastest rate of the system; it ends exactly where the mesh
/// stiffness jumps. A sample is the mean acceleration over a step, so a jump of the error gives its whole push.
///
/// # Errors
/// [`GearError::Field`] for settings that cannot be used.
pub fn simulate(pair: &GearPair, cycle: &MeshCycle, run: &RunSettings) -> Result<Vec<f64>, GearError> {
    run.check()?;
    let motion = Motion::new(pair, cycle, run.torque_nm);
    let mean = cycle.mean_stiffness_n_per_m();
    let greatest = cycle
        .pieces
        .iter()
        .flat_map(|piece| &piece.stiffness_n_per_m)
        .copied()
        .fold(mean, f64::max);
    let needed = motion.fastest_rate(greatest) / STEP_PER_RATE / run.sample_rate_hz;
    if needed > MOST_OVERSAMPLING {
        let least = motion.fastest_rate(greatest) / STEP_PER_RATE / MOST_OVERSAMPLING;
        let expected = format!("at least {least:.1}, the supports and masses being as stiff as they are");
        return Err(GearError::field("sample_rate_hz", run.sample_rate_hz, expected));
    }
    let oversampling = (needed.ceil() as usize).max(LEAST_OVERSAMPLING);
    Ok(Run::new(pair, cycle, run, motion, oversampling).record())
}

/// Excitation over a piece of the mesh period: a table of value and rise of k and of e to the next place.
struct Piece {
    end: f64,
    start: f64,
    places_per_period: f64,
    table: Vec<[f64; 4]>,
}

impl Piece {
    fn new(piece: &CyclePiece, pair: &GearPair) -> Self {
        let count = piece.uste_rad.len() - 1;
        let places_per_period = count as f64 / (piece.end - piece.start);
        let base_m = pair.gears[1].base_radius_mm * 1e-3;
        let at = |i: usize| {
            let short = short_period_m(&pair.spec.errors, piece.start + i as f64 / places_per_period);
            [piece.stiffness_n_per_m[i], base_m * piece.uste_rad[i] + short]
        };
        let table = (0..count)
            .map(|i| {
                let ([k, e], [next_k, next_e]) = (at(i), at(i + 1));
                [k, next_k - k, e, next_e - e]
            })
            .collect();
        Self {
            end: piece.end,
            start: piece.start,
            places_per_period,
            table,
        }
    }

    #[inline]
    fn at(&self, phase: f64) -> Excitation {
        let place = (phase - self.start) * self.places_per_period;
        let cell = (place as usize).min(self.table.len() - 1);
        let [k, k_rise, e, e_rise] = self.table[cell];
        let part = place - cell as f64;
        Excitation {
            stiffness: k + part * k_rise,
            error: e + part * e_rise,
        }
    }
}

struct Run<'a> {
    pair: &'a GearPair,
    settings: &'a RunSettings,
    motion: Motion,
    pieces: Vec<Piece>,
    random: RandomError,
    oversampling: usize,
    mean_stiffness: f64,
    /// Piece of the mesh period, and place in mesh periods, reached.
    piece: usize,
    phase: f64,
}

impl<'a> Run<'a> {
    fn new(pair: &'a GearPair, cycle: &MeshCycle, settings: &'a RunSettings, motion: Motion, oversampling: usize) -> Self {
        Self {
            pair,
            settings,
            motion,
            pieces: cycle.pieces.iter().map(|piece| Piece::new(piece, pair)).collect(),
            random: RandomError::new(&pair.spec.errors, settings.seed),
            oversampling,
            mean_stiffness: cycle.mean_stiffness_n_per_m(),
            piece: 0,
            phase: 0.0,
        }
    }

    fn record(mut self) -> Vec<f64> {
        let samples = (self.settings.seconds * self.settings.sample_rate_hz).round().max(1.0) as usize;
        let step = 1.0 / (self.settings.sample_rate_hz * self.oversampling as f64);
        let mut decimator = Decimator::new(self.oversampling);
        let settling_s = (SETTLING_NEPERS / self.motion.slowest_decay(self.mean_stiffness)).min(LONGEST_SETTLING_S);
        let settling = (settling_s / step).ceil() as i64;
        let first = -(decimator.reach() as i64);

        let mut record = Vec::with_capacity(samples);
        let mut n = first - settling;
        self.seek(n as f64 * step);
        let mut excitation = self.excitation(n as f64 * step);
        let mut state = self.motion.at_rest(excitation);
        let mut velocity = self.response_velocity(&state, excitation.error);
        while record.len() < samples {
            (state, excitation) = self.advance(state, excitation, n as f64 * step, step);
            let reached = self.response_velocity(&state, excitation.error);
            if n >= first
                && let Some(sample) = decimator.push((reached - velocity) / step)
            {
                record.push(sample);
            }
            velocity = reached;
            n += 1;
        }
        record
    }

    /// One step from `seconds` on, cut where a piece of the mesh period ends.
    #[inline]
    fn advance(&mut self, mut state: State, mut excitation: Excitation, mut seconds: f64, step: f64) -> (State, Excitation) {
        let mesh_hz = self.settings.shaft_speed_hz * f64::from(self.pair.gears[0].teeth);
        let mut rest = step;
        loop {
            let to_end = (self.pieces[self.piece].end - self.phase) / mesh_hz;
            if to_end > rest {
                (state, excitation) = self.smooth_step(state, excitation, seconds, rest, mesh_hz);
                return (state, excitation);
            }
            if to_end > 0.0 {
                (state, _) = self.smooth_step(state, excitation, seconds, to_end, mesh_hz);
                seconds += to_end;
                rest -= to_end;
            }
            self.piece = (self.piece + 1) % self.pieces.len();
            self.phase = self.pieces[self.piece].start;
            excitation = self.excitation(seconds);
        }
    }

    /// A step within one piece.
    #[inline]
    fn smooth_step(&mut self, state: State, start: Excitation, seconds: f64, step: f64, mesh_hz: f64) -> (State, Excitation) {
        let from = self.phase;
        self.phase = from + 0.5 * step * mesh_hz;
        let middle = self.excitation(seconds + 0.5 * step);
        self.phase = from + step * mesh_hz;
        let end = self.excitation(seconds + step);
        (self.motion.step(&state, &[start, middle, end], step), end)
    }

    /// k and the whole e of Eq. (25) at the phase reached, which is that of `seconds`.
    #[inline]
    fn excitation(&mut self, seconds: f64) -> Excitation {
        let mut excitation = self.pieces[self.piece].at(self.phase);
        let turns = self.settings.start_phase_turns + self.settings.shaft_speed_hz * seconds;
        excitation.error += long_period_m(&self.pair.spec.errors, turns) + self.random.at(seconds);
        excitation
    }

    /// Puts the phase where it is at `seconds`.
    fn seek(&mut self, seconds: f64) {
        let turns = self.settings.start_phase_turns + self.settings.shaft_speed_hz * seconds;
        self.phase = (turns * f64::from(self.pair.gears[0].teeth)).rem_euclid(1.0).min(1.0 - 1e-12);
        self.piece = self.pieces.iter().position(|piece| self.phase < piece.end).unwrap_or(0);
    }

    #[inline]
    fn response_velocity(&self, state: &State, error: f64) -> f64 {
        let [x, y1, y2] = self.motion.velocities(state, error);
        match self.pair.spec.dynamics.response {
            ResponseCoordinate::Bearing1 => y1,
            ResponseCoordinate::Bearing2 => y2,
            ResponseCoordinate::Mesh => x - y1 + y2,
        }
    }
}
