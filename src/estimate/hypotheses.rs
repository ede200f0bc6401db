//! What each physics of the ensemble expects of one asset's records, worked out once from its baseline.
//!
//! A hypothesis is a member of the ensemble together with how much the asset had already worn by the end of its baseline. Each fits
//! the baseline's records with its own changes taken off them; how well it can is its first evidence.

use serde::{Deserialize, Serialize};

use super::baseline::{Baseline, HealthyFeature};
use super::healthy::{SpeedKernels, SpeedWeights};
use crate::library::{Ensemble, MemberCurves};
use crate::signal::Features;

/// Depths in µm that the end of the baseline is tried at, and their prior weights.
const BASELINE_ENDS_UM: [(f64, f64); 6] = [(0.0, 0.4), (2.0, 0.2), (5.0, 0.16), (9.0, 0.12), (14.0, 0.08), (20.0, 0.04)];

/// Wear within the baseline grows as this power of the record's number.
const BASELINE_POWER: f64 = 1.5;

/// Weight of the baseline's evidence: what a library is wrong by is wrong in all features of the baseline alike.
const BASELINE_WEIGHT: f64 = 0.1;

/// Standard deviation of what the described pair's library may be wrong by in a line, and as a part of the change.
const DISCREPANCY: f64 = 0.06;
const RELATIVE_DISCREPANCY: f64 = 0.15;

/// A variant stands for all physics around it: so many times as much.
const VARIANT_DISCREPANCY: f64 = 2.0;

/// The same for what wear hardly moves; half of the change that the library has is expected, as the sensor's own noise does not change.
const CHECK_DISCREPANCY: f64 = 0.05;
const CHECK_RELATIVE_DISCREPANCY: f64 = 0.6;
const CHECK_PART: f64 = 0.5;

/// The largest part of a healthy line's power that is taken for noise.
const MOST_NOISE: f64 = 0.25;

/// Lines are worked on in groups of this many.
pub(super) const LANES: usize = 8;

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

    fn member(&self, member: usize) -> Option<f64> {
        self.members.get(member).copied()
    }
}

/// One feature's fit, the same for all hypotheses but for what is subtracted.
#[derive(Debug, Clone)]
struct FeatureFit {
    name: String,
    kernel: usize,
    /// σ² of one record.
    variance: f64,
    /// Part of the healthy power that is noise.
    noise: f64,
}

/// A physics and its own fit of the baseline.
#[derive(Debug, Clone)]
pub(super) struct Hypothesis {
    pub(super) member: usize,
    /// Greatest depth at the end of the baseline in µm.
    pub(super) baseline_end_um: f64,
    pub(super) log_weight: f64,
    /// For each feature b and K⁻¹(y − b).
    fits: Vec<(f64, Vec<f64>)>,
}

/// All hypotheses of one asset.
#[derive(Debug, Clone)]
pub(super) struct Hypotheses {
    kernels: SpeedKernels,
    lines: Vec<FeatureFit>,
    checks: Vec<FeatureFit>,
    check_fits: Vec<(f64, Vec<f64>)>,
    pub(super) all: Vec<Hypothesis>,
    nominal: [f64; 2],
    depths: usize,
    width: usize,
    /// Expected change and variance of the discrepancy by hypothesis, depth and line, lines padded to whole groups.
    change: Vec<f32>,
    discrepancy: Vec<f32>,
    /// Shift of each line by operating point and depth.
    operating: Vec<Vec<f32>>,
    /// Change of each check by depth, from the described pair.
    check_change: Vec<Vec<f64>>,
}

/// A record against all hypotheses.
pub(super) struct Compared {
    /// Logarithm of the likelihood by hypothesis and depth.
    pub(super) log_likelihood: Vec<f64>,
    /// Lines that the record has.
    pub(super) lines: usize,
}

impl Compared {
    /// Hypothesis and depth that explain the record best.
    pub(super) fn best(&self, depths: usize) -> (usize, usize) {
        let highest = (0..self.log_likelihood.len()).max_by(|&a, &b| self.log_likelihood[a].total_cmp(&self.log_likelihood[b]));
        highest.map_or((0, 0), |index| (index / depths, index % depths))
    }
}

