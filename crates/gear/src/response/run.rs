//! Integration of a run: several mesh cycles side by side, from rest to the end of their records.

use std::sync::atomic::{AtomicBool, Ordering};

use super::Steps;
use crate::decimator::Decimator;
use crate::dynamics::{LaneMotion, Lanes, Motion};
use crate::excitation::{ExcitationLanes, LaneExcitation};
use crate::stiff_step::{STAGE_TIMES, STAGES, StiffStep};
use crate::transmission_error::{LongPeriodError, RandomError};
use crate::{Errors, GearError, GearPair, MeshCycle, ResponseCoordinate, RunSettings};

/// Number of steps between two checks of the stop flag.
const STEPS_PER_STOP_CHECK: i64 = 4096;
/// Decay of the start-up transient before the record starts, in nepers.
const SETTLING_NEPERS: f64 = 16.0;
/// Longest start-up in seconds, and in mesh periods.
const MAX_SETTLING_S: f64 = 2.0;
const MAX_SETTLING_PERIODS: f64 = 250.0;

/// A run of up to `LANES` mesh cycles of one pair.
pub(super) struct Run<'a, const LANES: usize> {
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
    pub(super) fn new(
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

    /// Integrates until each lane has its record.
    pub(super) fn records(mut self, stop: Option<&AtomicBool>) -> Result<Vec<Vec<f64>>, GearError> {
        let samples = (self.settings.seconds * self.settings.sample_rate_hz).round().max(1.0) as usize;
        let step = 1.0 / (self.settings.sample_rate_hz * self.steps.oversampling as f64);
        let stiff = self.steps.stiff.then(|| StiffStep::new(&self.motion, [step; LANES]));
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
            let cut = self.excitation.cut_within(phase, width) & ((1 << LANES) - 1);
            let end = match &stiff {
                _ if cut != 0 => self.cut_step(cut, &mut states, &start, (phase, seconds), step),
                None => self.explicit_step(&mut states, &start, (phase, seconds), step),
                Some(stiff) => self.stiff_step(&mut states, &start, (phase, seconds), stiff, step),
            };
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
        self.motion.step_lanes(&self.differing, states, [start, &middle, &end], &[step; LANES]);
        end
    }

    /// Performs a step of all lanes by the implicit method and returns the excitation at its end.
    #[inline(always)]
    fn stiff_step(
        &mut self,
        states: &mut Lanes<LANES>,
        start: &LaneExcitation<LANES>,
        (phase, seconds): (f64, f64),
        stiff: &StiffStep<LANES>,
        length: f64,
    ) -> LaneExcitation<LANES> {
        let mut at = |stage: usize| {
            let part = STAGE_TIMES[stage] * length;
            self.with_common((phase + part * self.mesh_hz).fract(), seconds + part)
        };
        // One by one: as an array they would be moved.
        let (second, third, end) = (at(1), at(2), at(3));
        *states = stiff.advance(&self.motion, &self.differing, states, [start, &second, &third, &end]);
        end
    }

    /// Performs a step of all lanes and returns the excitation at its end. Lanes in `cut` (bits) stop where
    /// their own pieces of the mesh period end, and do the rest of the step after it.
    fn cut_step(
        &mut self,
        cut: u32,
        states: &mut Lanes<LANES>,
        start: &LaneExcitation<LANES>,
        (phase, seconds): (f64, f64),
        step: f64,
    ) -> LaneExcitation<LANES> {
        let is_stiff = self.steps.stiff;
        let mut left = [Rest { piece: 0, phase, seconds, rest: step }; LANES];
        for lane in lanes_of(cut) {
            let pieces = &self.excitation.pieces[lane];
            left[lane].piece = pieces.iter().position(|piece| phase < piece.end).unwrap_or(0);
        }
        let mut at =
            |part: f64| self.with_common((phase + part * step * self.mesh_hz).fract(), seconds + part * step);
        let uncut: [LaneExcitation<LANES>; STAGES] = if is_stiff {
            let [_, second, third, end] = STAGE_TIMES;
            [*start, at(second), at(third), at(end)]
        } else {
            let end = at(1.0);
            [*start, at(0.5), end, end]
        };
        let mut unfinished = cut;
        let mut lengths = [step; LANES];
        let mut excitation = uncut;
        loop {
            let mut to_end = [0.0; LANES];
            for lane in lanes_of(unfinished) {
                let Rest { piece, phase, rest, .. } = left[lane];
                to_end[lane] = (self.excitation.pieces[lane][piece].end - phase) / self.mesh_hz;
                lengths[lane] = rest.min(to_end[lane]).max(0.0);
            }
            self.part_step(unfinished, states, &left, &lengths, &mut excitation);
            for lane in lanes_of(unfinished) {
                let (pieces, lane_left) = (&self.excitation.pieces[lane], &mut left[lane]);
                if to_end[lane] > lane_left.rest {
                    unfinished &= !(1 << lane);
                }
                lane_left.seconds += lengths[lane];
                lane_left.rest -= lengths[lane];
                lane_left.piece = (lane_left.piece + 1) % pieces.len();
                lane_left.phase = pieces[lane_left.piece].start;
            }
            if unfinished == 0 {
                return uncut[STAGES - 1];
            }
            // Lanes that are at the end of the step stay there.
            lengths = [0.0; LANES];
        }
    }

    /// Performs steps of different lengths. Those of `lanes` are each within one piece, and their excitation
    /// is computed; the excitation of the others is known.
    fn part_step(
        &mut self,
        lanes: u32,
        states: &mut Lanes<LANES>,
        left: &[Rest; LANES],
        lengths: &[f64; LANES],
        excitation: &mut [LaneExcitation<LANES>; STAGES],
    ) {
        if self.steps.stiff {
            for (stage, part) in excitation.iter_mut().zip(STAGE_TIMES) {
                self.excite(lanes, left, lengths, part, stage);
            }
            let step = StiffStep::new(&self.motion, *lengths);
            *states = step.advance(&self.motion, &self.differing, states, excitation.each_ref());
        } else {
            let [start, middle, end, _] = excitation;
            self.excite(lanes, left, lengths, 0.0, start);
            self.excite(lanes, left, lengths, 0.5, middle);
            self.excite(lanes, left, lengths, 1.0, end);
            self.motion.step_lanes(&self.differing, states, [start, middle, end], lengths);
        }
    }

    /// Sets k and the complete e of lanes at a part of their steps.
    #[inline(always)]
    fn excite(
        &mut self,
        lanes: u32,
        left: &[Rest; LANES],
        lengths: &[f64; LANES],
        part: f64,
        [stiffness, error]: &mut LaneExcitation<LANES>,
    ) {
        for lane in lanes_of(lanes) {
            let (Rest { piece, phase, seconds, .. }, length) = (left[lane], part * lengths[lane]);
            let own = self.excitation.pieces[lane][piece].at(phase + length * self.mesh_hz);
            stiffness[lane] = own.stiffness;
            error[lane] = own.error + self.common.at(seconds + length);
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
    #[inline(always)]
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

/// What remains of a lane's step: from which phase and time on, in which piece, and how long in seconds.
#[derive(Debug, Clone, Copy)]
struct Rest {
    piece: usize,
    phase: f64,
    seconds: f64,
    rest: f64,
}

/// The lanes whose bits are set.
fn lanes_of(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = (bits != 0).then(|| bits.trailing_zeros() as usize);
        bits &= bits.wrapping_sub(1);
        lane
    })
}

/// Errors common to all states in a run: once-per-turn and random error.
struct CommonError<'a> {
    settings: &'a RunSettings,
    long_period: LongPeriodError,
    random: RandomError,
}

impl<'a> CommonError<'a> {
    fn new(spec: &Errors, settings: &'a RunSettings) -> Self {
        Self {
            settings,
            long_period: LongPeriodError::new(spec),
            random: RandomError::new(spec, settings.seed),
        }
    }

    /// Returns the error in m at a time.
    #[inline]
    fn at(&mut self, seconds: f64) -> f64 {
        let turns = self.settings.start_phase_turns + self.settings.shaft_speed_hz * seconds;
        self.long_period.at(turns) + self.random.at(seconds)
    }
}
