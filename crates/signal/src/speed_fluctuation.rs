//! A rough estimate of a shaft's speed fluctuation within a record, from all mesh harmonics together.
//!
//! If the speed swings by 0.5 %, a high harmonic is smeared over many bins and does not stand out, while the
//! low ones may be buried in noise. Within a window of a few turns, the speed changes linearly with time: for
//! each pair of a speed and its rate of change, the energies of all harmonics relative to their noise are
//! summed. The result is the smooth path through the windows with the highest sum.

use std::f64::consts::TAU;

use flankwatch_fourier::Complex;

use super::comb::HARMONICS;
use super::mesh_phase::MeshBand;
use super::transform::Transforms;

/// Length of a window and distance between windows, in turns.
const WINDOW_TURNS: f64 = 3.5;
const HOP_TURNS: f64 = 1.0;

/// Largest relative deviation of the speed from the middle of the search, and number of candidate speeds.
const REACH: f64 = 0.012;
const SPEEDS: usize = 49;

/// Largest relative rate of change per second, for each hertz of the shaft speed: a swing of 0.5 % at a tenth
/// of the shaft rate.
const RATE_PER_HZ: f64 = 0.0032;
const RATES: usize = 9;

/// Number of candidates by which the speed may deviate from the extrapolation by its rate of change.
const SLACK: i64 = 1;

/// Smallest mean gain per window of the path's score over a typical score, in nats. White noise gives 3.3 to
/// 4.3.
const MIN_GAIN: f32 = 4.5;

/// Mesh periods by which the shaft is ahead of the constant speed `mesh_hz`, at equal time steps over the
/// record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SpeedFluctuation {
    ahead: Vec<f64>,
    /// Largest relative deviation of the speed from the constant one.
    reach: f64,
}

impl SpeedFluctuation {
    /// Estimates the fluctuation; `None` if no path stands out, or if the record is shorter than three
    /// windows.
    ///
    /// The mesh is found where the speed dwells, which may be an extreme of its swing. If the path is cut at
    /// an end of the range, the search is repeated around that end.
    pub(super) fn of(band: &MeshBand<'_>, transforms: &mut Transforms) -> Option<Self> {
        let first = Path::around(0.0, band, transforms)?;
        let path = match first.cut() {
            Some(end) => Path::around(end, band, transforms).unwrap_or(first),
            None => first,
        };
        Some(path.fluctuation(band))
    }

    /// Returns the largest relative deviation of the speed from the given one.
    pub(super) fn reach(&self) -> f64 {
        self.reach
    }

    /// Returns the mesh periods ahead at a fraction of the record, 0 to 1.
    pub(super) fn ahead_periods(&self, part: f64) -> f64 {
        let steps = self.ahead.len() - 1;
        let place = part.clamp(0.0, 1.0) * steps as f64;
        let i = (place as usize).min(steps - 1);
        self.ahead[i] + (place - i as f64) * (self.ahead[i + 1] - self.ahead[i])
    }
}

/// The states through the windows of a record.
struct Path {
    /// The middle of the search relative to the mesh frequency, minus 1.
    middle: f64,
    grid: Grid,
    states: Vec<usize>,
}

impl Path {
    fn around(middle: f64, band: &MeshBand<'_>, transforms: &mut Transforms) -> Option<Self> {
        let duration_s = band.duration_s();
        let shaft_hz = band.mesh_hz / f64::from(band.teeth);
        let windows = ((duration_s * shaft_hz - WINDOW_TURNS) / HOP_TURNS) as usize + 1;
        if duration_s * shaft_hz < 3.0 * WINDOW_TURNS {
            return None;
        }
        let grid = Grid { hop_s: HOP_TURNS / shaft_hz, max_rate: RATE_PER_HZ * shaft_hz };
        let mut scores = vec![vec![0.0; SPEEDS * RATES]; windows];
        let shifted = MeshBand { mesh_hz: band.mesh_hz * (1.0 + middle), ..*band };
        for order in 1..=HARMONICS {
            add_harmonic(&shifted, order as f64, &grid, &mut scores, transforms);
        }
        let states = grid.smoothest(&scores);
        let typical = |scores: &Vec<f32>| {
            let mut sorted = scores.clone();
            let middle = sorted.len() / 2;
            *sorted.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        let gain: f32 =
            scores.iter().zip(&states).map(|(scores, &state)| scores[state] - typical(scores)).sum();
        (gain >= MIN_GAIN * windows as f32).then_some(Self { middle, grid, states })
    }

    /// Returns the end of the range, relative to the mesh frequency minus 1, at which the path is cut, if it
    /// is one.
    fn cut(&self) -> Option<f64> {
        let touches = |end: usize| self.states.iter().any(|state| state / RATES == end);
        match [0, SPEEDS - 1].map(touches) {
            [true, false] => Some(self.middle - REACH),
            [false, true] => Some(self.middle + REACH),
            _ => None,
        }
    }

    fn fluctuation(&self, band: &MeshBand<'_>) -> SpeedFluctuation {
        const STEPS_A_WINDOW: usize = 16;
        let duration_s = band.duration_s();
        let windows = self.states.len();
        let first_s = 0.5 * WINDOW_TURNS * f64::from(band.teeth) / band.mesh_hz;
        let deviation = |t: f64| {
            let place = ((t - first_s) / self.grid.hop_s).clamp(0.0, (windows - 1) as f64);
            let lower = (place as usize).min(windows - 2);
            let part = place - lower as f64;
            let [from, to] = [lower, lower + 1].map(|window| self.grid.speed(self.states[window]));
            // The grid's speeds are relative to the middle.
            self.middle + (1.0 + self.middle) * ((1.0 - part) * from + part * to)
        };
        let steps = windows * STEPS_A_WINDOW;
        let step_s = duration_s / steps as f64;
        let mut ahead = vec![0.0];
        let mut total = 0.0;
        for i in 0..steps {
            total += deviation((i as f64 + 0.5) * step_s) * band.mesh_hz * step_s;
            ahead.push(total);
        }
        SpeedFluctuation { ahead, reach: self.middle.abs() + REACH }
    }
}

/// The candidates: speeds relative to the given one, by relative rates of change per second.
struct Grid {
    hop_s: f64,
    max_rate: f64,
}

impl Grid {
    fn speed(&self, state: usize) -> f64 {
        REACH * (2.0 * (state / RATES) as f64 / (SPEEDS - 1) as f64 - 1.0)
    }