/// One feature of a record against what was expected.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Deviation {
    pub(super) name: String,
    /// Measured less expected, in logarithms.
    pub(super) residual: f64,
    /// Standard deviation of what was expected.
    pub(super) deviation: f64,
}

/// Degrees of freedom of the likelihood: heavy tails, so that one odd line does not decide.
const DEGREES_OF_FREEDOM: f64 = 6.0;

/// Part of a record's own scatter that enters the tracking, which averages over several records.
const SCATTER_PART: f64 = 0.3;

impl Hypotheses {
    /// Works out everything for a baseline, on a grid of depths in µm.
    ///
    /// Where `beginning` says what was believed before this baseline, the baseline stands at those depths; else at the beginning of wear.
    pub(super) fn new(baseline: &Baseline, ensemble: Option<&Ensemble>, depths_um: &[f64], beginning: Option<&Beginning>) -> Self {
        let nominal = nominal(baseline, ensemble);
        let log_speeds: Vec<f64> = baseline.points.iter().map(|point| relative(point[0], nominal[0]).ln()).collect();
        let kernels = SpeedKernels::new(log_speeds);
        let mut this = Self {
            kernels,
            lines: Vec::new(),
            checks: Vec::new(),
            check_fits: Vec::new(),
            all: Vec::new(),
            nominal,
            depths: depths_um.len(),
            width: 0,
            change: Vec::new(),
            discrepancy: Vec::new(),
            operating: Vec::new(),
            check_change: Vec::new(),
        };
        for check in &baseline.checks {
            let residuals: Vec<f64> = check.values.iter().map(|&value| f64::from(value)).collect();
            let fit = this.choose(check, std::slice::from_ref(&residuals));
            this.check_fits.push(this.kernels.fit(fit.kernel, &residuals));
            // What a simulation without noise has between its lines is rounding, and no wear.
            let wears = !["ln_shaft_", "ln_tooth_"].iter().any(|kind| check.name.starts_with(kind));
            this.check_change.push(match ensemble.filter(|_| wears) {
                None => vec![0.0; depths_um.len().max(1)],
                Some(ensemble) => {
                    let change = |um: &f64| CHECK_PART * ensemble.members()[0].change(&check.name, *um).unwrap_or(0.0);
                    depths_um.iter().map(change).collect()
                }
            });
            this.checks.push(fit);
        }
        if let Some(ensemble) = ensemble {
            this.fit_lines(baseline, ensemble, beginning);
            this.tabulate(ensemble, depths_um);
        }
        this
    }

    /// Lines that are compared.
    pub(super) fn lines(&self) -> usize {
        self.lines.len()
    }

    fn fit_lines(&mut self, baseline: &Baseline, ensemble: &Ensemble, beginning: Option<&Beginning>) {
        let fresh = Beginning::fresh();
        let (beginning, goes_on) = beginning.map_or((&fresh, false), |beginning| (beginning, true));
        let lines: Vec<&HealthyFeature> = baseline
            .lines
            .iter()
            .filter(|line| ensemble.members().iter().all(|member| member.has(&line.name)))
            .collect();
        let candidates: Vec<(usize, f64, f64)> = (0..ensemble.members().len())
            .flat_map(|member| {
                let prior = beginning.member(member).unwrap_or_else(|| ensemble.prior(member));
                beginning.depths_um.iter().map(move |&(end, weight)| (member, end, weight * prior))
            })
            .collect();
        let mut log_weights: Vec<f64> = candidates.iter().map(|(_, _, prior)| prior.ln()).collect();
        let mut residuals_by_line = Vec::with_capacity(lines.len());
        for line in lines {
            let noise = line
                .background
                .map_or(0.0, |background| (2.0 * (background - line.mean())).exp().min(MOST_NOISE));
            let residuals: Vec<Vec<f64>> = candidates
                .iter()
                .map(|&(member, end, _)| self.without_change(line, noise, baseline, ensemble, &ensemble.members()[member], (end, goes_on)))
                .collect();
            let mut fit = self.choose(line, &residuals);
            fit.noise = noise;
            for (weight, residuals) in log_weights.iter_mut().zip(&residuals) {
                *weight += BASELINE_WEIGHT * self.kernels.log_evidence(fit.kernel, residuals);
            }
            self.lines.push(fit);
            residuals_by_line.push(residuals);
        }
        // Of each member the end that fits best stands for all.
        let ends = beginning.depths_um.len();
        for member in 0..ensemble.members().len() {
            let of_member = member * ends..(member + 1) * ends;
            let best = of_member
                .clone()
                .max_by(|&a, &b| log_weights[a].total_cmp(&log_weights[b]))
                .unwrap_or(of_member.start);
            let peak = log_weights[best];
            let total: f64 = of_member.map(|i| (log_weights[i] - peak).exp()).sum();
            let fits = self.lines.iter().zip(&residuals_by_line);
            let fits = fits.map(|(fit, residuals)| self.kernels.fit(fit.kernel, &residuals[best]));
            self.all.push(Hypothesis {
                member,
                baseline_end_um: candidates[best].1,
                log_weight: peak + total.ln(),
                fits: fits.collect(),
            });
        }
        // A line's scatter is what the best hypothesis leaves of it.
        let best = (0..candidates.len())
            .max_by(|&a, &b| log_weights[a].total_cmp(&log_weights[b]))
            .unwrap_or(0);
        for (fit, residuals) in self.lines.iter_mut().zip(&residuals_by_line) {
            fit.variance = self.kernels.variance(fit.kernel, &residuals[best]);
        }
    }

