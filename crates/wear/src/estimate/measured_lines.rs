//! The mesh lines of one record, relative to the healthy ones.

use super::deviation::Deviation;
use crate::library::line_name;
use flankwatch_signal::Name;

/// Variance of a line in addition to the baseline's where wear is estimated from it: over its life, a healthy
/// machine changes more than during the baseline, most of all through load that is not recorded.
const AFTER_BASELINE: f64 = 0.02;

/// Largest line spread that counts.
const MAX_LINE_SPREAD: f64 = 1.5;

/// One line of a record.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeasuredLine {
    /// 0 is the first mesh harmonic.
    pub(super) index: usize,
    /// Logarithm of its amplitude over the healthy one at this speed and torque.
    pub(super) change: f64,
    /// Variance of the change without wear.
    pub(super) variance: f64,
    /// Least change that can be seen above the noise.
    pub(super) floor: f64,
}

impl MeasuredLine {
    /// Variance of the change for estimating wear.
    pub(super) fn variance_after_baseline(&self) -> f64 {
        AFTER_BASELINE + self.variance
    }
}

/// The lines of a record and its torque.
#[derive(Debug, Clone)]
pub(super) struct MeasuredLines {
    pub(super) lines: Vec<MeasuredLine>,
    /// Torque over the described one; 1 where it is not given.
    pub(super) load: f64,
}

impl MeasuredLines {
    /// Returns the lines' changes as deviations from the healthy ones, regardless of wear.
    pub(super) fn deviations(&self) -> impl Iterator<Item = Deviation> {
        self.lines.iter().map(|line| Deviation {
            name: line_name(line.index),
            residual: line.change,
            deviation: line.variance.sqrt(),
        })
    }

    /// Returns the lines' frequencies in hertz by name, for a mesh frequency in hertz.
    pub(super) fn frequencies_hz(&self, mesh_hz: f64) -> Vec<(Name, f64)> {
        let lines = self.lines.iter();
        lines.map(|line| (line_name(line.index), (line.index + 1) as f64 * mesh_hz)).collect()
    }

    /// Standard deviation of the lines' changes beyond their scatter. A change of the sensor's gain, which
    /// moves all lines alike, does not affect it.
    pub(super) fn line_spread(&self) -> f64 {
        let count = self.lines.len().max(2) as f64;
        let mean = self.lines.iter().map(|line| line.change).sum::<f64>() / count;
        let square: f64 = self.lines.iter().map(|line| (line.change - mean).powi(2) - line.variance).sum();
        (square / (count - 1.0)).max(0.0).sqrt().min(MAX_LINE_SPREAD)
    }
}
