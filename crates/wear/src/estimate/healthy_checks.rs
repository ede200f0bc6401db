//! Healthy checks of one asset: the values that wear hardly changes.

use serde::{Deserialize, Serialize};

use super::baseline::{Baseline, HealthyFeature, KURTOSIS};
use super::comparability::Comparability;
use super::deviation::Deviation;
use super::healthy::SpeedKernels;
use super::novelty::TEETH;
use crate::library::Ensemble;
use flankwatch_signal::{ByName, Features, Name};

/// Standard deviation of the library's error in a check, absolute and as a part of the change. Half of the
/// library's change is expected, as the sensor's own noise does not change.
const CHECK_DISCREPANCY: f64 = 0.05;
const CHECK_RELATIVE_DISCREPANCY: f64 = 0.6;
const CHECK_PART: f64 = 0.5;

/// Wear that spreads the changes of the mesh lines also moves the checks, at most by this part of the line
/// spread, by kind of check.
const DRIFT_PARTS: [(&str, f64); 3] = [("ln_shaft_", 0.5), (TEETH, 0.5), ("ln_", 0.6)];

/// Largest rise of a tooth check through wear. The gear model with run-out, pitch errors of 0.5 to 5 µm and
/// noise of −40 to −12 dB gives at most 0.23.
const MAX_TOOTH_RISE: f64 = 0.25;

/// Largest increase of the line spread through wear within a unit of growth: a sudden change is not wear.
const MAX_SPREAD_STEP: f64 = 0.1;

/// Scatter of a check's drift between records, as a part of its largest drift.
const DRIFT_SCATTER: f64 = 0.1;

/// Weight of the newest record in the drift.
const NEWEST_PART: f64 = 0.15;

/// Checks that in a noise-free simulation consist of rounding errors: the library says nothing about them.
const UNSIMULATED: [&str; 2] = ["ln_shaft_", TEETH];

/// Prefix of the checks of what the teeth repeat from turn to turn.
const REPEATED: &str = "ln_tooth_repeated_";

/// The fit of one check over the baseline's speeds.
#[derive(Debug, Clone)]
struct Check {
    name: Name,
    kernel: usize,
    /// σ² of one record.
    variance: f64,
    /// b and K⁻¹(y − b).
    constant: f64,
    weights: Vec<f64>,
    /// Expected change by depth; one number without a library.
    change: Vec<f64>,
    /// Mean height of a line above the noise beside it, as a logarithm.
    height: Option<f64>,
}

/// Drift of the checks through wear so far: slow, and limited in proportion to the spread of the mesh lines.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Drift {
    /// Spread of the mesh lines' changes.
    #[serde(rename = "apart")]
    line_spread: f64,
    /// Offset by check.
    offsets: ByName<f64>,
}

/// The drift that is allowed for a record.
#[derive(Debug, Clone, Copy)]
pub(super) struct AllowedDrift<'a> {
    drift: &'a Drift,
    line_spread: f64,
    units: f64,
}

impl Drift {
    /// Returns the drift allowed for a record with this line spread, `units` of growth after the last one.
    pub(super) fn at(&self, line_spread: f64, units: f64) -> AllowedDrift<'_> {
        AllowedDrift {
            drift: self,
            line_spread: line_spread.min(self.line_spread + MAX_SPREAD_STEP * units),
            units,
        }
    }

    /// Returns the drift after a record that wear explains.
    pub(super) fn after(&self, line_spread: f64, units: f64, checks: &[Deviation]) -> Self {
        let line_spread = self.at(line_spread, units).line_spread;
        let offset = |check: &Deviation| {
            let before = self.offsets.get(&check.name).copied().unwrap_or(0.0);
            let [least, most] = drift_limits(&check.name, line_spread);
            (check.name.clone(), (before + NEWEST_PART * check.residual).clamp(least, most))
        };
        Self {
            line_spread: self.line_spread + NEWEST_PART * (line_spread - self.line_spread),
            offsets: checks.iter().map(offset).collect(),
        }
    }
}

impl AllowedDrift<'_> {
    /// Returns the expected offset of a check and its variance.
    fn of(&self, check: &str) -> (f64, f64) {
        let offset = self.drift.offsets.get(check).copied().unwrap_or(0.0);
        let [_, most] = drift_limits(check, self.line_spread);
        let step = (max_drift_part(check) * MAX_SPREAD_STEP * self.units).min(most);
        let scatter = DRIFT_SCATTER * most;
        (offset, step * step + scatter * scatter)
    }
}

/// Returns the least and the largest drift of a check at this line spread.
///
/// What the teeth repeat may fall while wear grows, and come back later. A check that came back from a fall
/// would look like a tooth fault, so a fall is not followed.
fn drift_limits(check: &str, line_spread: f64) -> [f64; 2] {
    let most = max_drift_part(check) * line_spread;
    if check.starts_with(TEETH) { [0.0, most.min(MAX_TOOTH_RISE)] } else { [-most, most] }
}