    /// A line's healthy values less what this member says of operating point and wear.
    fn without_change(
        &self,
        line: &HealthyFeature,
        noise: f64,
        baseline: &Baseline,
        ensemble: &Ensemble,
        member: &MemberCurves,
        (end_um, goes_on): (f64, bool),
    ) -> Vec<f64> {
        let count = baseline.records() as f64;
        let weights: Vec<Vec<f64>> = baseline
            .points
            .iter()
            .map(|point| self.operating_weights(ensemble, *point))
            .collect();
        let value = |(index, value): (usize, &f32)| {
            let grown = ((index as f64 + 1.0) / count).powf(BASELINE_POWER);
            let um = if goes_on { end_um } else { end_um * grown };
            let weights = &weights[index];
            let shift: f64 = (0..weights.len())
                .filter(|&point| weights[point] != 0.0)
                .map(|point| weights[point] * ensemble.operating_shift(point, &line.name, um))
                .sum();
            f64::from(*value) - shift - above_noise(member.change(&line.name, um).unwrap_or(0.0), noise).0
        };
        line.values.iter().enumerate().map(value).collect()
    }

    /// The kernel with the most evidence under whichever hypothesis likes it best.
    fn choose(&self, feature: &HealthyFeature, residuals: &[Vec<f64>]) -> FeatureFit {
        let best = |kernel: usize| {
            let evidence = residuals.iter().map(|residuals| self.kernels.log_evidence(kernel, residuals));
            evidence.fold(f64::NEG_INFINITY, f64::max)
        };
        let evidence: Vec<f64> = (0..self.kernels.len()).map(best).collect();
        let kernel = (0..evidence.len())
            .max_by(|&a, &b| evidence[a].total_cmp(&evidence[b]))
            .unwrap_or(0);
        FeatureFit {
            name: feature.name.clone(),
            kernel,
            variance: self.kernels.variance(kernel, &residuals[0]),
            noise: 0.0,
        }
    }

    fn tabulate(&mut self, ensemble: &Ensemble, depths_um: &[f64]) {
        self.width = self.lines.len().next_multiple_of(LANES);
        for point in 0..ensemble.operating_points() {
            let mut table = vec![0.0; depths_um.len() * self.width];
            for (row, um) in table.chunks_mut(self.width.max(1)).zip(depths_um) {
                for (shift, line) in row.iter_mut().zip(&self.lines) {
                    *shift = ensemble.operating_shift(point, &line.name, *um) as f32;
                }
            }
            self.operating.push(table);
        }
        for hypothesis in &self.all {
            let member = &ensemble.members()[hypothesis.member];
            let width = if hypothesis.member == 0 { 1.0 } else { VARIANT_DISCREPANCY };
            for um in depths_um {
                for line in &self.lines {
                    let change = member.change(&line.name, *um).unwrap_or(0.0);
                    let (seen, left) = above_noise(change, line.noise);
                    let wrong = width * (DISCREPANCY + RELATIVE_DISCREPANCY * change.abs()) * left.max(0.1);
                    self.change.push(seen as f32);
                    self.discrepancy.push((wrong * wrong) as f32);
                }
                for _ in self.lines.len()..self.width {
                    self.change.push(0.0);
                    self.discrepancy.push(1.0);
                }
            }
        }
    }

