//! The model of a healthy machine's lines and checks.

use std::sync::Arc;

use super::Tracker;
use crate::estimate::baseline::Baseline;
use crate::estimate::deviation::Deviation;
use crate::estimate::healthy_checks::{AllowedDrift, HealthyChecks};
use crate::estimate::healthy_lines::HealthyLines;
use crate::estimate::levels::is_impulsive;
use flankwatch_signal::Features;

/// Lines and checks fitted to a baseline.
#[derive(Debug)]
pub(super) struct HealthyModel {
    pub(super) lines: HealthyLines,
    pub(super) checks: HealthyChecks,
}

/// A lazily fitted [`HealthyModel`]. It is not saved: a state that was read fits it again.
#[derive(Debug, Clone, Default)]
pub(super) struct CachedModel(Option<Arc<HealthyModel>>);

impl PartialEq for CachedModel {
    /// Always true: the model follows from the baseline.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl CachedModel {
    /// Returns the model, fitting it on the first call.
    pub(super) fn get(&mut self, compute: impl FnOnce() -> HealthyModel) -> Arc<HealthyModel> {
        Arc::clone(self.0.get_or_insert_with(|| Arc::new(compute())))
    }
}

impl Tracker {
    /// Fits the healthy model to a baseline.
    pub(super) fn healthy_model(&self, baseline: &Baseline) -> HealthyModel {
        let nominal = match self.ensemble.as_deref() {
            Some(ensemble) => {
                let operation = &ensemble.described().pair().operation;
                [operation.shaft_speed_hz, operation.torque_nm]
            }
            None => [0, 1].map(|i| baseline.points.iter().find_map(|point| point[i]).unwrap_or(1.0)),
        };
        let lines = HealthyLines::new(baseline, nominal);
        let log_speeds = lines.log_speeds(baseline);
        HealthyModel {
            checks: HealthyChecks::new(baseline, log_speeds, self.ensemble.as_deref(), self.tracked_um()),
            lines,
        }
    }
}

impl HealthyModel {
    /// Deviations of the checks from their expectation at the depth with index `depth` and a drift.
    pub(super) fn checks_at(
        &self,
        record: &Features,
        depth: usize,
        drift: AllowedDrift<'_>,
    ) -> Vec<Deviation> {
        self.checks.deviations(record, self.lines.log_speed(record), depth, drift)
    }

    /// Whether a record is more impulsive than the healthy ones.
    pub(super) fn is_impulsive(&self, record: &Features) -> bool {
        let kurtosis = self.checks.kurtosis(record, self.lines.log_speed(record));
        kurtosis.is_some_and(|kurtosis| is_impulsive(&kurtosis))
    }
}
