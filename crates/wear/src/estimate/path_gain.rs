//! What the transmission path does to each line, learnt from every record.
//!
//! An unknown path multiplies each line by its gain at that line's frequency, which changes with the speed where a structure's resonance lies near. The
//! gain's logarithm is a constant plus a Gaussian process over the logarithm of the speed, held at a few nodes; recursive least squares takes
//! one record after another. How sure the gain is at a speed is the same under every hypothesis, what it is is not: each
//! hypothesis takes its own change off the measured line first.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Nodes over the speeds of the baseline and somewhat beyond.
const NODES: usize = 11;

/// How far the nodes reach beyond the baseline's speeds, in the logarithm, and the least half of their range.
const MARGIN: f64 = 0.015;
const LEAST_HALF_RANGE: f64 = 0.02;

/// Variances of the logarithm of the gain over the speed, and the lengths in the logarithm of the speed that they belong to (Matérn 3/2):
/// half-widths of resonances of 0.8 and 3 % damping.
const PROCESS: [(f64, f64); 2] = [(0.05, 0.008), (0.15, 0.03)];

/// Variance of the constant around the baseline's mean.
const CONSTANT_VARIANCE: f64 = 1.0;

/// Nodes and the constant.
pub(super) const WEIGHTS: usize = NODES + 1;

/// Numbers of a symmetric matrix's upper triangle.
const TRIANGLE: usize = WEIGHTS * (WEIGHTS + 1) / 2;

/// A residual counts in full up to this many standard deviations.
const FULL_WEIGHT: f64 = 3.0;

/// The nodes for one baseline.
#[derive(Debug, Clone)]
pub(super) struct SpeedBasis {
    nodes: DVector<f64>,
    covariance: DMatrix<f64>,
    inverse: DMatrix<f64>,
}

/// Where a speed stands to the nodes.
#[derive(Debug, Clone)]
pub(super) struct SpeedPlace {
    /// How much each weight counts; the constant's last.
    weights: [f64; WEIGHTS],
    /// Variance that the nodes do not explain.
    unexplained: f64,
}

fn kernel(distance: f64) -> f64 {
    let terms = PROCESS.iter().map(|(variance, length)| {
        let r = 3.0_f64.sqrt() * distance.abs() / length;
        variance * (1.0 + r) * (-r).exp()
    });
    terms.sum()
}

impl SpeedBasis {
    /// Nodes for these logarithms of speeds.
    pub(super) fn over(log_speeds: &[f64]) -> Self {
        let low = log_speeds.iter().copied().fold(f64::INFINITY, f64::min);
        let high = log_speeds.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (middle, half) = if low <= high {
            (0.5 * (low + high), (0.5 * (high - low) + MARGIN).max(LEAST_HALF_RANGE))
        } else {
            (0.0, LEAST_HALF_RANGE)
        };
        let nodes = DVector::from_fn(NODES, |i, _| middle + half * (2.0 * i as f64 / (NODES - 1) as f64 - 1.0));
        let covariance = DMatrix::from_fn(NODES, NODES, |i, j| kernel(nodes[i] - nodes[j]) + if i == j { 1e-6 } else { 0.0 });
        let inverse = covariance
            .clone()
            .cholesky()
            .map_or_else(|| DMatrix::identity(NODES, NODES), |factors| factors.inverse());
        Self {
            nodes,
            covariance,
            inverse,
        }
    }

    /// Where the logarithm of a speed stands.
    pub(super) fn place(&self, log_speed: f64) -> SpeedPlace {
        let near = self.nodes.map(|node| kernel(log_speed - node));
        let solved = &self.inverse * &near;
        let mut weights = [1.0; WEIGHTS];
        weights[..NODES].copy_from_slice(solved.as_slice());
        SpeedPlace {
            weights,
            unexplained: (kernel(0.0) - near.dot(&solved)).max(0.0),
        }
    }
}