    /// Logarithms of likelihood of a record under every hypothesis at every depth.
    pub(super) fn compare(&self, record: &Features, ensemble: &Ensemble) -> Compared {
        let at = self.place(record);
        let shifts = self.shifts(record, ensemble);
        let present: Vec<Option<f64>> = self.lines.iter().map(|line| record.values.get(&line.name).copied()).collect();
        let lines = present.iter().flatten().count();
        let mut variance = vec![0.0_f32; self.width];
        for ((variance, line), value) in variance.iter_mut().zip(&self.lines).zip(&present) {
            // A line that is missing says nothing: an immense variance.
            *variance = match value {
                Some(_) => (line.variance * (SCATTER_PART + at.variance(line.kernel))) as f32,
                None => 1e6,
            };
        }
        let mut log_likelihood = Vec::with_capacity(self.all.len() * self.depths);
        let mut measured = vec![0.0_f32; self.width];
        for (index, hypothesis) in self.all.iter().enumerate() {
            for (((measured, line), value), (constant, weights)) in measured.iter_mut().zip(&self.lines).zip(&present).zip(&hypothesis.fits)
            {
                *measured = value.map_or(0.0, |value| (value - constant - at.path(line.kernel, weights)) as f32);
            }
            for depth in 0..self.depths {
                let row = (index * self.depths + depth) * self.width;
                let (distance, determinant) = misfit(
                    &measured,
                    &shifts[depth * self.width..(depth + 1) * self.width],
                    &self.change[row..row + self.width],
                    &self.discrepancy[row..row + self.width],
                    &variance,
                );
                let count = lines as f64;
                log_likelihood.push(-0.5 * determinant.ln() - 0.5 * (DEGREES_OF_FREEDOM + count) * (distance / DEGREES_OF_FREEDOM).ln_1p());
            }
        }
        Compared { log_likelihood, lines }
    }

    /// How each line and check of a record deviates from what a hypothesis expects at a depth of the grid; without a library the lines
    /// are left out.
    pub(super) fn deviations(&self, record: &Features, state: Option<(&Ensemble, (usize, usize))>) -> [Vec<Deviation>; 2] {
        let at = self.place(record);
        let mut lines = Vec::new();
        if let Some((ensemble, (hypothesis, depth))) = state {
            let shifts = self.shifts(record, ensemble);
            let row = (hypothesis * self.depths + depth) * self.width;
            for (i, line) in self.lines.iter().enumerate() {
                let Some(value) = record.values.get(&line.name) else { continue };
                let (constant, weights) = &self.all[hypothesis].fits[i];
                let expected =
                    constant + at.path(line.kernel, weights) + f64::from(shifts[depth * self.width + i]) + f64::from(self.change[row + i]);
                let variance = f64::from(self.discrepancy[row + i]) + line.variance * (1.0 + at.variance(line.kernel));
                lines.push(Deviation {
                    name: line.name.clone(),
                    residual: value - expected,
                    deviation: variance.sqrt(),
                });
            }
        }
        let depth = state.map_or(0, |(_, (_, depth))| depth);
        let checks = self.checks.iter().zip(&self.check_fits).zip(&self.check_change);
        let checks = checks.filter_map(|((check, (constant, weights)), change)| {
            let value = record.checks.get(&check.name)?;
            let change = change[depth.min(change.len() - 1)];
            let wrong = CHECK_DISCREPANCY + CHECK_RELATIVE_DISCREPANCY * change.abs();
            Some(Deviation {
                name: check.name.clone(),
                residual: value - constant - at.path(check.kernel, weights) - change,
                deviation: (wrong * wrong + check.variance * (1.0 + at.variance(check.kernel))).sqrt(),
            })
        });
        [lines, checks.collect()]
    }

