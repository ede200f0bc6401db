//! What each physics of the ensemble expects of one asset's records, worked out once from its baseline.
//!
//! A hypothesis is a member of the ensemble together with how much the asset had already worn by the end of its baseline.

mod comparison;

use serde::{Deserialize, Serialize};

use super::baseline::{Baseline, HealthyFeature};
use super::healthy_checks::HealthyChecks;
use super::path_gain::{PathGain, SpeedBasis};
use crate::library::{Ensemble, Member};
pub(super) use comparison::{Compared, Deviation};
use flankwatch_signal::Features;

/// Depths in µm that the end of the baseline is tried at, and their prior weights.
const BASELINE_ENDS_UM: [(f64, f64); 6] = [(0.0, 0.4), (2.0, 0.2), (5.0, 0.16), (9.0, 0.12), (14.0, 0.08), (20.0, 0.04)];

/// Wear within the baseline grows as this power of the record's number.
const BASELINE_POWER: f64 = 1.5;

/// Weight of the baseline's evidence: what a library is wrong by is wrong in all records of the baseline alike.
const BASELINE_WEIGHT: f64 = 0.1;

/// A deviation beyond this many standard deviations counts no more against a hypothesis, in the baseline.
const MOST_DEVIATIONS: f64 = 3.0;

/// Standard deviation of a clear line from record to record.
const LINE_SCATTER: f64 = 0.04;

/// Variance of a line's logarithm over the square of the noise beside it as a part of its amplitude: ½ for Gaussian noise, and a little for
/// reading the line at its highest point.
const NOISE_VARIANCE: f64 = 0.6;

/// What the library may be wrong by, as a part of the change, and as a part of what the operating point moves the line by.
const CHANGE_DISCREPANCY: f64 = 0.03;
const OPERATING_DISCREPANCY: f64 = 0.35;

/// The change may be as wrong as the curve bends, and as this part of its slope, over this step in µm and as a part of the depth: lines pass
/// through zero where the first micrometres change the sign of a harmonic.
const DOUBT_STEP_UM: f64 = 1.5;
const DOUBT_STEP_PART: f64 = 0.02;
const SLOPE_DOUBT: f64 = 0.3;

/// The largest part of a healthy line's power that is taken for noise.
const MOST_NOISE: f64 = 0.5;

/// Lines are worked on in groups of this many.
const LANES: usize = 8;

/// The lines that wear is told from.
const LINES: &str = "ln_mesh_";

/// What was believed when a baseline began.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Beginning {
    /// Depths in µm and their weights.
    pub(super) depths_um: Vec<(f64, f64)>,
    /// Weight of each member; none where nothing is known.
    pub(super) members: Vec<f64>,
}

impl Beginning {
    /// The beginning of wear.
    fn fresh() -> Self {
        Self {
            depths_um: BASELINE_ENDS_UM.to_vec(),
            members: Vec::new(),
        }
    }
}

/// A physics and how far the baseline had worn.
#[derive(Debug, Clone)]
pub(super) struct Hypothesis {
    pub(super) member: usize,
    /// Greatest depth at the end of the baseline in µm.
    pub(super) baseline_end_um: f64,
    pub(super) log_weight: f64,
}

/// What one member expects, by depth and line, lines padded to whole groups.
#[derive(Debug, Clone)]
struct Expected {
    change: Vec<f32>,
    /// Variance of what the change may be wrong by.
    doubt: Vec<f32>,
    /// What each operating point moves the line by.
    operating: Vec<Vec<f32>>,
}

/// A line of the baseline.
#[derive(Debug, Clone)]
struct Line {
    name: String,
    /// Mean logarithm of the noise amplitude beside it.
    background: Option<f64>,
}

/// All hypotheses of one asset.
#[derive(Debug, Clone)]
pub(super) struct Hypotheses {
    basis: SpeedBasis,
    lines: Vec<Line>,
    expected: Vec<Expected>,
    pub(super) all: Vec<Hypothesis>,
    checks: HealthyChecks,
    /// What the baseline says of the path.
    pub(super) path: PathGain,
    nominal: [f64; 2],
    depths: usize,
    width: usize,
}

