//! What the values that wear hardly moves are on one asset when it is healthy.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::baseline::{Baseline, HealthyFeature, KURTOSIS};
use super::comparability::Comparability;
use super::deviation::Deviation;
use super::healthy::SpeedKernels;
use crate::library::Ensemble;
use flankwatch_signal::Features;

/// Standard deviation of what the library may be wrong by in a check, and as a part of the change; half of
/// the change that the library has is expected, as the sensor's own noise does not change.
const CHECK_DISCREPANCY: f64 = 0.05;
const CHECK_RELATIVE_DISCREPANCY: f64 = 0.6;
const CHECK_PART: f64 = 0.5;

/// Wear that moves the mesh lines apart from each other moves what lies between them too, by something that
/// no library knows: at most this part of how far the lines have moved apart, by kind of check.
const DRIFT_PARTS: [(&str, f64); 3] = [("ln_shaft_", 0.5), ("ln_tooth_", 0.5), ("ln_", 0.6)];

/// How far wear moves the lines apart from each other within a unit of growth, at most: what moves at once is
/// no wear.
const MAX_SPREAD_STEP: f64 = 0.1;

/// Part of what a check may have moved by that differs from record to record.
const DRIFT_SCATTER: f64 = 0.1;

/// Part of the newest record in what is known of the drift.
const NEWEST_PART: f64 = 0.15;

/// Checks in which a simulation without noise has rounding, and no wear.
const UNSIMULATED: [&str; 2] = ["ln_shaft_", "ln_tooth_"];

/// What the check of what the teeth repeat begins with.
const REPEATED: &str = "ln_tooth_repeated_";

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

/// How wear has moved the checks so far: slowly, and no further than in proportion to what it did to the mesh
/// lines.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Drift {
    /// How far the lines have moved apart.
    #[serde(rename = "apart")]
    line_spread: f64,
    /// By check.
    offsets: BTreeMap<String, f64>,
}

/// The drift that a record may show.
#[derive(Debug, Clone, Copy)]
pub(super) struct AllowedDrift<'a> {
    drift: &'a Drift,
    line_spread: f64,
    units: f64,
}

impl Drift {
    /// What a record may show whose lines are `apart` from each other, `units` of growth after the one
    /// before.
    pub(super) fn at(&self, line_spread: f64, units: f64) -> AllowedDrift<'_> {
        AllowedDrift {
            drift: self,
            line_spread: line_spread.min(self.line_spread + MAX_SPREAD_STEP * units),
            units,
        }
    }

    /// What is known after a record that wear explains.
    pub(super) fn after(&self, line_spread: f64, units: f64, checks: &[Deviation]) -> Self {
        let line_spread = self.at(line_spread, units).line_spread;
        let offset = |check: &Deviation| {
            let before = self.offsets.get(&check.name).copied().unwrap_or(0.0);
            let most = max_drift_part(&check.name) * line_spread;
            (check.name.clone(), (before + NEWEST_PART * check.residual).clamp(-most, most))
        };
        Self {
            line_spread: self.line_spread + NEWEST_PART * (line_spread - self.line_spread),
            offsets: checks.iter().map(offset).collect(),
        }
    }
}

impl AllowedDrift<'_> {
    /// Where a check is expected, and the variance of that.
    fn of(&self, check: &str) -> (f64, f64) {
        let offset = self.drift.offsets.get(check).copied().unwrap_or(0.0);
        let step = max_drift_part(check) * (MAX_SPREAD_STEP * self.units).min(self.line_spread);
        let scatter = max_drift_part(check) * DRIFT_SCATTER * self.line_spread;
        (offset, step * step + scatter * scatter)
    }
}

/// How far a check moves at most for what the lines have moved apart.
fn max_drift_part(check: &str) -> f64 {
    let kind = DRIFT_PARTS.iter().find(|(kind, _)| check.starts_with(kind));
    kind.map_or(0.0, |(_, part)| *part)
}

/// What a check is above or below what is expected.
///
/// What the teeth repeat is 0 where there is nothing but noise, and below where noise differs between even and
/// odd turns. Less of that noise is no tooth's doing: such a check has grown from 0 on.
fn residual(check: &str, value: f64, expected: f64) -> f64 {
    let grown = value - expected;
    if check.starts_with(REPEATED) && grown > 0.0 { grown.min(value.max(0.0)) } else { grown }
}

/// How many turns a check of the teeth averages.
fn averaged_turns(check: &str) -> Option<u32> {
    check.strip_prefix("ln_tooth_")?.rsplit('_').next()?.parse().ok()
}

/// The checks of one baseline.
#[derive(Debug, Clone)]
pub(super) struct HealthyChecks {
    kernels: SpeedKernels,
    checks: Vec<Check>,
    kurtosis: Option<Check>,
    comparability: Comparability,
}

