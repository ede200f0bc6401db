//! Scores of the estimates of a case's runs.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::rank_correlation::rank_correlation;

/// Nominal coverages of the calibration curve.
pub const NOMINAL: [f64; 10] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95];

/// Ratio of the root mean square to its healthy mean at which an alarm is raised.
pub(super) const RMS_ALARM_FACTOR: f64 = 2.0;

/// One record with its estimate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ScoredRecord {
    pub(super) truth_um: f64,
    /// Median and ends of the 90 % interval in µm, where there is an estimate.
    pub(super) estimate: Option<[f64; 3]>,
    /// Posterior probability of less wear than the truth.
    pub(super) below_truth: Option<f64>,
    /// The fault that the record was flagged with.
    pub(super) verdict: Option<&'static str>,
    /// Whether the record has a fault.
    pub(super) faulty: bool,
    /// Whether a prognosis in the second half of the run contains the crossing of the limit.
    pub(super) prognosis_holds: Option<bool>,
    /// RMS, kurtosis and first mesh line.
    pub(super) single: [f64; 3],
}

/// The scores of one case.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Score {
    /// The case.
    pub case: String,
    /// Number of runs.
    pub runs: usize,
    /// Number of records with a wear depth.
    pub estimates: usize,
    /// Mean absolute error of the median in µm.
    pub mean_error_um: f64,
    /// Quantiles 50, 90 and 99 % of the absolute error in µm.
    pub error_quantiles_um: [f64; 3],
    /// Mean of median minus truth in µm.
    pub bias_um: f64,
    /// Part of the estimates whose 90 % interval contains the truth.
    pub coverage: f64,
    /// Mean width of that interval in µm.
    pub width_um: f64,
    /// Mean over runs of the rank correlation of median and truth.
    pub rank_correlation: Option<f64>,
    /// The same for RMS, kurtosis and first mesh line.
    pub single_rank_correlation: Option<[f64; 3]>,
    /// Actual coverage at each of [`NOMINAL`].
    pub calibration: Vec<f64>,
    /// Part of the records without a fault that were flagged.
    pub false_flags: f64,
    /// Part of the runs flagged within 10 records of the fault; `None` without a fault.
    pub found: Option<f64>,
    /// The fault that flagged records of the fault were attributed to most often, and its share.
    pub named: Option<(String, f64)>,
    /// Part of the prognoses in the second half of a run that contain the crossing, and their number.
    pub prognosis: Option<(f64, usize)>,
    /// True depth in µm, 5 %, 50 % and 95 % over runs, at which RMS passed twice its healthy mean in 3 of 5
    /// records.
    pub rms_alarm_um: Option<[f64; 3]>,
    /// The same for a median wear depth above half of the library in 3 of 5 records.
    pub wear_alarm_um: Option<[f64; 3]>,
}

impl Score {
    /// Scores the runs of a case. The first `baseline` records of each run are excluded; `half_um` is half of
    /// the library's greatest depth.
    pub(super) fn of(case: &str, runs: &[Vec<ScoredRecord>], baseline: usize, half_um: f64) -> Self {
        let after = || runs.iter().flat_map(|run| run.iter().skip(baseline));
        let estimates: Vec<(f64, [f64; 3])> =
            after().filter_map(|record| Some((record.truth_um, record.estimate?))).collect();
        let count = estimates.len().max(1) as f64;
        let mut errors: Vec<f64> =
            estimates.iter().map(|(truth, [median, ..])| (median - truth).abs()).collect();
        errors.sort_by(f64::total_cmp);
        let places: Vec<f64> = after().filter_map(|record| record.below_truth).collect();
        let calibration = NOMINAL.map(|level| {
            let inside = places.iter().filter(|place| (*place - 0.5).abs() <= 0.5 * level).count();
            inside as f64 / places.len().max(1) as f64
        });
        let clean: Vec<&ScoredRecord> = after().filter(|record| !record.faulty).collect();
        let faulty = runs.iter().any(|run| run.iter().any(|record| record.faulty));
        let found = |run: &&Vec<ScoredRecord>| {
            run.iter().filter(|record| record.faulty).take(10).any(|record| record.verdict.is_some())
        };
        let prognoses: Vec<bool> = after().filter_map(|record| record.prognosis_holds).collect();
        let wears = runs.iter().flatten().any(|record| record.truth_um > half_um);
        let correlate = |value: &dyn Fn(&ScoredRecord) -> Option<f64>| -> f64 {
            let of_run = |run: &Vec<ScoredRecord>| {
                let pairs =
                    run.iter().skip(baseline).filter_map(|record| Some((record.truth_um, value(record)?)));
                rank_correlation(&pairs.collect::<Vec<_>>())
            };
            let all: Vec<f64> = runs.iter().filter_map(of_run).collect();
            all.iter().sum::<f64>() / all.len().max(1) as f64
        };
        Self {
            case: case.to_owned(),
            runs: runs.len(),
            estimates: estimates.len(),
            mean_error_um: errors.iter().sum::<f64>() / count,
            error_quantiles_um: [0.5, 0.9, 0.99].map(|level| quantile(&errors, level)),
            bias_um: estimates.iter().map(|(truth, [median, ..])| median - truth).sum::<f64>() / count,
            coverage: estimates.iter().filter(|(truth, [_, low, high])| low <= truth && truth <= high).count()
                as f64
                / count,
            width_um: estimates.iter().map(|(_, [_, low, high])| high - low).sum::<f64>() / count,
            rank_correlation: wears.then(|| correlate(&|record| record.estimate.map(|estimate| estimate[0]))),
            single_rank_correlation: wears
                .then(|| [0, 1, 2].map(|i| correlate(&|record| Some(record.single[i])))),
            calibration: calibration.to_vec(),
            false_flags: clean.iter().filter(|record| record.verdict.is_some()).count() as f64
                / clean.len().max(1) as f64,
            named: named(runs),
            found: faulty.then(|| runs.iter().filter(found).count() as f64 / runs.len() as f64),
            prognosis: (!prognoses.is_empty()).then(|| {
                let holding = prognoses.iter().filter(|holds| **holds).count();
                (holding as f64 / prognoses.len() as f64, prognoses.len())
            }),
            rms_alarm_um: wears
                .then(|| {
                    alarms(runs, baseline, &|record, healthy| record.single[0] > RMS_ALARM_FACTOR * healthy)
                })
                .flatten(),
            wear_alarm_um: wears
                .then(|| {
                    alarms(runs, baseline, &|record, _| {
                        record.estimate.is_some_and(|estimate| estimate[0] > half_um)
                    })
                })
                .flatten(),
        }
    }
}

