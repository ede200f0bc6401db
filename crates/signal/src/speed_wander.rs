//! A first idea of how a shaft's speed wanders within a record, from all mesh harmonics together.
//!
//! Where the speed swings by half a per cent, a high harmonic is smeared over many bins and none stands out
//! over the record, while the low ones may lie in the noise. In a window of a few turns the speed is a line
//! over time: for each pair of a speed and its rate of change, all harmonics' energies are added up, each
//! over its own noise, and the path through the windows that goes on smoothly with the highest sum is taken.

use std::f64::consts::TAU;

use realfft::num_complex::Complex;

use super::mesh_phase::MeshBand;
use super::transform::Transforms;

/// Harmonics that are added up.
const HARMONICS: usize = 10;

/// Length of a window and the distance between two in turns.
const WINDOW_TURNS: f64 = 3.5;
const HOP_TURNS: f64 = 1.0;

/// Greatest deviation of the speed from the given one, as a part, and the distance between two candidates.
const REACH: f64 = 0.012;
const SPEEDS: usize = 49;

/// Greatest rate of change as a part a second, for each hertz of the shaft: half a per cent swinging at a
/// tenth of the shaft rate.
const RATE_PER_HZ: f64 = 0.0032;
const RATES: usize = 9;

/// Candidates by which the speed may depart from where its rate of change leads.
const SLACK: i64 = 1;

/// The mean over windows of the path's score over that of a typical path, in nats, that says that something
/// was followed.
const MIN_GAIN: f64 = 2.0;

/// Periods of the mesh that the shaft is ahead of the constant speed `mesh_hz`, at even times over the
/// record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SpeedWander {
    ahead: Vec<f64>,
}

impl SpeedWander {
    /// `None` where no path stands out, or the record is shorter than three windows.
    pub(super) fn of(band: &MeshBand<'_>, transforms: &mut Transforms) -> Option<Self> {
        let duration_s = band.length as f64 / band.sample_rate_hz;
        let shaft_hz = band.mesh_hz / f64::from(band.teeth);
        let windows = ((duration_s * shaft_hz - WINDOW_TURNS) / HOP_TURNS) as usize + 1;
        if duration_s * shaft_hz < 3.0 * WINDOW_TURNS {
            return None;
        }
        let grid = Grid { hop_s: HOP_TURNS / shaft_hz, greatest_rate: RATE_PER_HZ * shaft_hz };
        let mut scores = vec![vec![0.0; SPEEDS * RATES]; windows];
        for order in 1..=HARMONICS {
            add_harmonic(band, order as f64, &grid, &mut scores, transforms);
        }
        let path = grid.smoothest(&scores);
        let typical = |scores: &Vec<f64>| {
            let mut sorted = scores.clone();
            let middle = sorted.len() / 2;
            *sorted.select_nth_unstable_by(middle, f64::total_cmp).1
        };
        let gain: f64 =
            scores.iter().zip(&path).map(|(scores, &state)| scores[state] - typical(scores)).sum();
        if gain < MIN_GAIN * windows as f64 {
            return None;
        }
        let first_s = 0.5 * WINDOW_TURNS / shaft_hz;
        let deviation = |t: f64| {
            let place = ((t - first_s) / grid.hop_s).clamp(0.0, (windows - 1) as f64);
            let lower = (place as usize).min(windows - 2);
            let part = place - lower as f64;
            (1.0 - part) * grid.speed(path[lower]) + part * grid.speed(path[lower + 1])
        };
        const STEPS_A_WINDOW: usize = 16;
        let steps = windows * STEPS_A_WINDOW;
        let step_s = duration_s / steps as f64;
        let mut ahead = vec![0.0];
        let mut total = 0.0;
        for i in 0..steps {
            total += deviation((i as f64 + 0.5) * step_s) * band.mesh_hz * step_s;
            ahead.push(total);
        }
        Some(Self { ahead })
    }

    /// How far the speed may be from the given one, as a part.
    pub(super) fn reach(&self) -> f64 {
        REACH
    }

    /// At a part of the record, 0 to 1.
    pub(super) fn ahead_periods(&self, part: f64) -> f64 {
        let steps = self.ahead.len() - 1;
        let place = part.clamp(0.0, 1.0) * steps as f64;
        let i = (place as usize).min(steps - 1);
        self.ahead[i] + (place - i as f64) * (self.ahead[i + 1] - self.ahead[i])
    }
}

/// The candidates: speeds as parts of the given one, by rates of change as parts a second.
struct Grid {
    hop_s: f64,
    greatest_rate: f64,
}

impl Grid {
    fn speed(&self, state: usize) -> f64 {
        REACH * (2.0 * (state / RATES) as f64 / (SPEEDS - 1) as f64 - 1.0)
    }

