//! Scores of single indicators on recorded runs: an alarm on RMS and a regression on the first mesh line.

use serde::Serialize;

use super::recorded::RecordedRun;
use super::run::Observation;
use super::score::{RMS_ALARM_FACTOR, alarm_record};
use crate::rank_correlation::rank_correlation;

/// Scores of single indicators on one run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SingleIndicators {
    /// The run.
    pub run: String,
    /// True depth in µm at which the root mean square has exceeded twice its healthy mean in 3 of 5 records;
    /// `None` where it never did.
    pub rms_alarm_um: Option<f64>,
    /// Mean absolute error in µm of the depth by linear regression on the logarithm of OMX, fitted to all
    /// other runs; `None` for a single run, or without records after the baseline.
    pub omx_error_um: Option<f64>,
    /// Rank correlation of OMX and truth.
    pub omx_rank: Option<f64>,
}

/// Scores single indicators on runs whose first `baseline` records are healthy.
pub fn single_indicators(runs: &[&RecordedRun], baseline: usize) -> Vec<SingleIndicators> {
    let points: Vec<Vec<(f64, f64)>> = runs.iter().map(|run| omx_points(run, baseline)).collect();
    let score = |(index, run): (usize, &&RecordedRun)| {
        let others = points.iter().enumerate().filter(|(other, _)| *other != index);
        let others: Vec<(f64, f64)> = others.flat_map(|(_, points)| points.iter().copied()).collect();
        let own = &points[index];
        let error = |[slope, intercept]: [f64; 2]| {
            let sum: f64 = own.iter().map(|(omx, truth)| (slope * omx + intercept - truth).abs()).sum();
            sum / own.len() as f64
        };
        SingleIndicators {
            run: run.name.clone(),
            rms_alarm_um: rms_alarm_um(run, baseline),
            omx_error_um: straight_line(&others).filter(|_| !own.is_empty()).map(error),
            omx_rank: rank_correlation(own),
        }
    };
    runs.iter().enumerate().map(score).collect()
}

/// Logarithm of OMX over its healthy mean, and the true depth, of each record after the baseline.
fn omx_points(run: &RecordedRun, baseline: usize) -> Vec<(f64, f64)> {
    let (healthy, rest) = run.records.split_at(baseline.min(run.records.len()));
    let mean = mean(healthy, 2);
    let usable = rest.iter().filter(|record| record.single[2] > 0.0 && mean > 0.0);
    usable.map(|record| ((record.single[2] / mean).ln(), record.wear_um)).collect()
}

fn rms_alarm_um(run: &RecordedRun, baseline: usize) -> Option<f64> {
    let (healthy, rest) = run.records.split_at(baseline.min(run.records.len()));
    let limit = RMS_ALARM_FACTOR * mean(healthy, 0);
    alarm_record(rest.iter().map(|record| record.single[0] > limit)).map(|index| rest[index].wear_um)
}

fn mean(records: &[Observation], indicator: usize) -> f64 {
    records.iter().map(|record| record.single[indicator]).sum::<f64>() / records.len().max(1) as f64
}

/// Returns slope and intercept by least squares; `None` where all x are equal.
fn straight_line(points: &[(f64, f64)]) -> Option<[f64; 2]> {
    let count = points.len() as f64;
    let (x_mean, y_mean) =
        points.iter().fold((0.0, 0.0), |(x, y), point| (x + point.0 / count, y + point.1 / count));
    let spread: f64 = points.iter().map(|(x, _)| (x - x_mean).powi(2)).sum();
    let slope = points.iter().map(|(x, y)| (x - x_mean) * (y - y_mean)).sum::<f64>() / spread;
    (spread > 0.0).then_some([slope, y_mean - slope * x_mean])
}

#[cfg(test)]
mod tests {
    use flankwatch_signal::Features;

    use super::*;

    /// OMX grows as exp(depth / 50) times `scale`, the root mean square linearly to three times.
    fn run(name: &str, scale: f64) -> RecordedRun {
        let record = |i: usize| {
            let wear_um = 2.0 * i.saturating_sub(10) as f64;
            Observation {
                wear_um,
                features: Features::default(),
                single: [1.0 + wear_um / 50.0, 3.0, scale * (wear_um / 50.0).exp()],
            }
        };
        RecordedRun { name: name.to_owned(), records: (0..60).map(record).collect() }
    }

    #[test]
    fn a_regression_on_other_runs_finds_their_common_relation() {
        let scored = single_indicators(&[&run("a", 1.0), &run("b", 7.0)], 10);
        assert!(scored.iter().all(|score| score.omx_error_um.unwrap() < 1e-9));
        assert!((scored[0].omx_rank.unwrap() - 1.0).abs() < 1e-12);
        // 1 + 52/50 is the first above 2, 56 µm the third.
        assert_eq!(scored[0].rms_alarm_um, Some(56.0));
    }

    #[test]
    fn neither_a_single_run_nor_a_baseline_alone_has_a_regression() {
        let scored = single_indicators(&[&run("a", 1.0)], 10);
        assert_eq!(scored[0].omx_error_um, None);
        let mut short = run("b", 1.0);
        short.records.truncate(10);
        let scored = single_indicators(&[&short, &run("a", 1.0)], 10);
        assert_eq!(scored[0].omx_error_um, None);
    }
}
