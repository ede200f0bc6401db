//! How well each wear depth explains one record.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::baseline::Baseline;
use crate::library::Library;
use crate::signal::Features;

/// Degrees of freedom of the Student-t likelihood: heavy tails, so that one odd record does not decide.
const DEGREES_OF_FREEDOM: f64 = 5.0;

/// Standard deviation that the library is allowed to be wrong by, per feature, whatever the change.
const DISCREPANCY: f64 = 0.15;

/// The same, as a part of the change that the library predicts.
const RELATIVE_DISCREPANCY: f64 = 0.3;

/// Factor on the discrepancy of features that the transmission path does not leave alone (RMS, kurtosis, sums of lines).
const PATH_DEPENDENT: f64 = 3.0;

/// Predicted change of one feature over the tracking grid, relative to unworn.
struct Curve {
    index: usize,
    changes: Vec<f64>,
    discrepancy_factor: f64,
}

/// Compares a record with every wear depth of a grid.
pub(super) struct Likelihood<'a> {
    baseline: &'a Baseline,
    curves: Vec<Curve>,
    points: usize,
}

impl<'a> Likelihood<'a> {
    /// Prepares the comparison for a grid of wear depths in µm.
    pub(super) fn new(baseline: &'a Baseline, library: &Library, grid_um: &[f64]) -> Self {
        let depths: Vec<f64> = library.states().iter().map(|state| state.wear_um).collect();
        let library_curves: BTreeMap<&str, Vec<f64>> = library.feature_curves();
        let curves = baseline
            .names
            .iter()
            .enumerate()
            .filter_map(|(index, name)| {
                let curve = library_curves.get(name.as_str())?;
                let changes = grid_um.iter().map(|&um| interpolate(&depths, curve, um) - curve[0]).collect();
                let discrepancy_factor = if name.starts_with("ln_mesh_") { 1.0 } else { PATH_DEPENDENT };
                Some(Curve {
                    index,
                    changes,
                    discrepancy_factor,
                })
            })
            .collect();
        Self {
            baseline,
            curves,
            points: grid_um.len(),
        }
    }

    /// Features that both the baseline and the library have.
    pub(super) fn features(&self) -> usize {
        self.curves.len()
    }

    /// Log-likelihood of each wear depth; `None` if the record has none of the features.
    pub(super) fn of(&self, record: &Features) -> Option<Vec<f64>> {
        let present: Vec<(&Curve, f64)> = self
            .curves
            .iter()
            .filter_map(|curve| Some((curve, *record.values.get(&self.baseline.names[curve.index])?)))
            .collect();
        if present.is_empty() {
            return None;
        }
        let indices: Vec<usize> = present.iter().map(|(curve, _)| curve.index).collect();
        // The baseline's mean is itself uncertain by one n-th of the scatter.
        let scatter = self.baseline.covariance_of(&indices) * (1.0 + 1.0 / self.baseline.records as f64);
        Some((0..self.points).map(|point| self.at(point, &present, &scatter)).collect())
    }

    fn at(&self, point: usize, present: &[(&Curve, f64)], scatter: &DMatrix<f64>) -> f64 {
        let mut covariance = scatter.clone();
        let mut residual = DVector::zeros(present.len());
        for (i, (curve, value)) in present.iter().enumerate() {
            let change = curve.changes[point];
            let (expected, sensitivity) = self.expected(curve, change);
            residual[i] = value - expected;
            let discrepancy = (DISCREPANCY + RELATIVE_DISCREPANCY * change.abs()) * curve.discrepancy_factor * sensitivity;
            covariance[(i, i)] += discrepancy * discrepancy;
        }
        let dimension = present.len() as f64;
        let Some(factor) = covariance.cholesky() else {
            return f64::NEG_INFINITY;
        };
        let log_determinant = 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        let distance = factor.solve(&residual).dot(&residual);
        -0.5 * log_determinant - 0.5 * (DEGREES_OF_FREEDOM + dimension) * (distance / DEGREES_OF_FREEDOM).ln_1p()
    }

    /// The value a feature should have after a change, and how much of the change is left to see: a line that sinks into the
    /// noise stays at the noise.
    fn expected(&self, curve: &Curve, change: f64) -> (f64, f64) {
        let mean = self.baseline.mean[curve.index];
        let Some(noise) = self.baseline.background[curve.index] else {
            return (mean + change, 1.0);
        };
        let noise_power = (2.0 * noise).exp();
        let line_power = ((2.0 * mean).exp() - noise_power).max(0.0) * (2.0 * change).exp();
        (0.5 * (line_power + noise_power).ln(), line_power / (line_power + noise_power))
    }
}

/// Linear interpolation between rising nodes, held at the ends.
fn interpolate(nodes: &[f64], values: &[f64], x: f64) -> f64 {
    let upper = nodes.partition_point(|&node| node <= x);
    if upper == 0 {
        return values[0];
    }
    if upper == nodes.len() {
        return values[nodes.len() - 1];
    }
    let part = (x - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]);
    values[upper - 1] + part * (values[upper] - values[upper - 1])
}