impl Hypotheses {
    /// Works out everything for a baseline, on a grid of depths in µm.
    ///
    /// Where `beginning` says what was believed before this baseline, the baseline stands at those depths; else at the beginning of wear.
    pub(super) fn new(baseline: &Baseline, ensemble: Option<&Ensemble>, depths_um: &[f64], beginning: Option<&Beginning>) -> Self {
        let nominal = nominal(baseline, ensemble);
        let log_speeds: Vec<f64> = baseline.points.iter().map(|point| relative(point[0], nominal[0]).ln()).collect();
        let basis = SpeedBasis::over(&log_speeds);
        let healthy: Vec<&HealthyFeature> = match ensemble {
            None => Vec::new(),
            Some(ensemble) => {
                let known = |line: &&HealthyFeature| {
                    line.name.starts_with(LINES) && ensemble.members().iter().all(|member| member.curves().has(&line.name))
                };
                baseline.lines.iter().filter(known).collect()
            }
        };
        let means: Vec<f64> = healthy.iter().map(|line| line.mean()).collect();
        let mut this = Self {
            path: PathGain::around(&means, &basis, 0),
            basis,
            lines: healthy.iter().map(|line| Line::of(line)).collect(),
            expected: Vec::new(),
            all: Vec::new(),
            checks: HealthyChecks::new(baseline, log_speeds, ensemble, depths_um),
            nominal,
            depths: depths_um.len(),
            width: healthy.len().next_multiple_of(LANES),
        };
        if let Some(ensemble) = ensemble {
            let noise: Vec<f64> = healthy.iter().map(|line| noise_part(line)).collect();
            let members = ensemble.members().iter();
            this.expected = members.map(|member| this.tabulate(member, depths_um, &noise)).collect();
            this.suppose(ensemble, beginning);
            this.path = PathGain::around(&means, &this.basis, this.all.len());
            this.learn_baseline(baseline, &healthy, ensemble, depths_um, beginning.is_some());
        }
        this
    }

    /// Lines that are compared.
    pub(super) fn lines(&self) -> usize {
        self.lines.len()
    }

    fn tabulate(&self, member: &Member, depths_um: &[f64], noise: &[f64]) -> Expected {
        let last = depths_um.last().copied().unwrap_or(0.0);
        let seen = |line: usize, um: f64| {
            let change = member.curves().change(&self.lines[line].name, um.clamp(0.0, last)).unwrap_or(0.0);
            above_noise(change, noise[line])
        };
        let table = |value: &dyn Fn(usize, f64) -> f64, padding: f32| {
            let mut table = vec![padding; depths_um.len() * self.width];
            for (row, um) in table.chunks_mut(self.width.max(1)).zip(depths_um) {
                for (line, out) in row.iter_mut().enumerate().take(self.lines.len()) {
                    *out = value(line, *um) as f32;
                }
            }
            table
        };
        let doubt = |line: usize, um: f64| {
            let step = DOUBT_STEP_UM + DOUBT_STEP_PART * um;
            let (before, here, after) = (seen(line, um - step), seen(line, um), seen(line, um + step));
            let bend = 0.5 * (after - 2.0 * here + before);
            let slope = SLOPE_DOUBT * 0.5 * (after - before);
            bend * bend + slope * slope + (CHANGE_DISCREPANCY * here).powi(2)
        };
        let operating = (0..member.operating_points())
            .map(|point| table(&|line, um| member.operating_shift(point, &self.lines[line].name, um), 0.0))
            .collect();
        Expected {
            change: table(&seen, 0.0),
            doubt: table(&doubt, 0.0),
            operating,
        }
    }

    fn suppose(&mut self, ensemble: &Ensemble, beginning: Option<&Beginning>) {
        let fresh = Beginning::fresh();
        let beginning = beginning.unwrap_or(&fresh);
        for member in 0..ensemble.members().len() {
            let prior = beginning.members.get(member).copied().unwrap_or_else(|| ensemble.prior(member));
            for &(baseline_end_um, weight) in &beginning.depths_um {
                self.all.push(Hypothesis {
                    member,
                    baseline_end_um,
                    log_weight: (prior * weight).max(f64::MIN_POSITIVE).ln(),
                });
            }
        }
    }

    /// Takes the baseline's records one by one, at the depths that each hypothesis supposes.
    fn learn_baseline(&mut self, baseline: &Baseline, healthy: &[&HealthyFeature], ensemble: &Ensemble, depths_um: &[f64], goes_on: bool) {
        let count = baseline.records();
        let lines = self.lines.len();
        if depths_um.is_empty() || lines == 0 {
            return;
        }
        for index in 0..count {
            let point = baseline.points[index];
            let grown = ((index as f64 + 1.0) / count as f64).powf(BASELINE_POWER);
            let at = self.path.at(self.basis.place(relative(point[0], self.nominal[0]).ln()));
            let shifts: Vec<Vec<f32>> = (0..self.expected.len()).map(|member| self.shift(member, ensemble, point)).collect();
            let scatter: Vec<f64> = (0..lines)
                .map(|line| self.scatter(line, f64::from(healthy[line].values[index])))
                .collect();
            let mut residuals = Vec::with_capacity(self.all.len() * lines);
            for (hypothesis, supposed) in self.all.iter().enumerate() {
                let um = if goes_on {
                    supposed.baseline_end_um
                } else {
                    supposed.baseline_end_um * grown
                };
                let (depth, part) = place_on(depths_um, um);
                let expected = &self.expected[supposed.member];
                for (line, feature) in healthy.iter().enumerate() {
                    let value = |depth: usize| {
                        let i = depth.min(self.depths - 1) * self.width + line;
                        f64::from(expected.change[i] + shifts[supposed.member][i])
                    };
                    let expected = (1.0 - part) * value(depth) + part * value(depth + 1);
                    residuals.push(f64::from(feature.values[index]) - self.path.gain(&at, hypothesis, line) - expected);
                }
            }
            for (hypothesis, residuals) in self.all.iter_mut().zip(residuals.chunks_exact(lines)).filter(|_| index > 0) {
                for (line, residual) in residuals.iter().enumerate() {
                    let variance = scatter[line] + at.variance[line];
                    let square = (residual * residual / variance).min(MOST_DEVIATIONS * MOST_DEVIATIONS);
                    hypothesis.log_weight -= BASELINE_WEIGHT * 0.5 * (variance.ln() + square);
                }
            }
            let leading = self.leading();
            self.path.learn(&at, &residuals, &scatter, leading);
        }
    }

