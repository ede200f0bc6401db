//! What healthy looks like on one asset: mean and scatter of its features over the first records.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::signal::Features;

/// A line enters the comparison when its healthy amplitude stands above the noise beside it by this factor.
const LEAST_LINE_TO_BACKGROUND: f64 = 2.0;

/// Weight of the diagonal in the scatter estimate: with about as many records as features the sample covariance alone is
/// singular (Ledoit and Wolf 2004 shrink towards a diagonal for that reason; the weight is fixed here).
const SHRINKAGE: f64 = 0.3;

/// Least standard deviation of any feature: nothing repeats better than about half a per cent.
const LEAST_DEVIATION: f64 = 0.005;

/// The healthy baseline of one measuring channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Baseline {
    /// Names of the features that every record had and that stand above the noise, in order.
    pub(super) names: Vec<String>,
    /// Their mean.
    pub(super) mean: Vec<f64>,
    /// Mean logarithm of the noise amplitude beside each line; `None` for features that are not lines.
    pub(super) background: Vec<Option<f64>>,
    /// Their covariance, row by row.
    pub(super) covariance: Vec<f64>,
    /// Records it was made from.
    pub(super) records: usize,
}

impl Baseline {
    /// The baseline of these records; features that any of them lacks are left out.
    pub(super) fn of(records: &[Features]) -> Self {
        let count = records.len() as f64;
        let first = records.first().map(|record| &record.values);
        let mut names = Vec::new();
        let mut mean = Vec::new();
        let mut background = Vec::new();
        for name in first.into_iter().flat_map(|values| values.keys()) {
            let Some(values) = records
                .iter()
                .map(|record| record.values.get(name).copied())
                .collect::<Option<Vec<f64>>>()
            else {
                continue;
            };
            let noise: Option<Vec<f64>> = records.iter().map(|record| record.background.get(name).copied()).collect();
            let noise = noise.map(|noise| noise.iter().sum::<f64>() / count);
            let average = values.iter().sum::<f64>() / count;
            if noise.is_some_and(|noise| average < noise + LEAST_LINE_TO_BACKGROUND.ln()) {
                continue;
            }
            names.push(name.clone());
            mean.push(average);
            background.push(noise);
        }
        let covariance = covariance(records, &names, &mean);
        Self {
            names,
            mean,
            background,
            covariance,
            records: records.len(),
        }
    }

    /// The covariance of the features with these indices.
    pub(super) fn covariance_of(&self, indices: &[usize]) -> DMatrix<f64> {
        let width = self.names.len();
        DMatrix::from_fn(indices.len(), indices.len(), |i, j| {
            self.covariance[indices[i] * width + indices[j]]
        })
    }
}

fn covariance(records: &[Features], names: &[String], mean: &[f64]) -> Vec<f64> {
    let width = names.len();
    let freedom = (records.len().max(2) - 1) as f64;
    let mut sum = vec![0.0; width * width];
    let mut deviation = vec![0.0; width];
    for record in records {
        for ((d, name), mean) in deviation.iter_mut().zip(names).zip(mean) {
            *d = record.values[name] - mean;
        }
        for i in 0..width {
            for j in 0..width {
                sum[i * width + j] += deviation[i] * deviation[j];
            }
        }
    }
    for i in 0..width {
        for j in 0..width {
            let sample = sum[i * width + j] / freedom;
            sum[i * width + j] = if i == j {
                sample.max(LEAST_DEVIATION * LEAST_DEVIATION)
            } else {
                (1.0 - SHRINKAGE) * sample
            };
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(pairs: &[(&str, f64)], background: &[(&str, f64)]) -> Features {
        let map = |pairs: &[(&str, f64)]| pairs.iter().map(|&(name, value)| (name.to_owned(), value)).collect();
        Features {
            values: map(pairs),
            background: map(background),
        }
    }

    #[test]
    fn a_feature_that_one_record_lacks_is_left_out() {
        let baseline = Baseline::of(&[features(&[("a", 1.0), ("b", 2.0)], &[]), features(&[("a", 3.0)], &[])]);
        assert_eq!(baseline.names, ["a"]);
        assert_eq!(baseline.mean, [2.0]);
        // Sample variance of 1 and 3 by hand: ((1−2)² + (3−2)²)/1 = 2.
        assert_eq!(baseline.covariance, [2.0]);
    }

    #[test]
    fn a_line_in_the_noise_is_left_out() {
        let records = [features(&[("clear", 1.0), ("drowned", 0.1)], &[("clear", 0.0), ("drowned", 0.0)])];
        assert_eq!(Baseline::of(&records).names, ["clear"]);
    }

    #[test]
    fn fewer_records_than_features_still_give_a_positive_definite_scatter() {
        let records = [
            features(&[("a", 0.0), ("b", 0.0), ("c", 0.0)], &[]),
            features(&[("a", 1.0), ("b", 1.0), ("c", 1.0)], &[]),
        ];
        let baseline = Baseline::of(&records);
        assert!(baseline.covariance_of(&[0, 1, 2]).cholesky().is_some());
    }
}