/// Returns the largest drift of a check as a part of the line spread.
fn max_drift_part(check: &str) -> f64 {
    let kind = DRIFT_PARTS.iter().find(|(kind, _)| check.starts_with(kind));
    kind.map_or(0.0, |(_, part)| *part)
}

/// Returns a check's value minus its expectation.
///
/// A check of what the teeth repeat is 0 for noise alone, and negative where the noise differs between even
/// and odd turns. Less of that noise is no sign of a tooth fault: such a check counts as grown from 0 on.
///
/// A line of the shaft counts as grown only as far as it has `risen` above the noise beside it: wear adds
/// noise there too.
fn residual(check: &str, value: f64, expected: f64, risen: Option<f64>) -> f64 {
    let grown = value - expected;
    if grown <= 0.0 {
        return grown;
    }
    let most = if check.starts_with(REPEATED) { Some(value) } else { risen };
    most.map_or(grown, |most| grown.min(most.max(0.0)))
}

/// Number of turns that a tooth check averages.
fn averaged_turns(check: &str) -> Option<u32> {
    check.strip_prefix(TEETH)?.rsplit('_').next()?.parse().ok()
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
    /// Fits the checks to a baseline whose speeds have these logarithms, for a grid of depths in µm.
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
            let height = feature.background.map(|background| feature.mean() - background);
            Check {
                name: feature.name.clone(),
                kernel,
                variance: kernels.variance(kernel, &values),
                constant,
                weights,
                change,
                height,
            }
        };
        let checks = baseline.checks.iter().map(fit).collect();
        let kurtosis = baseline.kurtosis.as_ref().map(fit);
        Self { kernels, checks, kurtosis, comparability: baseline.comparability }
    }

    /// Returns the deviation of each check of a record from its expectation at a depth index, a logarithm of
    /// the speed and a drift.
    ///
    /// The variance of a record shorter than the baseline's is larger accordingly. Of averages over different
    /// numbers of turns, the longest that record and baseline share are compared.
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
            let height = record.background.get(&check.name).map(|background| value - background);
            let risen = height.zip(check.height).map(|(height, healthy)| height - healthy);
            Some(Deviation {
                name: check.name.clone(),
                residual: residual(&check.name, *value, expected, risen),
                deviation: (wrong * wrong
                    + drift_variance
                    + check.variance * (scatter + at.variance(check.kernel)))
                .sqrt(),
            })
        };
        self.checks.iter().filter_map(deviation).collect()
    }

    /// Returns the deviations from the healthy values, regardless of wear, of the checks that a change of
    /// gain multiplies.
    pub(super) fn gain_sensitive(&self, record: &Features, log_speed: f64) -> Vec<Deviation> {
        let gain_sensitive = self.checks.iter().filter(|check| averaged_turns(&check.name).is_none());
        gain_sensitive
            .filter_map(|check| {
                self.deviation_from_healthy(check, *record.checks.get(&check.name)?, log_speed)
            })
            .collect()
    }

    /// Returns the deviation of a record's kurtosis from the healthy ones.
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

    /// Returns the number of the baseline's energy checks, and how many of them a record has.
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
    fn less_noise_between_turns_is_no_tooth_fault() {
        let of = |value, expected| residual("ln_tooth_repeated_8", value, expected, None);
        assert_eq!((of(0.0, -0.6), of(-0.2, -0.6)), (0.0, 0.0));
        assert_eq!((of(0.5, -0.6), of(0.5, 0.25), of(-0.6, -0.25)), (0.5, 0.25, -0.35));
        assert_eq!(residual("ln_floor_500hz", -2.0, -3.0, None), 1.0);
    }

    #[test]
    fn teeth_drift_upwards_only_and_within_the_limit() {
        let names = ["ln_tooth_repeated_32", "ln_rest_500hz"];
        let after = |drift: Drift, residual: f64| {
            let check = |name: &str| Deviation { name: name.into(), residual, deviation: 0.1 };
            (0..100).fold(drift, |drift, _| drift.after(1.0, 1.0, &names.map(check)))
        };
        let offsets = |drift: &Drift| names.map(|name| drift.at(1.0, 1.0).of(name).0);
        let fallen = after(Drift::default(), -0.5);
        let [teeth, energy] = offsets(&fallen);
        assert!(teeth == 0.0 && energy < -0.5, "{teeth} {energy}");
        let [teeth, energy] = offsets(&after(fallen, 0.5));
        assert!(teeth == MAX_TOOTH_RISE && energy > 0.5, "{teeth} {energy}");
    }

    #[test]
    fn a_line_of_the_shaft_grows_above_the_noise_beside_it() {
        let of = |value, risen| residual("ln_shaft_2", value, 1.0, risen);
        assert_eq!((of(2.0, Some(0.1)), of(2.0, Some(-0.2))), (0.1, 0.0), "noise has grown");
        assert_eq!((of(2.0, Some(1.5)), of(2.0, None)), (1.0, 1.0), "the line has grown");
        assert_eq!(of(0.5, Some(0.8)), -0.5, "noise has fallen more than the line");
    }
}