impl HealthyChecks {
    /// Fits a baseline whose speeds have these logarithms, for a grid of depths in µm.
    pub(super) fn new(
        baseline: &Baseline,
        log_speeds: Vec<f64>,
        ensemble: Option<&Ensemble>,
        depths_um: &[f64],
    ) -> Self {
        let kernels = SpeedKernels::new(log_speeds);
        let fit = |feature: &HealthyFeature| {
            let values: Vec<f64> = feature.values.iter().map(|&value| f64::from(value)).collect();
            let evidence: Vec<f64> =
                (0..kernels.len()).map(|kernel| kernels.log_evidence(kernel, &values)).collect();
            let kernel =
                (0..evidence.len()).max_by(|&a, &b| evidence[a].total_cmp(&evidence[b])).unwrap_or(0);
            let is_simulated = !UNSIMULATED.iter().any(|kind| feature.name.starts_with(kind));
            let change = match ensemble.filter(|_| is_simulated) {
                None => vec![0.0],
                Some(ensemble) => {
                    let library = ensemble.described();
                    let change =
                        |um: &f64| CHECK_PART * library.check_change(&feature.name, *um).unwrap_or(0.0);
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
        let kurtosis = baseline.kurtosis.as_ref().map(fit);
        Self { kernels, checks, kurtosis, comparability: baseline.comparability }
    }

    /// How each check of a record deviates from what is expected at a depth of the grid, a logarithm of the
    /// speed and a drift.
    ///
    /// A record whose values scatter more, as it is shorter than the baseline's, has `scatter` times their
    /// variance. Of averages of different numbers of turns the longest are compared that the record and the
    /// baseline have.
    pub(super) fn deviations(
        &self,
        record: &Features,
        log_speed: f64,
        depth: usize,
        drift: AllowedDrift<'_>,
    ) -> Vec<Deviation> {
        let scatter = self.comparability.scatter(record);
        let at = self.kernels.weights(log_speed);
        let compared = |check: &&Check| {
            self.comparability.reaches_as_high(record) && record.checks.contains_key(&check.name)
        };
        let turns = self.checks.iter().filter(compared);
        let most_turns = turns.filter_map(|check| averaged_turns(&check.name)).max();
        let deviation = |check: &Check| {
            if averaged_turns(&check.name).is_some_and(|turns| Some(turns) != most_turns) {
                return None;
            }
            let value = record.checks.get(&check.name)?;
            let change = check.change[depth.min(check.change.len() - 1)];
            let (offset, drift_variance) = drift.of(&check.name);
            let wrong = CHECK_DISCREPANCY + CHECK_RELATIVE_DISCREPANCY * change.abs();
            let expected = check.constant + at.path(check.kernel, &check.weights) + change + offset;
            Some(Deviation {
                name: check.name.clone(),
                residual: residual(&check.name, *value, expected),
                deviation: (wrong * wrong
                    + drift_variance
                    + check.variance * (scatter + at.variance(check.kernel)))
                .sqrt(),
            })
        };
        self.checks.iter().filter_map(deviation).collect()
    }

    /// How what a gain multiplies stands to the healthy values, whatever wear does.
    pub(super) fn gain_sensitive(&self, record: &Features, log_speed: f64) -> Vec<Deviation> {
        let gain_sensitive = self.checks.iter().filter(|check| averaged_turns(&check.name).is_none());
        gain_sensitive
            .filter_map(|check| {
                self.deviation_from_healthy(check, *record.checks.get(&check.name)?, log_speed)
            })
            .collect()
    }

    /// How a record's kurtosis stands to the healthy ones.
    pub(super) fn kurtosis(&self, record: &Features, log_speed: f64) -> Option<Deviation> {
        self.deviation_from_healthy(self.kurtosis.as_ref()?, *record.values.get(KURTOSIS)?, log_speed)
    }

    fn deviation_from_healthy(&self, check: &Check, value: f64, log_speed: f64) -> Option<Deviation> {
        let at = self.kernels.weights(log_speed);
        Some(Deviation {
            name: check.name.clone(),
            residual: value - check.constant - at.path(check.kernel, &check.weights),
            deviation: (check.variance * (1.0 + at.variance(check.kernel))).sqrt(),
        })
    }

    /// Checks that a baseline has, and how many of them a record has.
    pub(super) fn shared(&self, record: &Features) -> [usize; 2] {
        let of_energy = self.checks.iter().filter(|check| averaged_turns(&check.name).is_none());
        let shared = of_energy.clone().filter(|check| record.checks.contains_key(&check.name));
        [of_energy.count(), shared.count()]
    }

    /// Degrees of freedom of a check's scatter.
    pub(super) fn freedom(&self) -> f64 {
        self.kernels.freedom()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn less_noise_between_the_turns_is_no_tooth() {
        let of = |value, expected| residual("ln_tooth_repeated_8", value, expected);
        assert_eq!((of(0.0, -0.6), of(-0.2, -0.6)), (0.0, 0.0));
        assert_eq!((of(0.5, -0.6), of(0.5, 0.25), of(-0.6, -0.25)), (0.5, 0.25, -0.35));
        assert_eq!(residual("ln_floor_500hz", -2.0, -3.0), 1.0);
    }
}
