//! The healthy state of one asset: each feature as a smooth function of the speed, with its scatter.
//!
//! An unknown transmission path multiplies each line by its gain at the line's frequency. Near a resonance of
//! the structure, the gain changes by a factor within a few per cent of speed. The gain's logarithm is
//! therefore modelled as a Gaussian process over the logarithm of the speed: y = b + g(x) + ε, where g has
//! the covariance ρσ²·(1 + √3 r)e^(−√3 r) with r = |x − x′|/ℓ (Matérn 3/2). The constant b has a flat prior,
//! σ² an inverse gamma one. ρ and ℓ are chosen per feature by marginal likelihood.

use nalgebra::{DMatrix, DVector};

/// Correlation lengths in the logarithm of the speed: half-widths of resonances of 0.4 to 3 % damping.
const LENGTHS: [f64; 3] = [0.004, 0.01, 0.03];

/// Variances of g over that of ε: ρ.
const RATIOS: [f64; 4] = [1.0, 5.0, 25.0, 125.0];

/// Logarithm of the prior odds of each ratio above 0 against 0.
const PATH_LOG_ODDS: f64 = -1.0;

/// Prior of σ²: worth this many observations with this deviation.
const PRIOR_COUNT: f64 = 3.0;
const PRIOR_DEVIATION: f64 = 0.05;

/// Kernel with one choice of ρ and ℓ over the baseline's speeds.
#[derive(Debug, Clone)]
struct Kernel {
    ratio: f64,
    length: f64,
    /// K⁻¹, K = ρR + I.
    inverse: DMatrix<f64>,
    /// K⁻¹1 and 1ᵀK⁻¹1.
    row_sums: DVector<f64>,
    total: f64,
    /// −½ ln|K| − ½ ln 1ᵀK⁻¹1 plus the logarithm of the prior odds.
    log_weight: f64,
}

/// The kernels for the speeds of one baseline.
#[derive(Debug, Clone)]
pub(super) struct SpeedKernels {
    log_speeds: Vec<f64>,
    kernels: Vec<Kernel>,
}

/// Weights of the baseline's records at a record's speed, for each kernel.
pub(super) struct SpeedWeights {
    /// For each kernel ρ·R(x*, x), and the variance of b + g(x*) over σ².
    by_kernel: Vec<(Vec<f64>, f64)>,
}

impl SpeedKernels {
    /// Creates the kernels for the logarithms of the baseline's speeds.
    pub(super) fn new(log_speeds: Vec<f64>) -> Self {
        let choices = [(0.0, 1.0)].into_iter();
        let choices = choices
            .chain(LENGTHS.iter().flat_map(|&length| RATIOS.iter().map(move |&ratio| (ratio, length))));
        let kernels = choices.filter_map(|(ratio, length)| Kernel::new(&log_speeds, ratio, length)).collect();
        Self { log_speeds, kernels }
    }

    /// Log marginal likelihood of residuals under a kernel, with σ² integrated out.
    pub(super) fn log_evidence(&self, kernel: usize, residuals: &[f64]) -> f64 {
        let square = self.square(kernel, residuals);
        self.kernels[kernel].log_weight
            - 0.5 * self.freedom() * (square + PRIOR_COUNT * PRIOR_DEVIATION.powi(2)).ln()
    }

    /// Number of kernels to choose from.
    pub(super) fn len(&self) -> usize {
        self.kernels.len()
    }

    /// Posterior mean of σ² after these residuals.
    pub(super) fn variance(&self, kernel: usize, residuals: &[f64]) -> f64 {
        (self.square(kernel, residuals) + PRIOR_COUNT * PRIOR_DEVIATION.powi(2)) / self.freedom()
    }

    /// Degrees of freedom of the predictive distribution.
    pub(super) fn freedom(&self) -> f64 {
        self.log_speeds.len() as f64 - 1.0 + PRIOR_COUNT
    }

    /// Returns the fitted constant b and K⁻¹(y − b).
    pub(super) fn fit(&self, kernel: usize, residuals: &[f64]) -> (f64, Vec<f64>) {
        let kernel = &self.kernels[kernel];
        let y = DVector::from_column_slice(residuals);
        let constant = kernel.row_sums.dot(&y) / kernel.total;
        let weights = &kernel.inverse * y.add_scalar(-constant);
        (constant, weights.as_slice().to_vec())
    }

    /// Returns the weights at this logarithm of the speed.
    pub(super) fn weights(&self, log_speed: f64) -> SpeedWeights {
        let by_kernel = self.kernels.iter().map(|kernel| {
            let near: Vec<f64> =
                self.log_speeds.iter().map(|x| kernel.ratio * kernel.correlation(log_speed - x)).collect();
            let k = DVector::from_column_slice(&near);
            let solved = &kernel.inverse * &k;
            let unexplained = (kernel.ratio - k.dot(&solved)).max(0.0);
            let variance = unexplained + (1.0 - solved.sum()).powi(2) / kernel.total;
            (near, variance)
        });
        SpeedWeights { by_kernel: by_kernel.collect() }
    }