/// What is known of the gain of each line under each hypothesis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct PathGain {
    lines: usize,
    /// Upper triangles of the weights' covariances, by line.
    covariance: Vec<f32>,
    /// Weights by hypothesis and line.
    weights: Vec<f32>,
}

/// How sure the gain of each line is at one speed.
pub(super) struct GainAt {
    place: SpeedPlace,
    /// Covariance times the place, by line.
    along: Vec<[f64; WEIGHTS]>,
    /// Variance of the gain, by line.
    pub(super) variance: Vec<f64>,
}

impl PathGain {
    /// Before any record: constants around these means, one a line.
    pub(super) fn around(means: &[f64], basis: &SpeedBasis, hypotheses: usize) -> Self {
        let mut triangle = Vec::with_capacity(TRIANGLE);
        for i in 0..WEIGHTS {
            for j in i..WEIGHTS {
                triangle.push(match (i < NODES, j < NODES) {
                    (true, true) => basis.covariance[(i, j)] as f32,
                    (false, false) => CONSTANT_VARIANCE as f32,
                    _ => 0.0,
                });
            }
        }
        let of_line = |mean: &f64| {
            let mut weights = [0.0; WEIGHTS];
            weights[NODES] = *mean as f32;
            weights
        };
        Self {
            lines: means.len(),
            covariance: triangle.repeat(means.len()),
            weights: means.iter().flat_map(of_line).collect::<Vec<f32>>().repeat(hypotheses),
        }
    }

    /// Whether it is about so many lines and hypotheses.
    pub(super) fn fits(&self, lines: usize, hypotheses: usize) -> bool {
        self.lines == lines && self.covariance.len() == lines * TRIANGLE && self.weights.len() == hypotheses * lines * WEIGHTS
    }

    /// How sure the gains are at a place.
    pub(super) fn at(&self, place: SpeedPlace) -> GainAt {
        let mut along = Vec::with_capacity(self.lines);
        let mut variance = Vec::with_capacity(self.lines);
        for triangle in self.covariance.chunks_exact(TRIANGLE) {
            let mut product = [0.0; WEIGHTS];
            let mut entries = triangle.iter();
            for i in 0..WEIGHTS {
                for (j, entry) in (i..WEIGHTS).zip(&mut entries) {
                    let entry = f64::from(*entry);
                    product[i] += entry * place.weights[j];
                    if j > i {
                        product[j] += entry * place.weights[i];
                    }
                }
            }
            let known: f64 = product.iter().zip(&place.weights).map(|(p, w)| p * w).sum();
            variance.push(known.max(0.0) + place.unexplained);
            along.push(product);
        }
        GainAt { place, along, variance }
    }

    /// Logarithm of the gain of a line under a hypothesis.
    pub(super) fn gain(&self, at: &GainAt, hypothesis: usize, line: usize) -> f64 {
        let first = (hypothesis * self.lines + line) * WEIGHTS;
        let weights = &self.weights[first..first + WEIGHTS];
        weights.iter().zip(&at.place.weights).map(|(w, place)| f64::from(*w) * place).sum()
    }

