//! Healthy mesh lines of one asset, as functions of the speed.
//!
//! The transmission path multiplies each line by its gain, which changes with the speed near a resonance. The
//! gain is learnt from the baseline alone ([`SpeedKernels`]); outside the baseline's speeds it is as
//! uncertain as the fit says. Later records do not update it, since a change of the path cannot be
//! distinguished from wear.
//!
//! Where the torque of the records is known, a line is proportional to it, times a power of the torque that
//! is fitted to the baseline ([`TorquePower`]).

use super::baseline::{Baseline, HealthyFeature};
use super::common_movement::CommonMovement;
use super::healthy::SpeedKernels;
use super::measured_lines::{MeasuredLine, MeasuredLines};
use crate::library::{MESH_LINES, line_name};
use flankwatch_signal::Features;

/// Least standard deviation of a line between records.
const MIN_SCATTER: f64 = 0.08;

/// Variance of a line's logarithm over the squared ratio of the noise beside it to its amplitude: ½ for
/// Gaussian noise, and slightly more because the line is read at its highest point.
const NOISE_VARIANCE: f64 = 0.6;

/// Largest part of a healthy line's power that is attributed to noise.
const MAX_NOISE: f64 = 0.5;

/// Prior standard deviation of the power of the torque, beyond the first, with which an unworn line grows.
/// Simulated unworn pairs give 0.5 by the threshold rule and 1.5 under load, where the contact ratio grows
/// with the torque.
const TORQUE_POWER: f64 = 1.0;

/// The fit of one line over the baseline's speeds.
#[derive(Debug, Clone)]
struct Line {
    /// 0 is the first mesh harmonic.
    index: usize,
    kernel: usize,
    variance: f64,
    constant: f64,
    weights: Vec<f64>,
    torque: TorquePower,
    background: Option<f64>,
    /// Logarithm of the amplitude over the healthy one at which the line disappears in its noise.
    floor: f64,
}

/// Dependence of one healthy line on the torque, beyond proportionality.
#[derive(Debug, Clone, Copy)]
struct TorquePower {
    mean_log_torque: f64,
    power: f64,
    variance: f64,
}

impl TorquePower {
    /// Fits the power to the baseline's torques by least squares, with a prior around 0. Where the torque
    /// does not vary or is not known, the prior remains.
    fn fit(log_torques: &[f64], values: &[f64]) -> Self {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let (mean_log_torque, mean_value) = (mean(log_torques), mean(values));
        let pairs = log_torques.iter().zip(values).map(|(x, y)| (x - mean_log_torque, y - mean_value));
        let (square, product, scatter) =
            pairs.fold((0.0, 0.0, 0.0), |(xx, xy, yy), (x, y)| (xx + x * x, xy + x * y, yy + y * y));
        let scatter = (scatter / values.len().max(1) as f64).max(MIN_SCATTER * MIN_SCATTER);
        let precision = square + scatter / (TORQUE_POWER * TORQUE_POWER);
        Self { mean_log_torque, power: product / precision, variance: scatter / precision }
    }

    fn at(&self, log_torque: f64) -> f64 {
        self.power * (log_torque - self.mean_log_torque)
    }

    fn variance_at(&self, log_torque: f64) -> f64 {
        self.variance * (log_torque - self.mean_log_torque).powi(2)
    }
}

/// The lines of one baseline.
#[derive(Debug, Clone)]
pub(super) struct HealthyLines {
    kernels: SpeedKernels,
    lines: Vec<Line>,
    /// Set where no record has its torque.
    common_movement: Option<CommonMovement>,
    nominal_speed_hz: f64,
    nominal_torque_nm: f64,
}

impl HealthyLines {
    /// Fits the lines to a baseline; `nominal` are the described speed in hertz and torque in N·m.
    pub(super) fn new(baseline: &Baseline, nominal: [f64; 2]) -> Self {
        let [nominal_speed_hz, nominal_torque_nm] = nominal;
        let log_speeds =
            baseline.points.iter().map(|point| relative(point[0], nominal_speed_hz).ln()).collect();
        let kernels = SpeedKernels::new(log_speeds);
        let log_loads: Vec<f64> =
            baseline.points.iter().map(|point| relative(point[1], nominal_torque_nm).ln()).collect();
        let fit = |(index, feature): (usize, &HealthyFeature)| {
            let mut values: Vec<f64> =
                feature.values.iter().zip(&log_loads).map(|(value, load)| f64::from(*value) - load).collect();
            let torque = TorquePower::fit(&log_loads, &values);
            values.iter_mut().zip(&log_loads).for_each(|(value, load)| *value -= torque.at(*load));
            let evidence: Vec<f64> =
                (0..kernels.len()).map(|kernel| kernels.log_evidence(kernel, &values)).collect();
            let kernel =
                (0..evidence.len()).max_by(|&a, &b| evidence[a].total_cmp(&evidence[b])).unwrap_or(0);
            let (constant, weights) = kernels.fit(kernel, &values);
            let noise = feature
                .background
                .map_or(0.0, |background| (2.0 * (background - feature.mean())).exp().min(MAX_NOISE));
            Line {
                index,
                kernel,
                variance: kernels.variance(kernel, &values).max(MIN_SCATTER * MIN_SCATTER),
                constant,
                weights,
                torque,
                background: feature.background,
                floor: 0.5 * noise.ln(),
            }
        };
        let named = (0..MESH_LINES).filter_map(|index| {
            let name = line_name(index);
            baseline.lines.iter().find(|line| line.name == name).map(|line| (index, line))
        });
        let lines: Vec<Line> = named.map(fit).collect();
        let has_torque = baseline.points.iter().any(|[_, torque]| torque.is_some());
        // K⁻¹(y − b) is also the residual of each record, as ε has the covariance I.
        let residuals: Vec<(usize, &[f64])> =
            lines.iter().map(|line| (line.index, line.weights.as_slice())).collect();
        let common_movement = if has_torque { None } else { CommonMovement::of(&residuals) };
        Self { kernels, lines, common_movement, nominal_speed_hz, nominal_torque_nm }
    }