    fn square(&self, kernel: usize, residuals: &[f64]) -> f64 {
        let kernel = &self.kernels[kernel];
        let y = DVector::from_column_slice(residuals);
        let whole = y.dot(&(&kernel.inverse * &y));
        (whole - kernel.row_sums.dot(&y).powi(2) / kernel.total).max(0.0)
    }
}

impl SpeedWeights {
    /// g(x*) for a feature with this kernel and these K⁻¹(y − b).
    pub(super) fn path(&self, kernel: usize, weights: &[f64]) -> f64 {
        self.by_kernel[kernel].0.iter().zip(weights).map(|(k, w)| k * w).sum()
    }

    /// Variance of b + g(x*) over σ².
    pub(super) fn variance(&self, kernel: usize) -> f64 {
        self.by_kernel[kernel].1
    }
}

impl Kernel {
    fn new(log_speeds: &[f64], ratio: f64, length: f64) -> Option<Self> {
        let count = log_speeds.len();
        let mut kernel = Self {
            ratio,
            length,
            inverse: DMatrix::zeros(0, 0),
            row_sums: DVector::zeros(0),
            total: 0.0,
            log_weight: 0.0,
        };
        let covariance = DMatrix::from_fn(count, count, |i, j| {
            ratio * kernel.correlation(log_speeds[i] - log_speeds[j]) + f64::from(u8::from(i == j))
        });
        let factor = covariance.cholesky()?;
        let log_determinant = 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        kernel.inverse = factor.inverse();
        kernel.row_sums = kernel.inverse.column_sum();
        kernel.total = kernel.row_sums.sum();
        let prior = if ratio > 0.0 { PATH_LOG_ODDS } else { 0.0 };
        kernel.log_weight = prior - 0.5 * log_determinant - 0.5 * kernel.total.ln();
        Some(kernel)
    }

    fn correlation(&self, distance: f64) -> f64 {
        let r = 3.0_f64.sqrt() * distance.abs() / self.length;
        (1.0 + r) * (-r).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without a path, the fit is the mean, and the variance includes the prior's three observations.
    #[test]
    fn without_a_path_the_fit_is_the_mean() {
        let kernels = SpeedKernels::new(vec![0.0, 0.01, -0.02, 0.005]);
        let y = [1.0, 2.0, 3.0, 6.0];
        let (constant, _) = kernels.fit(0, &y);
        assert!((constant - 3.0).abs() < 1e-12);
        // Σ(y − 3)² = 14, prior 3·0.05².
        assert!((kernels.variance(0, &y) - (14.0 + 0.0075) / 6.0).abs() < 1e-12);
        let weights = kernels.weights(0.3);
        assert!((weights.variance(0) - 0.25).abs() < 1e-12);
    }

    /// A resonance's gain over the speed is learnt: the Gaussian process has the higher evidence and predicts
    /// between the baseline's speeds.
    #[test]
    fn a_resonance_is_learnt_from_the_baseline() {
        let gain = |x: f64| -0.5 * (1.0 + (x / 0.01).powi(2)).ln();
        let speeds: Vec<f64> = (0..24).map(|i| -0.03 + 0.06 * f64::from(i * 7 % 24) / 23.0).collect();
        let y: Vec<f64> =
            speeds.iter().enumerate().map(|(i, x)| gain(*x) + 0.01 * (i as f64 * 2.3).sin()).collect();
        let kernels = SpeedKernels::new(speeds);
        let best = (0..kernels.len())
            .max_by(|a, b| kernels.log_evidence(*a, &y).total_cmp(&kernels.log_evidence(*b, &y)))
            .unwrap();
        assert!(best > 0);
        let (constant, weights) = kernels.fit(best, &y);
        for x in [-0.025, -0.004, 0.001, 0.012, 0.028] {
            let got = constant + kernels.weights(x).path(best, &weights);
            assert!((got - gain(x)).abs() < 0.06, "{x}: {got} {}", gain(x));
        }
        // Far from all speeds of the baseline the path is unknown.
        assert!(kernels.weights(0.5).variance(best) > 0.9 * kernels.weights(5.0).variance(best));
    }

    #[test]
    fn one_speed_for_all_records_gives_finite_evidence() {
        let kernels = SpeedKernels::new(vec![0.0; 20]);
        let y: Vec<f64> = (0..20).map(|i| 0.1 * f64::from(i % 3)).collect();
        assert!((0..kernels.len()).all(|k| kernels.log_evidence(k, &y).is_finite()));
    }
}