    fn rate(&self, state: usize) -> f64 {
        self.greatest_rate * (2.0 * (state % RATES) as f64 / (RATES - 1) as f64 - 1.0)
    }

    /// The path of states with the highest sum of scores whose speeds go on as their rates of change say.
    fn smoothest(&self, scores: &[Vec<f64>]) -> Vec<usize> {
        let states = SPEEDS * RATES;
        let step = 2.0 * REACH / (SPEEDS - 1) as f64;
        let mut best = scores[0].clone();
        let mut came_from: Vec<Vec<usize>> = Vec::with_capacity(scores.len());
        for scores in &scores[1..] {
            let mut next = vec![f64::NEG_INFINITY; states];
            let mut from = vec![0; states];
            for state in 0..states {
                for rate in 0..RATES {
                    let risen = 0.5 * (self.rate(state) + self.rate(rate)) * self.hop_s;
                    let middle = (state / RATES) as i64 - (risen / step).round() as i64;
                    for speed in middle - SLACK..=middle + SLACK {
                        if (0..SPEEDS as i64).contains(&speed) {
                            let before = speed as usize * RATES + rate;
                            if best[before] > next[state] {
                                (next[state], from[state]) = (best[before], before);
                            }
                        }
                    }
                }
                next[state] += scores[state];
            }
            best = next;
            came_from.push(from);
        }
        let mut state = (0..states).max_by(|&a, &b| best[a].total_cmp(&best[b])).unwrap_or(0);
        let mut path = vec![state];
        for from in came_from.iter().rev() {
            state = from[state];
            path.push(state);
        }
        path.reverse();
        path
    }
}

/// Adds the logarithm of one harmonic's energy over its noise to each window's scores.
fn add_harmonic(
    band: &MeshBand<'_>,
    order: f64,
    grid: &Grid,
    scores: &mut [Vec<f64>],
    transforms: &mut Transforms,
) {
    let duration_s = band.length as f64 / band.sample_rate_hz;
    let shaft_hz = band.mesh_hz / f64::from(band.teeth);
    let centre_hz = order * band.mesh_hz;
    let reach_hz = REACH * centre_hz + shaft_hz;
    let (first, last) =
        (((centre_hz - reach_hz) * duration_s).ceil(), ((centre_hz + reach_hz) * duration_s).floor());
    if first < 1.0 || last >= 0.5 * band.length as f64 {
        return;
    }
    let (first, last) = (first as usize, last as usize);
    let signal = band.analytic_sparse(first, last, transforms);
    let rate_hz = signal.len() as f64 / duration_s;
    // Moved down so that the given speed is at zero frequency.
    let offset_hz = centre_hz - (first - 1) as f64 / duration_s;
    let half = 0.5 * WINDOW_TURNS / shaft_hz;
    let mut energies = vec![0.0; SPEEDS * RATES];
    let mut sorted = Vec::new();
    for (window, scores) in scores.iter_mut().enumerate() {
        let middle_s = half + window as f64 * grid.hop_s;
        let from = ((middle_s - half) * rate_hz).ceil().max(0.0) as usize;
        let until = (((middle_s + half) * rate_hz) as usize).min(signal.len() - 1);
        for rate in 0..RATES {
            let straight: Vec<(f64, Complex<f64>)> = (from..=until)
                .map(|j| {
                    let t = j as f64 / rate_hz - middle_s;
                    let weight = (0.25 * TAU * t / half).cos().powi(2);
                    let turned = offset_hz * t + 0.5 * order * band.mesh_hz * grid.rate(rate) * t * t;
                    (t, signal[j] * Complex::from_polar(weight, -TAU * turned))
                })
                .collect();
            // Even steps of speed turn each sample on by the same angle.
            let step_hz = centre_hz * 2.0 * REACH / (SPEEDS - 1) as f64;
            let mut turning: Vec<(Complex<f64>, Complex<f64>)> = straight
                .iter()
                .map(|(t, z)| {
                    (
                        z * Complex::from_polar(1.0, TAU * REACH * centre_hz * t),
                        Complex::from_polar(1.0, -TAU * step_hz * t),
                    )
                })
                .collect();
            for speed in 0..SPEEDS {
                let mut sum = Complex::default();
                for (z, turn) in &mut turning {
                    sum += *z;
                    *z *= *turn;
                }
                energies[speed * RATES + rate] = sum.norm_sqr();
            }
        }
        sorted.clear();
        sorted.extend_from_slice(&energies);
        let middle = sorted.len() / 2;
        let typical = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
        if typical > 0.0 {
            for (score, energy) in scores.iter_mut().zip(&energies) {
                *score += (energy / typical).ln_1p();
            }
        }
    }
}
