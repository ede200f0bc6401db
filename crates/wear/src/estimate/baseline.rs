//! The healthy records of one measuring channel, as they are saved in the state.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::comparability::Comparability;
use flankwatch_signal::{Features, Name};

/// Least ratio of a line's healthy amplitude to the noise beside it for the line to be compared.
const MIN_LINE_TO_BACKGROUND: f64 = 2.0;

/// Most records of the fit over speed: a longer baseline is thinned evenly.
const MAX_RECORDS: usize = 40;

/// The feature that measures how impulsive a record is.
pub(super) const KURTOSIS: &str = "ln_kurtosis";

/// Healthy values of one feature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct HealthyFeature {
    pub(super) name: Name,
    /// Value by record.
    pub(super) values: Vec<f32>,
    /// Mean logarithm of the noise amplitude beside it, for a line and for a check that is one.
    pub(super) background: Option<f64>,
}

impl HealthyFeature {
    /// Mean of the values.
    pub(super) fn mean(&self) -> f64 {
        self.values.iter().map(|&value| f64::from(value)).sum::<f64>() / self.values.len() as f64
    }
}

/// The healthy baseline of one measuring channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Baseline {
    /// Lines that every record has and that stand above the noise: wear is estimated from them.
    pub(super) lines: Vec<HealthyFeature>,
    /// Checks: values that wear hardly changes.
    pub(super) checks: Vec<HealthyFeature>,
    /// The kurtosis, where every record has one.
    #[serde(default)]
    pub(super) kurtosis: Option<HealthyFeature>,
    /// Which records can be compared with it.
    #[serde(default)]
    pub(super) comparability: Comparability,
    /// Shaft speed in hertz and torque in N·m of each record, where known.
    pub(super) points: Vec<[Option<f64>; 2]>,
}

impl Baseline {
    /// Creates a baseline from these records; features that any of them lacks are excluded.
    pub(super) fn of(records: &[Arc<Features>]) -> Self {
        let stride = records.len().div_ceil(MAX_RECORDS).max(1);
        let records: Vec<&Features> = records.iter().step_by(stride).map(Arc::as_ref).collect();
        let is_line =
            |name: &&Name| ["ln_mesh_", "ln_sideband_", "ln_env_"].iter().any(|kind| name.starts_with(kind));
        let background = |name: &Name| -> Option<f64> {
            let noise: Option<Vec<f64>> =
                records.iter().map(|record| record.background.get(name).copied()).collect();
            noise.map(|noise| noise.iter().sum::<f64>() / noise.len() as f64)
        };
        let first = records.first();
        let lines = first.into_iter().flat_map(|record| record.values.keys().filter(is_line));
        let lines = lines.filter_map(|name| {
            let values: Option<Vec<f32>> =
                records.iter().map(|record| Some(*record.values.get(name)? as f32)).collect();
            let feature =
                HealthyFeature { name: name.clone(), values: values?, background: background(name) };
            let drowned =
                feature.background.is_some_and(|noise| feature.mean() < noise + MIN_LINE_TO_BACKGROUND.ln());
            (!drowned).then_some(feature)
        });
        let checks = first.into_iter().flat_map(|record| record.checks.keys()).filter_map(|name| {
            let values: Option<Vec<f32>> =
                records.iter().map(|record| Some(*record.checks.get(name)? as f32)).collect();
            Some(HealthyFeature { name: name.clone(), values: values?, background: background(name) })
        });
        let kurtosis: Option<Vec<f32>> =
            records.iter().map(|record| Some(*record.values.get(KURTOSIS)? as f32)).collect();
        let comparability = Comparability::of(records.iter().copied());
        let point =
            |record: &&Features| [record.operating_point.shaft_speed_hz, record.operating_point.torque_nm];
        Self {
            lines: lines.collect(),
            checks: checks.collect(),
            kurtosis: kurtosis.filter(|values| !values.is_empty()).map(|values| HealthyFeature {
                name: Name::new_static(KURTOSIS),
                values,
                background: None,
            }),
            comparability,
            points: records.iter().map(point).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(pairs: &[(&str, f64)], background: &[(&str, f64)]) -> Arc<Features> {
        let map =
            |pairs: &[(&str, f64)]| pairs.iter().map(|&(name, value)| (name.to_owned(), value)).collect();
        Arc::new(Features { values: map(pairs), background: map(background), ..Features::default() })
    }

    #[test]
    fn a_feature_that_one_record_lacks_is_excluded() {
        let pairs = [("ln_mesh_1", 1.0), ("ln_mesh_2", 2.0), ("ln_rms", 1.0)];
        let baseline = Baseline::of(&[features(&pairs, &[]), features(&[("ln_mesh_1", 3.0)], &[])]);
        assert_eq!(baseline.lines.len(), 1);
        assert_eq!((baseline.lines[0].name.as_str(), baseline.lines[0].mean()), ("ln_mesh_1", 2.0));
    }

    #[test]
    fn a_line_in_the_noise_is_excluded() {
        let noise = [("ln_mesh_1", 0.0), ("ln_mesh_2", 0.0)];
        let baseline = Baseline::of(&[features(&[("ln_mesh_1", 1.0), ("ln_mesh_2", 0.1)], &noise)]);
        assert_eq!(baseline.lines.iter().map(|line| line.name.as_str()).collect::<Vec<_>>(), ["ln_mesh_1"]);
    }

    #[test]
    fn a_long_baseline_is_thinned_evenly() {
        let records: Vec<Arc<Features>> =
            (0..100).map(|i| features(&[("ln_mesh_1", f64::from(i))], &[])).collect();
        let baseline = Baseline::of(&records);
        assert_eq!(baseline.points.len(), 34);
        assert_eq!(baseline.lines[0].values[..3], [0.0, 3.0, 6.0]);
    }
}