    /// Takes a record's residuals (measured less expected, by hypothesis and line, NaN where a line is missing) with variances beside that of
    /// the gain, by line. What the `leading` hypothesis finds odd counts less.
    pub(super) fn learn(&mut self, at: &GainAt, residuals: &[f64], variance: &[f64], leading: usize) {
        for line in 0..self.lines {
            let residual = residuals[leading * self.lines + line];
            if !residual.is_finite() {
                continue;
            }
            let expected = variance[line] + at.variance[line];
            let odd = (residual * residual / (FULL_WEIGHT * FULL_WEIGHT * expected)).max(1.0);
            let total = variance[line] * odd + at.variance[line];
            let along = &at.along[line];
            for (hypothesis, residuals) in residuals.chunks_exact(self.lines).enumerate() {
                let step = residuals[line] / total;
                let first = (hypothesis * self.lines + line) * WEIGHTS;
                for (weight, along) in self.weights[first..first + WEIGHTS].iter_mut().zip(along) {
                    *weight += (along * step) as f32;
                }
            }
            let mut entries = self.covariance[line * TRIANGLE..(line + 1) * TRIANGLE].iter_mut();
            for i in 0..WEIGHTS {
                for (j, entry) in (i..WEIGHTS).zip(&mut entries) {
                    *entry = (f64::from(*entry) - along[i] * along[j] / total) as f32;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same by Gaussian process regression over all records at once: K(x*, x)(K + σ²I)⁻¹y with K from the nodes.
    #[test]
    fn one_by_one_is_all_at_once() {
        let speeds: Vec<f64> = (0..40).map(|i| 0.03 * (f64::from(i) * 0.7).sin()).collect();
        let values: Vec<f64> = speeds.iter().map(|x| 0.4 + (60.0 * x).sin() + 20.0 * x).collect();
        let basis = SpeedBasis::over(&speeds);
        let mut gain = PathGain::around(&[0.4], &basis, 2);
        // So much that no record is odd.
        let noise = 0.1;
        for (x, y) in speeds.iter().zip(&values) {
            let at = gain.at(basis.place(*x));
            // The second hypothesis takes 0.5 off each record.
            let residuals = [y - gain.gain(&at, 0, 0), y - 0.5 - gain.gain(&at, 1, 0)];
            gain.learn(&at, &residuals, &[noise], 0);
        }
        let rows: Vec<[f64; WEIGHTS]> = speeds.iter().map(|x| basis.place(*x).weights).collect();
        let prior = |a: &[f64; WEIGHTS], b: &[f64; WEIGHTS]| {
            let nodes = |w: &[f64; WEIGHTS]| DVector::from_row_slice(&w[..NODES]);
            (nodes(a).transpose() * &basis.covariance * nodes(b))[(0, 0)] + CONSTANT_VARIANCE * a[NODES] * b[NODES]
        };
        let k = DMatrix::from_fn(40, 40, |i, j| prior(&rows[i], &rows[j]) + if i == j { noise } else { 0.0 });
        let solved = k.lu().solve(&DVector::from_iterator(40, values.iter().map(|y| y - 0.4))).unwrap();
        for x in [-0.02, 0.0, 0.013] {
            let at = gain.at(basis.place(x));
            let here = basis.place(x).weights;
            let expected = 0.4 + (0..40).map(|i| prior(&here, &rows[i]) * solved[i]).sum::<f64>();
            assert!(
                (gain.gain(&at, 0, 0) - expected).abs() < 2e-3,
                "{x}: {} {expected}",
                gain.gain(&at, 0, 0)
            );
            assert!((gain.gain(&at, 0, 0) - gain.gain(&at, 1, 0) - 0.5).abs() < 0.02);
            assert!(at.variance[0] < 0.05);
        }
    }

    #[test]
    fn far_from_the_baselines_speeds_the_gain_is_not_known() {
        let basis = SpeedBasis::over(&[0.0, 0.001]);
        let mut gain = PathGain::around(&[1.0], &basis, 1);
        for _ in 0..20 {
            let at = gain.at(basis.place(0.0));
            gain.learn(&at, &[0.0], &[0.01], 0);
        }
        let (near, far) = (gain.at(basis.place(0.0)).variance[0], gain.at(basis.place(0.5)).variance[0]);
        assert!(near < 0.002 && far > 0.15, "{near} {far}");
    }

    #[test]
    fn an_odd_record_moves_the_gain_little_and_a_missing_line_not_at_all() {
        let basis = SpeedBasis::over(&[0.0]);
        let mut gain = PathGain::around(&[0.0], &basis, 1);
        let mut take = |residual: f64| {
            let at = gain.at(basis.place(0.0));
            gain.learn(&at, &[residual], &[0.01], 0);
            gain.gain(&gain.at(basis.place(0.0)), 0, 0)
        };
        for _ in 0..50 {
            take(0.0);
        }
        let before = take(0.0);
        assert_eq!(take(f64::NAN), before);
        assert!(take(5.0) < 0.02);
    }
}
