//! What the values that wear hardly moves are on one asset when it is healthy.

use super::baseline::{Baseline, HealthyFeature};
use super::healthy::SpeedKernels;
use super::novelty::Deviation;
use crate::library::Ensemble;
use flankwatch_signal::Features;

/// Standard deviation of what the library may be wrong by in a check, and as a part of the change; half of the change that the library has
/// is expected, as the sensor's own noise does not change.
const CHECK_DISCREPANCY: f64 = 0.05;
const CHECK_RELATIVE_DISCREPANCY: f64 = 0.6;
const CHECK_PART: f64 = 0.5;

/// Wear that moves the mesh lines apart from each other moves what lies between them too, by something that no library
/// knows: this part of how far the lines have moved apart, by kind of check.
const MOVED_PARTS: [(&str, f64); 3] = [("ln_shaft_", 0.3), ("ln_tooth_", 0.5), ("ln_", 0.6)];

/// Checks in which a simulation without noise has rounding, and no wear.
const UNMOVED: [&str; 2] = ["ln_shaft_", "ln_tooth_"];

/// The fit of one check over the baseline's speeds.
#[derive(Debug, Clone)]
struct Check {
    name: String,
    kernel: usize,
    /// σ² of one record.
    variance: f64,
    /// b and K⁻¹(y − b).
    constant: f64,
    weights: Vec<f64>,
    /// Expected change by depth; one number without a library.
    change: Vec<f64>,
}

/// The checks of one baseline.
#[derive(Debug, Clone)]
pub(super) struct HealthyChecks {
    kernels: SpeedKernels,
    checks: Vec<Check>,
}

impl HealthyChecks {
    /// Fits a baseline whose speeds have these logarithms, for a grid of depths in µm.
    pub(super) fn new(baseline: &Baseline, log_speeds: Vec<f64>, ensemble: Option<&Ensemble>, depths_um: &[f64]) -> Self {
        let kernels = SpeedKernels::new(log_speeds);
        let fit = |feature: &HealthyFeature| {
            let values: Vec<f64> = feature.values.iter().map(|&value| f64::from(value)).collect();
            let evidence: Vec<f64> = (0..kernels.len()).map(|kernel| kernels.log_evidence(kernel, &values)).collect();
            let kernel = (0..evidence.len())
                .max_by(|&a, &b| evidence[a].total_cmp(&evidence[b]))
                .unwrap_or(0);
            let wears = !UNMOVED.iter().any(|kind| feature.name.starts_with(kind));
            let change = match ensemble.filter(|_| wears) {
                None => vec![0.0],
                Some(ensemble) => {
                    let library = ensemble.described();
                    let change = |um: &f64| CHECK_PART * library.check_change(&feature.name, *um).unwrap_or(0.0);
                    depths_um.iter().map(change).collect()
                }
            };
            let (constant, weights) = kernels.fit(kernel, &values);
            Check {
                name: feature.name.clone(),
                kernel,
                variance: kernels.variance(kernel, &values),
                constant,
                weights,
                change,
            }
        };
        let checks = baseline.checks.iter().map(fit).collect();
        Self { kernels, checks }
    }

    /// How each check of a record deviates from what is expected at a depth of the grid and a logarithm of the speed, where the mesh lines
    /// have moved apart by `moved`, a standard deviation of logarithms.
    pub(super) fn deviations(&self, record: &Features, log_speed: f64, depth: usize, moved: f64) -> Vec<Deviation> {
        let at = self.kernels.weights(log_speed);
        let deviation = |check: &Check| {
            let value = record.checks.get(&check.name)?;
            let change = check.change[depth.min(check.change.len() - 1)];
            let part = MOVED_PARTS
                .iter()
                .find(|(kind, _)| check.name.starts_with(kind))
                .map_or(0.0, |(_, part)| *part);
            let apart = part * moved;
            let wrong = CHECK_DISCREPANCY + CHECK_RELATIVE_DISCREPANCY * change.abs();
            Some(Deviation {
                name: check.name.clone(),
                residual: value - check.constant - at.path(check.kernel, &check.weights) - change,
                deviation: (wrong * wrong + apart * apart + check.variance * (1.0 + at.variance(check.kernel))).sqrt(),
            })
        };
        self.checks.iter().filter_map(deviation).collect()
    }

    /// Degrees of freedom of a check's scatter.
    pub(super) fn freedom(&self) -> f64 {
        self.kernels.freedom()
    }
}
