//! One record against all hypotheses at all depths.

use super::super::path_gain::{GainAt, PathGain};
use super::{Hypotheses, LANES, OPERATING_DISCREPANCY};
use crate::library::Ensemble;
use flankwatch_signal::Features;

/// Degrees of freedom of the likelihood: heavy tails, so that one odd line does not decide.
const DEGREES_OF_FREEDOM: f64 = 6.0;

/// A record against all hypotheses.
pub(in crate::estimate) struct Compared {
    /// Logarithm of the likelihood by hypothesis and depth.
    pub(in crate::estimate) log_likelihood: Vec<f64>,
    /// Lines that the record has.
    pub(in crate::estimate) lines: usize,
    pub(in crate::estimate) gain: GainAt,
    /// Line less gain, by hypothesis and line, padded; NaN where a line is missing.
    measured: Vec<f32>,
    /// Expected line and its variance by member, depth and line, padded; an infinite variance where a line is missing.
    expected: Vec<Vec<f32>>,
    variance: Vec<Vec<f32>>,
    /// Variance of a line's own scatter.
    scatter: Vec<f64>,
}

impl Compared {
    /// Hypothesis and depth that explain the record best.
    pub(in crate::estimate) fn best(&self, depths: usize) -> (usize, usize) {
        let highest = (0..self.log_likelihood.len()).max_by(|&a, &b| self.log_likelihood[a].total_cmp(&self.log_likelihood[b]));
        highest.map_or((0, 0), |index| (index / depths, index % depths))
    }
}

/// One feature of a record against what was expected.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::estimate) struct Deviation {
    pub(in crate::estimate) name: String,
    /// Measured less expected, in logarithms.
    pub(in crate::estimate) residual: f64,
    /// Standard deviation of what was expected.
    pub(in crate::estimate) deviation: f64,
}

impl Hypotheses {
    /// Logarithms of likelihood of a record under every hypothesis at every depth, with what is known of the path.
    pub(in crate::estimate) fn compare(&self, record: &Features, ensemble: &Ensemble, path: &PathGain) -> Compared {
        let gain = path.at(self.basis.place(self.log_speed(record)));
        let values: Vec<f64> = self
            .lines
            .iter()
            .map(|line| record.values.get(&line.name).copied().unwrap_or(f64::NAN))
            .collect();
        let scatter: Vec<f64> = values.iter().enumerate().map(|(line, value)| self.scatter(line, *value)).collect();
        let lines = values.iter().filter(|value| value.is_finite()).count();
        let mut compared = Compared {
            log_likelihood: Vec::with_capacity(self.all.len() * self.depths),
            lines,
            gain,
            measured: vec![f32::NAN; self.all.len() * self.width],
            expected: Vec::new(),
            variance: Vec::new(),
            scatter,
        };
        // By member and depth: 1/v by line, and −½ Σ ln v.
        let mut weight = Vec::with_capacity(self.expected.len());
        let mut spread = Vec::with_capacity(self.expected.len());
        let point = [record.operating_point.shaft_speed_hz, record.operating_point.torque_nm];
        for (member, expected) in self.expected.iter().enumerate() {
            let shift = self.shift(member, ensemble, point);
            let (mut sum, mut variance) = (expected.change.clone(), expected.doubt.clone());
            let (mut inverse, mut logs) = (vec![0.0_f32; sum.len()], Vec::with_capacity(self.depths));
            for depth in 0..self.depths {
                let mut product = 1.0;
                for (line, value) in values.iter().enumerate() {
                    let i = depth * self.width + line;
                    sum[i] += shift[i];
                    let moved = OPERATING_DISCREPANCY * f64::from(shift[i]);
                    let v = f64::from(variance[i]) + moved * moved + compared.scatter[line] + compared.gain.variance[line];
                    variance[i] = v as f32;
                    if value.is_finite() {
                        inverse[i] = (1.0 / v) as f32;
                        product *= v;
                    }
                }
                logs.push(-0.5 * product.max(f64::MIN_POSITIVE).ln());
            }
            compared.expected.push(sum);
            compared.variance.push(variance);
            weight.push(inverse);
            spread.push(logs);
        }
        let mut measured = vec![0.0_f32; self.width];
        for (index, hypothesis) in self.all.iter().enumerate() {
            for (line, value) in values.iter().enumerate() {
                let less_gain = (value - path.gain(&compared.gain, index, line)) as f32;
                compared.measured[index * self.width + line] = less_gain;
                measured[line] = if less_gain.is_finite() { less_gain } else { 0.0 };
            }
            let member = hypothesis.member;
            for (depth, spread) in spread[member].iter().enumerate() {
                let row = depth * self.width..(depth + 1) * self.width;
                let distance = misfit(&measured, &compared.expected[member][row.clone()], &weight[member][row]);
                let tail = 0.5 * (DEGREES_OF_FREEDOM + lines as f64) * (distance / DEGREES_OF_FREEDOM).ln_1p();
                compared.log_likelihood.push(spread - tail);
            }
        }
        compared
    }

