//! Deviations of a record's values from their expectation, and their probability by chance.

use flankwatch_signal::Name;

/// Deviation of one feature of a record from its expectation.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Deviation {
    pub(super) name: Name,
    /// Measured minus expected natural logarithm.
    pub(super) residual: f64,
    /// Standard deviation of the residual.
    pub(super) deviation: f64,
}

impl Deviation {
    /// Residual in standard deviations.
    pub(super) fn score(&self) -> f64 {
        self.residual / self.deviation
    }

    /// Magnitude of the normal deviate with about the same tail as this deviation has in Student's t
    /// distribution (Wallace 1959).
    pub(super) fn normal_score(&self, freedom: f64) -> f64 {
        let t = self.score();
        let z = (freedom * (t * t / freedom).ln_1p()).sqrt();
        z * (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)
    }
}

/// Normal deviate with the same upper tail as `value` has in the χ² distribution, after Wilson and Hilferty
/// (1931).
pub(super) fn chi_square_score(value: f64, freedom: usize) -> f64 {
    if freedom == 0 {
        return f64::NEG_INFINITY;
    }
    let part = 2.0 / (9.0 * freedom as f64);
    ((value / freedom as f64).cbrt() - (1.0 - part)) / part.sqrt()
}

/// Probability that a standard normal deviate exceeds `z`: ½ erfc(z/√2), for |z| > 2 by the continued
/// fraction of Mills' ratio, else by the series of Φ.
pub(super) fn normal_tail(z: f64) -> f64 {
    let density = (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt();
    if z > 2.0 {
        let fraction = (1..=60).rev().fold(0.0, |rest, k| f64::from(k) / (z + rest));
        return density / (z + fraction);
    }
    if z < -2.0 {
        return 1.0 - normal_tail(-z);
    }
    let (mut term, mut sum) = (z, z);
    for k in 1..60 {
        term *= z * z / f64::from(2 * k + 1);
        sum += term;
    }
    0.5 - density * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SciPy: norm.sf.
    #[test]
    fn normal_tails_are_those_of_scipy() {
        for (z, expected) in [
            (-3.0, 0.9986501019683699),
            (-1.0, 0.8413447460685429),
            (0.0, 0.5),
            (1.96, 0.024997895148220435),
            (3.0, 0.0013498980316300933),
            (8.0, 6.220960574271785e-16),
        ] {
            assert!((normal_tail(z) / expected - 1.0).abs() < 1e-9, "{z}: {}", normal_tail(z));
        }
    }

    /// SciPy: chi2.sf(30, 10) = 8.5664e-4, chi2.sf(10, 10) = 0.44049, chi2.sf(40, 20) = 4.995e-3; Wilson and
    /// Hilferty's is within a tenth.
    #[test]
    fn chi_square_tails_are_near_those_of_scipy() {
        for (value, freedom, expected) in
            [(30.0, 10, 8.566412e-4), (10.0, 10, 0.440493), (40.0, 20, 4.995e-3)]
        {
            let got = normal_tail(chi_square_score(value, freedom));
            assert!((got / expected - 1.0).abs() < 0.1, "{value} {freedom}: {got}");
        }
        assert_eq!(normal_tail(chi_square_score(5.0, 0)), 1.0);
    }
}