/// Returns the most frequent verdict on records with a fault, and its share.
fn named(runs: &[Vec<ScoredRecord>]) -> Option<(String, f64)> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let faulty = runs.iter().flatten().filter(|record| record.faulty);
    for verdict in faulty.filter_map(|record| record.verdict) {
        *counts.entry(verdict).or_default() += 1;
    }
    let all: usize = counts.values().sum();
    let (name, count) = counts.into_iter().max_by_key(|(_, count)| *count)?;
    Some((name.to_owned(), count as f64 / all as f64))
}

/// Returns the 5, 50 and 95 % quantiles over runs of the true depth at which a condition raises an alarm; a
/// run where it never does counts with its last depth.
fn alarms(
    runs: &[Vec<ScoredRecord>],
    baseline: usize,
    holds: &dyn Fn(&ScoredRecord, f64) -> bool,
) -> Option<[f64; 3]> {
    let mut depths: Vec<f64> = runs
        .iter()
        .filter_map(|run| {
            let (healthy, rest) = run.split_at_checked(baseline)?;
            let healthy = healthy.iter().map(|record| record.single[0]).sum::<f64>() / baseline as f64;
            let raised = alarm_record(rest.iter().map(|record| holds(record, healthy)));
            raised.map_or(run.last(), |index| rest.get(index)).map(|record| record.truth_um)
        })
        .collect();
    depths.sort_by(f64::total_cmp);
    (!depths.is_empty()).then(|| [0.05, 0.5, 0.95].map(|level| quantile(&depths, level)))
}

/// Returns the index of the record at which an alarm is raised: its condition holds in 3 of 5 records.
pub(super) fn alarm_record(holds: impl Iterator<Item = bool>) -> Option<usize> {
    const OF_LAST: (usize, usize) = (3, 5);
    let holds: Vec<bool> = holds.collect();
    let count = |window: &[bool]| window.iter().filter(|holds| **holds).count();
    let first = holds.windows(OF_LAST.1).position(|window| count(window) >= OF_LAST.0)?;
    Some(first + OF_LAST.1 - 1)
}

fn quantile(sorted: &[f64], level: f64) -> f64 {
    match sorted.len() {
        0 => f64::NAN,
        count => sorted[((count - 1) as f64 * level).round() as usize],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_are_those_of_the_records() {
        let record = |truth_um: f64, estimate: Option<[f64; 3]>, flagged: bool, faulty: bool| ScoredRecord {
            truth_um,
            estimate,
            below_truth: estimate.map(|_| 0.5),
            verdict: flagged.then_some("one tooth"),
            faulty,
            prognosis_holds: None,
            single: [1.0, 3.0, 1.0],
        };
        let run = vec![
            record(0.0, None, false, false),
            record(10.0, Some([12.0, 9.0, 15.0]), false, false),
            record(20.0, Some([16.0, 12.0, 18.0]), false, false),
            record(30.0, None, true, true),
        ];
        let score = Score::of("case", &[run], 1, 100.0);
        assert_eq!(
            (score.mean_error_um, score.coverage, score.width_um, score.bias_um),
            (3.0, 0.5, 6.0, -1.0)
        );
        assert_eq!((score.false_flags, score.found, score.rank_correlation), (0.0, Some(1.0), None));
        assert_eq!(score.named, Some(("one tooth".to_owned(), 1.0)));
    }
}