    /// The depths around one of the grid that a single record of this operating range cannot tell from it: their expected lines differ by less than
    /// two standard deviations in all.
    pub(super) fn resolved(&self, (hypothesis, depth): (usize, usize)) -> [usize; 2] {
        let row = |depth: usize| (hypothesis * self.depths + depth) * self.width;
        let alike = |other: usize| {
            let distance: f64 = (0..self.lines.len())
                .map(|i| {
                    let apart = f64::from(self.change[row(other) + i] - self.change[row(depth) + i]);
                    apart * apart / (f64::from(self.discrepancy[row(depth) + i]) + self.lines[i].variance)
                })
                .sum();
            distance < 4.0
        };
        let low = (0..depth).rev().take_while(|&other| alike(other)).last().unwrap_or(depth);
        let high = (depth + 1..self.depths).take_while(|&other| alike(other)).last().unwrap_or(depth);
        [low, high]
    }

    /// Degrees of freedom of a feature's scatter.
    pub(super) fn freedom(&self) -> f64 {
        self.kernels.freedom()
    }

    fn place(&self, record: &Features) -> SpeedWeights {
        self.kernels
            .weights(relative(record.operating_point.shaft_speed_hz, self.nominal[0]).ln())
    }

    fn operating_weights(&self, ensemble: &Ensemble, [speed, torque]: [Option<f64>; 2]) -> Vec<f64> {
        ensemble.operating_weights(relative(torque, self.nominal[1]), relative(speed, self.nominal[0]))
    }

    /// What the record's operating point moves each line by, by depth.
    fn shifts(&self, record: &Features, ensemble: &Ensemble) -> Vec<f32> {
        let point = &record.operating_point;
        let weights = self.operating_weights(ensemble, [point.shaft_speed_hz, point.torque_nm]);
        let mut shifts = vec![0.0_f32; self.depths * self.width];
        for (table, weight) in self.operating.iter().zip(weights).filter(|(_, weight)| *weight != 0.0) {
            shifts
                .iter_mut()
                .zip(table)
                .for_each(|(shift, value)| *shift += weight as f32 * value);
        }
        shifts
    }
}

/// Σ r²/v and Π v over lines. The groups' partial results let the processor work on several lines at once.
fn misfit(measured: &[f32], shift: &[f32], change: &[f32], discrepancy: &[f32], variance: &[f32]) -> (f64, f64) {
    let (mut distance, mut determinant) = ([0.0_f32; LANES], [1.0_f32; LANES]);
    let groups = measured
        .chunks_exact(LANES)
        .zip(shift.chunks_exact(LANES))
        .zip(change.chunks_exact(LANES))
        .zip(discrepancy.chunks_exact(LANES))
        .zip(variance.chunks_exact(LANES));
    for ((((measured, shift), change), discrepancy), variance) in groups {
        for lane in 0..LANES {
            let v = discrepancy[lane] + variance[lane];
            let r = measured[lane] - shift[lane] - change[lane];
            distance[lane] += r * r / v;
            determinant[lane] *= v;
        }
    }
    let distance = distance.iter().map(|&d| f64::from(d)).sum();
    (distance, determinant.iter().map(|&d| f64::from(d)).product())
}

/// What is seen of a change of a line with a part `noise` of its healthy power in the noise, and how much of a further change would be seen: a
/// line that sinks into the noise stays at the noise.
fn above_noise(change: f64, noise: f64) -> (f64, f64) {
    let line = (1.0 - noise) * (2.0 * change).exp();
    (0.5 * (line + noise).ln(), line / (line + noise))
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
        assert_eq!(above_noise(1.3, 0.0), (1.3, 1.0));
        let (seen, left) = above_noise(-20.0, 0.04);
        assert!((seen - 0.2f64.ln()).abs() < 1e-6 && left < 1e-12);
        assert!(above_noise(0.0, 0.2).0.abs() < 1e-12);
    }

    #[test]
    fn misfit_is_the_sum_and_the_product() {
        let r: Vec<f32> = (0..16).map(|i| i as f32 * 0.1).collect();
        let v: Vec<f32> = (0..16).map(|i| 0.5 + i as f32 * 0.1).collect();
        let none = vec![0.0; 16];
        let (distance, determinant) = misfit(&r, &none, &none, &v, &none);
        let expected: f64 = r.iter().zip(&v).map(|(r, v)| f64::from(r * r / v)).sum();
        let product: f64 = v.iter().map(|&v| f64::from(v)).product();
        assert!((distance / expected - 1.0).abs() < 1e-6 && (determinant / product - 1.0).abs() < 1e-6);
    }
}