    fn rate(&self, state: usize) -> f64 {
        self.max_rate * (2.0 * (state % RATES) as f64 / (RATES - 1) as f64 - 1.0)
    }

    /// Returns the path of states with the highest sum of scores whose speeds follow from their rates of
    /// change.
    fn smoothest(&self, scores: &[Vec<f32>]) -> Vec<usize> {
        let states = SPEEDS * RATES;
        let step = 2.0 * REACH / (SPEEDS - 1) as f64;
        let mut best = scores[0].clone();
        let mut predecessors: Vec<Vec<u16>> = Vec::with_capacity(scores.len());
        for scores in &scores[1..] {
            let mut next = vec![f32::NEG_INFINITY; states];
            let mut from = vec![0_u16; states];
            for state in 0..states {
                for rate in 0..RATES {
                    let speed_change = 0.5 * (self.rate(state) + self.rate(rate)) * self.hop_s;
                    let middle = (state / RATES) as i64 - (speed_change / step).round() as i64;
                    for speed in middle - SLACK..=middle + SLACK {
                        if (0..SPEEDS as i64).contains(&speed) {
                            let before = speed as usize * RATES + rate;
                            if best[before] > next[state] {
                                (next[state], from[state]) = (best[before], before as u16);
                            }
                        }
                    }
                }
                next[state] += scores[state];
            }
            best = next;
            predecessors.push(from);
        }
        let mut state = (0..states).max_by(|&a, &b| best[a].total_cmp(&best[b])).unwrap_or(0);
        let mut path = vec![state];
        for from in predecessors.iter().rev() {
            state = usize::from(from[state]);
            path.push(state);
        }
        path.reverse();
        path
    }
}

/// Adds the logarithm of one harmonic's energy relative to its noise to each window's scores.
fn add_harmonic(
    band: &MeshBand<'_>,
    order: f64,
    grid: &Grid,
    scores: &mut [Vec<f32>],
    transforms: &mut Transforms,
) {
    let duration_s = band.duration_s();
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
    // Shifted down so that the given speed is at zero frequency.
    let offset_hz = centre_hz - (first - 1) as f64 / duration_s;
    let half = 0.5 * WINDOW_TURNS / shaft_hz;
    let mut energies = vec![0.0; SPEEDS * RATES];
    let mut sorted = Vec::new();
    for (window, scores) in scores.iter_mut().enumerate() {
        let middle_s = half + window as f64 * grid.hop_s;
        let from = ((middle_s - half) * rate_hz).ceil().max(0.0) as usize;
        let until = (((middle_s + half) * rate_hz) as usize).min(signal.len() - 1);
        for rate in 0..RATES {
            let demodulated: Vec<(f64, Complex<f64>)> = (from..=until)
                .map(|j| {
                    let t = j as f64 / rate_hz - middle_s;
                    let weight = (0.25 * TAU * t / half).cos().powi(2);
                    let cycles = offset_hz * t + 0.5 * order * band.mesh_hz * grid.rate(rate) * t * t;
                    (t, signal[j] * Complex::from_polar(weight, -TAU * cycles))
                })
                .collect();
            // Equal steps of speed rotate each sample by the same angle.
            let step_hz = centre_hz * 2.0 * REACH / (SPEEDS - 1) as f64;
            let mut rotating: Vec<(Complex<f64>, Complex<f64>)> = demodulated
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
                for (z, rotation) in &mut rotating {
                    sum += *z;
                    *z *= *rotation;
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
                *score += (energy / typical).ln_1p() as f32;
            }
        }
    }
}