    /// What is left of each line under each hypothesis when the change at its own mean depth is taken off, for learning the path, and the
    /// variance of that: `probability` over depths by hypothesis, of which `leading` says how uncertain the change is.
    pub(in crate::estimate) fn left(&self, compared: &Compared, probability: &[Vec<f64>], leading: usize) -> (Vec<f64>, Vec<f64>) {
        let lines = self.lines.len();
        let mut residuals = Vec::with_capacity(self.all.len() * lines);
        let mut variance = compared.scatter.clone();
        for (index, (hypothesis, probability)) in self.all.iter().zip(probability).enumerate() {
            let expected = &compared.expected[hypothesis.member];
            for line in 0..lines {
                let likely = || probability.iter().enumerate().filter(|(_, p)| **p > 0.0);
                let mean: f64 = likely().map(|(depth, p)| p * f64::from(expected[depth * self.width + line])).sum();
                residuals.push(f64::from(compared.measured[index * self.width + line]) - mean);
                if index == leading {
                    let of_all = &compared.variance[hypothesis.member];
                    let own: f64 = likely()
                        .map(|(depth, p)| {
                            let i = depth * self.width + line;
                            p * (f64::from(of_all[i]) + (f64::from(expected[i]) - mean).powi(2))
                        })
                        .sum();
                    variance[line] = (own - compared.gain.variance[line]).max(compared.scatter[line]);
                }
            }
        }
        (residuals, variance)
    }

    /// How each line and check of a record deviates from what a hypothesis expects at a depth of the grid; without a comparison the lines
    /// are left out.
    pub(in crate::estimate) fn deviations(&self, record: &Features, state: Option<(&Compared, (usize, usize))>) -> [Vec<Deviation>; 2] {
        let mut lines = Vec::new();
        if let Some((compared, (hypothesis, depth))) = state {
            let member = self.all[hypothesis].member;
            for (line, known) in self.lines.iter().enumerate() {
                let i = depth * self.width + line;
                let residual = f64::from(compared.measured[hypothesis * self.width + line] - compared.expected[member][i]);
                if residual.is_finite() {
                    lines.push(Deviation {
                        name: known.name.clone(),
                        residual,
                        deviation: f64::from(compared.variance[member][i]).sqrt(),
                    });
                }
            }
        }
        let depth = state.map_or(0, |(_, (_, depth))| depth);
        [lines, self.checks.deviations(record, self.log_speed(record), depth)]
    }

    /// The depths around one of the grid that a single record of this operating range cannot tell from it: their expected lines differ by less than
    /// two standard deviations in all.
    pub(in crate::estimate) fn resolved(&self, compared: &Compared, (hypothesis, depth): (usize, usize)) -> [usize; 2] {
        let member = self.all[hypothesis].member;
        let (expected, variance) = (&compared.expected[member], &compared.variance[member]);
        let alike = |other: usize| {
            let distance: f64 = (0..self.lines.len())
                .map(|line| {
                    let apart = f64::from(expected[other * self.width + line] - expected[depth * self.width + line]);
                    apart * apart / f64::from(variance[depth * self.width + line])
                })
                .sum();
            distance < 4.0
        };
        let low = (0..depth).rev().take_while(|&other| alike(other)).last().unwrap_or(depth);
        let high = (depth + 1..self.depths).take_while(|&other| alike(other)).last().unwrap_or(depth);
        [low, high]
    }
}

/// Σ r²·w over lines. The groups' partial results let the processor work on several lines at once.
fn misfit(measured: &[f32], expected: &[f32], weight: &[f32]) -> f64 {
    let mut distance = [0.0_f32; LANES];
    let groups = measured
        .chunks_exact(LANES)
        .zip(expected.chunks_exact(LANES))
        .zip(weight.chunks_exact(LANES));
    for ((measured, expected), weight) in groups {
        for lane in 0..LANES {
            let r = measured[lane] - expected[lane];
            distance[lane] += r * r * weight[lane];
        }
    }
    distance.iter().map(|&d| f64::from(d)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misfit_is_the_weighted_sum_of_squares() {
        let r: Vec<f32> = (0..16).map(|i| i as f32 * 0.1).collect();
        let w: Vec<f32> = (0..16).map(|i| 0.5 + i as f32 * 0.1).collect();
        let expected: f64 = r.iter().zip(&w).map(|(r, w)| f64::from(r * r * w)).sum();
        assert!((misfit(&r, &[0.0; 16], &w) / expected - 1.0).abs() < 1e-6);
    }
}
