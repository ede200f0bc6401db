//! A run of the pair: from one mesh period to the vibration that a sensor at the bearings would record.

use super::decimator::Decimator;
use super::dynamics::{Excitation, Motion, State};
use super::error::{positive, within};
use super::excitation::ExcitationPiece;
use super::transmission_error::{RandomError, long_period_m};
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
/// stiffness jumps. Accelerations are second differences of the position over a step, so a jump of the error gives its whole push.
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

struct Run<'a> {
    pair: &'a GearPair,
    settings: &'a RunSettings,
    motion: Motion,
    pieces: Vec<ExcitationPiece>,
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
            pieces: cycle.pieces.iter().map(|piece| ExcitationPiece::new(piece, pair)).collect(),
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
        let mut positions = [self.response_position(&state); 2];
        while record.len() < samples {
            (state, excitation) = self.advance(state, excitation, n as f64 * step, step);
            let after = self.response_position(&state);
            if n >= first
                && let Some(sample) = decimator.push((after - 2.0 * positions[1] + positions[0]) / (step * step))
            {
                record.push(sample);
            }
            positions = [positions[1], after];
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

    /// Place in m of the response's coordinate.
    #[inline]
    fn response_position(&self, [x, y1, y2, ..]: &State) -> f64 {
        match self.pair.spec.dynamics.response {
            ResponseCoordinate::Bearing1 => *y1,
            ResponseCoordinate::Bearing2 => *y2,
            ResponseCoordinate::Mesh => x - y1 + y2,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::{Complex, Matrix3, Vector3};

    use super::super::mesh_cycle::CyclePiece;
    use super::super::testing::{shen2022, shen2022_spec};
    use super::{Motion, Run, RunSettings, simulate};
    use crate::gear::{FlankWear, MeshCycle, ResponseCoordinate};

    fn rms(signal: &[f64]) -> f64 {
        (signal.iter().map(|value| value * value).sum::<f64>() / signal.len() as f64).sqrt()
    }

    fn worn(depth_mm: f64) -> (crate::gear::GearPair, MeshCycle) {
        let pair = shen2022();
        let cycle = MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth_mm).unwrap(), 1000).unwrap();
        (pair, cycle)
    }

    #[test]
    fn with_constant_stiffness_the_response_is_the_transfer_function() {
        let mut spec = shen2022_spec();
        spec.errors.random_um = 0.0;
        spec.errors.long_period_um = 0.0;
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
            let mesh = Complex::new(k, omega * motion.mesh_damping);
            let support = Complex::new(motion.support_stiffness, omega * motion.support_damping);
            let signs = [1.0, -1.0, 1.0];
            let mut dynamic = Matrix3::from_fn(|i, j| mesh * signs[i] * signs[j]);
            for i in 0..3 {
                dynamic[(i, i)] += -omega * omega / motion.inverse_mass[i];
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
            let worst = signal
                .iter()
                .enumerate()
                .map(|(n, value)| (value - (wanted * Complex::from_polar(1.0, omega * n as f64 / 20_000.0)).im).abs());
            let worst = worst.fold(0.0, f64::max);
            assert!(worst < 1e-4 * wanted.norm(), "{response:?}: {worst} of {}", wanted.norm());
        }
    }

    #[test]
    fn halving_the_step_changes_nothing_that_matters() {
        let (pair, cycle) = worn(0.12);
        let settings = RunSettings::nominal(&pair, 20_000.0, 0.25);
        let with = |oversampling| {
            let motion = Motion::new(&pair, &cycle, settings.torque_nm);
            Run::new(&pair, &cycle, &settings, motion, oversampling).record()
        };
        let (used, halved) = (with(8), with(16));
        let difference: Vec<f64> = used.iter().zip(&halved).map(|(a, b)| a - b).collect();
        assert!(rms(&difference) < 1e-3 * rms(&halved), "{} of {}", rms(&difference), rms(&halved));
        assert!(
            (rms(&used) / rms(&halved) - 1.0).abs() < 2e-4,
            "{}",
            rms(&used) / rms(&halved) - 1.0
        );
    }

    #[test]
    fn no_wear_state_shows_spikes() {
        for depth in [0.0, 0.03, 0.1, 0.245] {
            let (pair, cycle) = worn(depth);
            let signal = simulate(&pair, &cycle, &RunSettings::nominal(&pair, 20_000.0, 1.0)).unwrap();
            assert_eq!(signal.len(), 20_000);
            let mean_square = rms(&signal).powi(2);
            let kurtosis = signal.iter().map(|value| value.powi(4)).sum::<f64>() / signal.len() as f64 / mean_square.powi(2);
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
        spec.errors.random_um = 0.0;
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
            RunSettings {
                shaft_speed_hz: 15.0,
                ..run
            },
        ] {
            assert_ne!(simulate(&pair, &cycle, &changed).unwrap(), base);
        }
        // A longer record begins with the shorter one.
        let longer = simulate(&pair, &cycle, &RunSettings { seconds: 0.15, ..run }).unwrap();
        assert_eq!(&longer[..2000], &base[..]);
    }

    #[test]
    fn settings_that_cannot_be_used_are_refused() {
        let (pair, cycle) = worn(0.0);
        let run = RunSettings::nominal(&pair, 20_000.0, 0.1);
        let cases = [
            (
                "sample_rate_hz",
                RunSettings {
                    sample_rate_hz: f64::NAN,
                    ..run
                },
            ),
            (
                "sample_rate_hz",
                RunSettings {
                    sample_rate_hz: 1.0,
                    seconds: 10.0,
                    ..run
                },
            ),
            ("seconds", RunSettings { seconds: 0.0, ..run }),
            ("seconds × sample_rate_hz", RunSettings { seconds: 1e7, ..run }),
            (
                "shaft_speed_hz",
                RunSettings {
                    shaft_speed_hz: -1.0,
                    ..run
                },
            ),
            ("torque_nm", RunSettings { torque_nm: 0.0, ..run }),
            (
                "start_phase_turns",
                RunSettings {
                    start_phase_turns: f64::INFINITY,
                    ..run
                },
            ),
        ];
        for (field, run) in cases {
            let refusal = simulate(&pair, &cycle, &run).unwrap_err().to_string();
            assert!(refusal.starts_with(&format!("{field} is ")), "{refusal}");
        }
    }
}