    fn leading(&self) -> usize {
        let weight = |&index: &usize| self.all[index].log_weight;
        (0..self.all.len()).max_by(|a, b| weight(a).total_cmp(&weight(b))).unwrap_or(0)
    }

    /// Variance of a line's own scatter, at this value.
    fn scatter(&self, line: usize, value: f64) -> f64 {
        let noise = self.lines[line]
            .background
            .map_or(0.0, |background| (2.0 * (background - value)).exp().min(1.0));
        LINE_SCATTER * LINE_SCATTER + NOISE_VARIANCE * noise
    }

    /// Degrees of freedom of a check's scatter.
    pub(super) fn freedom(&self) -> f64 {
        self.checks.freedom()
    }

    fn log_speed(&self, record: &Features) -> f64 {
        relative(record.operating_point.shaft_speed_hz, self.nominal[0]).ln()
    }

    /// What an operating point moves each line of a member by, by depth.
    fn shift(&self, member: usize, ensemble: &Ensemble, [speed, torque]: [Option<f64>; 2]) -> Vec<f32> {
        let weights = ensemble.members()[member].operating_weights(relative(torque, self.nominal[1]), relative(speed, self.nominal[0]));
        let mut shift = vec![0.0_f32; self.depths * self.width];
        for (table, weight) in self.expected[member]
            .operating
            .iter()
            .zip(weights)
            .filter(|(_, weight)| *weight != 0.0)
        {
            shift
                .iter_mut()
                .zip(table)
                .for_each(|(shift, value)| *shift += weight as f32 * value);
        }
        shift
    }
}

impl Line {
    fn of(feature: &HealthyFeature) -> Self {
        Self {
            name: feature.name.clone(),
            background: feature.background,
        }
    }
}

/// The part of a healthy line's power that is noise.
fn noise_part(line: &HealthyFeature) -> f64 {
    line.background
        .map_or(0.0, |background| (2.0 * (background - line.mean())).exp().min(MOST_NOISE))
}

/// What is seen of a change of a line with a part `noise` of its healthy power in the noise: a line that sinks into the noise stays there.
fn above_noise(change: f64, noise: f64) -> f64 {
    0.5 * ((1.0 - noise) * (2.0 * change).exp() + noise).ln()
}

/// The point of a rising grid at or below a depth, and the part of the way to the next.
fn place_on(depths_um: &[f64], um: f64) -> (usize, f64) {
    let upper = depths_um.partition_point(|depth| *depth <= um);
    if upper == 0 || upper == depths_um.len() {
        return (upper.saturating_sub(1), 0.0);
    }
    (upper - 1, (um - depths_um[upper - 1]) / (depths_um[upper] - depths_um[upper - 1]))
}

/// A value as a part of its nominal one; 1 where either is not known.
fn relative(value: Option<f64>, nominal: f64) -> f64 {
    match value {
        Some(value) if value > 0.0 && nominal > 0.0 => value / nominal,
        _ => 1.0,
    }
}

/// Nominal speed and torque: the pair's, or without a pair the first record's.
fn nominal(baseline: &Baseline, ensemble: Option<&Ensemble>) -> [f64; 2] {
    match ensemble {
        Some(ensemble) => {
            let operation = &ensemble.described().pair().operation;
            [operation.shaft_speed_hz, operation.torque_nm]
        }
        None => [0, 1].map(|i| baseline.points.iter().find_map(|point| point[i]).unwrap_or(1.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_sinks_into_the_noise_stays_there() {
        assert_eq!(above_noise(1.3, 0.0), 1.3);
        assert!((above_noise(-20.0, 0.04) - 0.2f64.ln()).abs() < 1e-6);
        assert!(above_noise(0.0, 0.2).abs() < 1e-12);
    }

    #[test]
    fn a_depth_lies_between_two_points_of_the_grid() {
        let depths = [0.0, 1.0, 3.0];
        assert_eq!(place_on(&depths, 2.0), (1, 0.5));
        assert_eq!((place_on(&depths, -1.0), place_on(&depths, 9.0)), ((0, 0.0), (2, 0.0)));
    }
}