    /// Whether a record without its torque has lines that moved as load moves them.
    pub(super) fn moved_like_load(&self, record: &Features, measured: &MeasuredLines) -> bool {
        let common_movement =
            self.common_movement.as_ref().filter(|_| record.operating_point.torque_nm.is_none());
        common_movement.is_some_and(|common_movement| common_movement.explains(measured))
    }

    /// Number of lines that are compared.
    pub(super) fn len(&self) -> usize {
        self.lines.len()
    }

    /// Logarithms of the baseline's speeds over the nominal one.
    pub(super) fn log_speeds(&self, baseline: &Baseline) -> Vec<f64> {
        baseline.points.iter().map(|point| relative(point[0], self.nominal_speed_hz).ln()).collect()
    }

    /// Logarithm of a record's speed over the nominal one.
    pub(super) fn log_speed(&self, record: &Features) -> f64 {
        relative(record.operating_point.shaft_speed_hz, self.nominal_speed_hz).ln()
    }

    /// Returns the least sampling rate in hertz that covers the first `lines` lines of a mesh frequency.
    pub(super) fn rate_needed_hz(&self, lines: usize, mesh_hz: f64) -> f64 {
        let order = self.lines.get(lines.saturating_sub(1)).map_or(0, |line| line.index + 1);
        2.0 * (order as f64 + 0.5) * mesh_hz
    }

    /// Returns a record's lines relative to the healthy ones. `scatter` is the factor on the variance of a
    /// record shorter than the baseline's.
    pub(super) fn measure(&self, record: &Features, scatter: f64) -> MeasuredLines {
        let at = self.kernels.weights(self.log_speed(record));
        let load = relative(record.operating_point.torque_nm, self.nominal_torque_nm);
        let log_torque = load.ln();
        let line = |line: &Line| {
            let value = *record.values.get(&line_name(line.index))?;
            let noise = line.background.map_or(0.0, |background| (2.0 * (background - value)).exp().min(1.0));
            Some(MeasuredLine {
                index: line.index,
                change: value
                    - log_torque
                    - line.torque.at(log_torque)
                    - line.constant
                    - at.path(line.kernel, &line.weights),
                variance: line.variance * (scatter + at.variance(line.kernel))
                    + line.torque.variance_at(log_torque)
                    + NOISE_VARIANCE * noise,
                floor: line.floor,
            })
        };
        MeasuredLines { lines: self.lines.iter().filter_map(line).collect(), load }
    }
}

/// Returns a value over its nominal one; 1 where either is not known.
fn relative(value: Option<f64>, nominal: f64) -> f64 {
    match value {
        Some(value) if value > 0.0 && nominal > 0.0 => value / nominal,
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_torque_power_is_fitted_to_a_baseline_of_many_torques() {
        let log_torques: Vec<f64> = (0..20).map(|n| 0.05 * f64::from(n % 7) - 0.15).collect();
        let values: Vec<f64> = log_torques.iter().map(|x| 3.0 + 1.2 * x).collect();
        let learnt = TorquePower::fit(&log_torques, &values);
        let beside = learnt.at(0.2) - learnt.at(0.0);
        assert!((beside - 0.24).abs() < 0.03, "{beside}");
        assert!(learnt.variance < 0.1 * TORQUE_POWER * TORQUE_POWER);
    }

    #[test]
    fn one_torque_leaves_the_prior_of_the_torque_power() {
        let learnt = TorquePower::fit(&[0.1; 20], &[3.0; 20]);
        assert_eq!(learnt.at(0.5), 0.0);
        assert!((learnt.variance_at(0.3) - (TORQUE_POWER * 0.2).powi(2)).abs() < 1e-12);
        assert!(learnt.variance_at(0.1) < 1e-12);
    }
}
