//! Estimates of runs with known true wear, recorded or simulated, and their scores.

use std::ops::Range;
use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};
use rayon::prelude::*;
use serde::Serialize;

use super::forecast::{Forecast, ForecastRecord, ForecastScore, score_forecasts};
use super::median_and_interval;
use super::run::Observation;
use crate::rank_correlation::rank_correlation;
use flankwatch_wear::estimate::{
    EstimatorSettings, HistoryStep, Inspection, JointEstimate, MaintenanceEvent, MaintenanceKind,
    SensorFault, SuspectedFault, Tracker, WearEstimate, WearStatus,
};
use flankwatch_wear::library::{Ensemble, FlankPlace};

/// Width in µm below which an interval is narrow.
const NARROW_UM: f64 = 20.0;

/// One run in time order.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedRun {
    /// Name.
    pub name: String,
    /// Its records with the true wear.
    pub records: Vec<Observation>,
}

/// Changes to a run before it is estimated.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RunOptions {
    /// Number of records that are dropped in the middle.
    pub gap: usize,
    /// Standard deviation in µm of an inspection half-way through the run.
    pub inspection_um: Option<f64>,
    /// Limit in µm to which the time is forecast.
    pub limit_um: Option<f64>,
}

/// One record's estimate with the truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordEstimate {
    /// Index of the record in the run.
    pub record: usize,
    /// True greatest depth in µm.
    pub truth_um: f64,
    /// Median and ends of the 90 % interval in µm, where there is an estimate.
    pub wear_um: Option<[f64; 3]>,
    /// Forecast of when wear passes the limit, where there is one.
    pub forecast: Option<Forecast>,
    /// Whether the record was attributed to something other than wear.
    pub flagged: bool,
    /// The fault of the sensor that a flagged record shows, if one is recognised.
    pub sensor_fault: Option<SensorFault>,
    /// What the machine most likely has instead of wear, if a flagged record shows it.
    pub suspected_fault: Option<SuspectedFault>,
    /// Reason of the estimate.
    pub reason: String,
}

/// The scores of one run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunScore {
    /// The run.
    pub run: String,
    /// Records after the baseline.
    pub records: usize,
    /// Records with a depth.
    pub estimated: usize,
    /// Records attributed to something other than wear.
    pub flagged: usize,
    /// Other records without a depth.
    pub without: usize,
    /// Part of the estimates whose 90 % interval contains the truth; `None` without estimates.
    pub coverage: Option<f64>,
    /// Longest sequence of estimates whose interval does not.
    pub longest_miss: usize,
    /// Rank correlation of median and truth.
    pub rank: Option<f64>,
    /// Mean absolute error of the median in µm; `None` without estimates.
    pub mean_error_um: Option<f64>,
    /// Mean of median minus truth in µm; `None` without estimates.
    pub bias_um: Option<f64>,
    /// Mean width of the interval in µm; `None` without estimates.
    pub width_um: Option<f64>,
    /// Number of intervals below 20 µm, and how many of them contain the truth.
    pub narrow: [usize; 2],
    /// The last estimate.
    pub last: Option<[f64; 3]>,
    /// Scores from the inspection on, if there are estimates.
    pub after: Option<ScoreAfter>,
    /// Scores of the records before the inspection, in hindsight.
    pub in_hindsight: Option<HindsightScore>,
    /// Scores of the forecasts, if there is a limit that wear passes.
    pub forecasts: Option<ForecastScore>,
}

/// Scores of the records from an inspection on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScoreAfter {
    /// Mean absolute error of the median in µm.
    pub mean_error_um: f64,
    /// Mean width of the interval in µm.
    pub width_um: f64,
    /// Part of the intervals that contain the truth.
    pub coverage: f64,
}

/// Scores of the records before an inspection: without it, and in hindsight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HindsightScore {
    /// Mean absolute error of the median in µm: without the inspection, and in hindsight.
    pub error_um: [f64; 2],
    /// Mean width of the interval in µm: without the inspection, and in hindsight.
    pub width_um: [f64; 2],
    /// Part of the intervals that contain the truth: without the inspection, and in hindsight.
    pub coverage: [f64; 2],
}

/// Scores the records before an inspection half-way through a run; `None` without an inspection or estimates.
pub fn look_back(
    run: &RecordedRun,
    ensemble: &Arc<Ensemble>,
    baseline: u32,
    options: RunOptions,
) -> Option<HindsightScore> {
    let error_um = options.inspection_um?;
    let tracker = Tracker::new(
        EstimatorSettings { baseline_records: baseline, limit_um: None },
        Some(Arc::clone(ensemble)),
    );
    let (half, gap) = half_and_gap(run, options);
    let (inspection, observation) = without(run, &gap).find(|(record, _)| *record >= half)?;
    let event = inspected(hour(inspection), observation.wear_um, error_um);
    let before = || without(run, &gap).take_while(|(record, _)| *record < inspection);
    let mut steps: Vec<HistoryStep<'_>> = before()
        .map(|(record, observation)| HistoryStep::Record(hour(record), &observation.features))
        .collect();
    steps.push(HistoryStep::Event(&event));
    let in_hindsight = tracker.in_hindsight(&steps);
    let mut state = tracker.start();
    let mut both = Vec::new();
    for ((record, observation), later) in before().zip(in_hindsight) {
        let then = median_and_interval(&tracker.update(&mut state, hour(record), &observation.features));
        if let (Some(then), Some(later)) = (then, later.as_ref().and_then(median_and_interval)) {
            both.push((observation.wear_um, [then, later]));
        }
    }
    let count = both.len() as f64;
    let mean = |value: &dyn Fn(f64, [f64; 3]) -> f64| {
        [0, 1].map(|which| both.iter().map(|(truth, pair)| value(*truth, pair[which])).sum::<f64>() / count)
    };
    (!both.is_empty()).then(|| HindsightScore {
        error_um: mean(&|truth, [median, ..]| (median - truth).abs()),
        width_um: mean(&|_, [_, low, high]| high - low),
        coverage: mean(&|truth, [_, low, high]| f64::from(u8::from(low <= truth && truth <= high))),
    })
}

/// Estimates wear over a run with one record per hour; the first `baseline` records are the baseline.
pub fn estimate_run(
    run: &RecordedRun,
    ensemble: &Arc<Ensemble>,
    baseline: u32,
    options: RunOptions,
) -> Vec<RecordEstimate> {
    estimates(run, ensemble, baseline, options).into_iter().map(RecordEstimate::of).collect()
}

/// Estimates wear over the channels of one machine, recorded at the same times. Returns the estimates of each
/// channel and the joint ones.
pub fn estimate_channels(
    channels: &[RecordedRun],
    ensemble: &Arc<Ensemble>,
    baseline: u32,
    options: RunOptions,
) -> (Vec<Vec<RecordEstimate>>, Vec<RecordEstimate>) {
    let of_channels: Vec<Vec<Estimate>> =
        channels.par_iter().map(|channel| estimates(channel, ensemble, baseline, options)).collect();
    let records = of_channels.iter().map(Vec::len).min().unwrap_or(0);
    let together = |index: usize| {
        let latest = channels.iter().zip(&of_channels);
        let latest: Vec<(&str, &WearEstimate)> =
            latest.map(|(channel, estimates)| (channel.name.as_str(), &estimates[index].wear)).collect();
        let wear = JointEstimate::of(&latest)?.wear;
        Some(RecordEstimate::of(Estimate { wear, ..of_channels[0][index] }))
    };
    let together = (0..records).filter_map(together).collect();
    let of_channels =
        of_channels.into_iter().map(|estimates| estimates.into_iter().map(RecordEstimate::of).collect());
    (of_channels.collect(), together)
}

/// The estimate of one record with the truth.
struct Estimate {
    record: usize,
    truth_um: f64,
    wear: WearEstimate,
}

impl RecordEstimate {
    fn of(estimate: Estimate) -> Self {
        let Estimate { record, truth_um, wear } = estimate;
        let flagged = matches!(wear.status, WearStatus::OutsideLibrary | WearStatus::SensorFault);
        let novelty = wear.novelty.as_ref().filter(|_| flagged);
        Self {
            record,
            truth_um,
            wear_um: median_and_interval(&wear),
            forecast: wear.prognosis.as_ref().map(|prognosis| Forecast::of(prognosis, hour(record))),
            flagged,
            sensor_fault: novelty.and_then(|novelty| novelty.sensor_fault),
            suspected_fault: novelty.and_then(|novelty| novelty.suspected_fault),
            reason: wear.reason,
        }
    }
}

fn estimates(
    run: &RecordedRun,
    ensemble: &Arc<Ensemble>,
    baseline: u32,
    options: RunOptions,
) -> Vec<Estimate> {
    let settings = EstimatorSettings { baseline_records: baseline, limit_um: options.limit_um };
    let tracker = Tracker::new(settings, Some(Arc::clone(ensemble)));
    let mut state = tracker.start();
    let (half, gap) = half_and_gap(run, options);
    let mut estimates = Vec::with_capacity(run.records.len());
    let mut inspection = options.inspection_um;
    for (record, observation) in without(run, &gap) {
        let at = hour(record);
        if record >= half
            && let Some(error_um) = inspection.take()
        {
            tracker.event(&mut state, &inspected(at, observation.wear_um, error_um));
        }
        let wear = tracker.update(&mut state, at, &observation.features);
        estimates.push(Estimate { record, truth_um: observation.wear_um, wear });
    }
    estimates
}

/// Returns the record half-way through a run, and the records around it that are dropped.
fn half_and_gap(run: &RecordedRun, options: RunOptions) -> (usize, Range<usize>) {
    let half = run.records.len() / 2;
    (half, half - options.gap.min(half) / 2..half + options.gap.div_ceil(2))
}

/// Returns the records of a run outside a gap.
fn without<'a>(
    run: &'a RecordedRun,
    gap: &'a Range<usize>,
) -> impl Iterator<Item = (usize, &'a Observation)> {
    run.records.iter().enumerate().filter(|(record, _)| !gap.contains(record))
}

/// Scores the estimates of a run after its baseline, with an inspection half-way if the options have one.
pub fn score_run(name: &str, estimates: &[RecordEstimate], baseline: usize, options: RunOptions) -> RunScore {
    let records = estimates.last().map_or(0, |estimate| estimate.record + 1);
    let inspected_at = options.inspection_um.map(|_| records / 2);
    let estimates: Vec<&RecordEstimate> =
        estimates.iter().filter(|estimate| estimate.record >= baseline).collect();
    let estimated: Vec<(usize, f64, [f64; 3])> = estimates
        .iter()
        .filter_map(|estimate| Some((estimate.record, estimate.truth_um, estimate.wear_um?)))
        .collect();
    let contains = |truth: f64, [_, low, high]: [f64; 3]| low <= truth && truth <= high;
    type Estimated = (usize, f64, [f64; 3]);
    let mean = |values: &dyn Fn(&Estimated) -> f64, from: usize| {
        let chosen: Vec<f64> = estimated.iter().filter(|(record, ..)| *record >= from).map(values).collect();
        (!chosen.is_empty()).then(|| chosen.iter().sum::<f64>() / chosen.len() as f64)
    };
    let score_from = |from: usize| {
        Some(ScoreAfter {
            mean_error_um: mean(&|(_, truth, [median, ..])| (median - truth).abs(), from)?,
            width_um: mean(&|(.., [_, low, high])| high - low, from)?,
            coverage: mean(&|(_, truth, wear)| f64::from(u8::from(contains(*truth, *wear))), from)?,
        })
    };
    let all = score_from(0);
    let (mut longest_miss, mut missed) = (0, 0);
    for (_, truth, wear) in &estimated {
        missed = if contains(*truth, *wear) { 0 } else { missed + 1 };
        longest_miss = longest_miss.max(missed);
    }
    let narrow: Vec<bool> = estimated
        .iter()
        .filter(|(.., [_, low, high])| high - low < NARROW_UM)
        .map(|(_, truth, wear)| contains(*truth, *wear))
        .collect();
    let pairs: Vec<(f64, f64)> = estimated.iter().map(|(_, truth, [median, ..])| (*truth, *median)).collect();
    let flagged = estimates.iter().filter(|estimate| estimate.flagged).count();
    let forecasts: Vec<ForecastRecord> =
        estimates.iter().map(|estimate| (estimate.record, estimate.truth_um, estimate.forecast)).collect();
    RunScore {
        run: name.to_owned(),
        records: estimates.len(),
        estimated: estimated.len(),
        flagged,
        without: estimates.len() - estimated.len() - flagged,
        coverage: all.as_ref().map(|all| all.coverage),
        longest_miss,
        rank: rank_correlation(&pairs),
        mean_error_um: all.as_ref().map(|all| all.mean_error_um),
        bias_um: mean(&|(_, truth, [median, ..])| median - truth, 0),
        width_um: all.as_ref().map(|all| all.width_um),
        narrow: [narrow.len(), narrow.iter().filter(|held| **held).count()],
        last: estimated.last().map(|(.., wear)| *wear),
        after: inspected_at.and_then(score_from),
        in_hindsight: None,
        forecasts: options.limit_um.and_then(|limit_um| score_forecasts(&forecasts, limit_um)),
    }
}

/// Time of a record, one each hour.
fn hour(record: usize) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_hours(record as i64)
}

fn inspected(time: Timestamp, depth_um: f64, error_um: f64) -> MaintenanceEvent {
    MaintenanceEvent {
        time,
        kind: MaintenanceKind::Inspected,
        by: String::new(),
        comment: String::new(),
        inspection: Some(Inspection { depth_um, error_um, gear: None, place: FlankPlace::Greatest }),
        until: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(record: usize, wear_um: Option<[f64; 3]>) -> RecordEstimate {
        RecordEstimate {
            record,
            truth_um: 10.0,
            wear_um,
            forecast: None,
            flagged: false,
            sensor_fault: None,
            suspected_fault: None,
            reason: String::new(),
        }
    }

    #[test]
    fn scores_are_means_over_estimates_and_absent_without_any() {
        let options = RunOptions { inspection_um: Some(5.0), ..RunOptions::default() };
        let mut estimates: Vec<RecordEstimate> = (0..6).map(|record| estimate(record, None)).collect();
        estimates[0].wear_um = Some([50.0, 40.0, 60.0]);
        let without = score_run("a", &estimates, 2, options);
        assert_eq!((without.records, without.estimated, without.without), (4, 0, 4));
        assert_eq!([without.coverage, without.mean_error_um, without.bias_um, without.width_um], [None; 4]);
        assert_eq!(without.after, None);
        estimates[2].wear_um = Some([8.0, 4.0, 12.0]);
        let before = score_run("a", &estimates, 2, options);
        assert_eq!((before.coverage, before.bias_um, before.after), (Some(1.0), Some(-2.0), None));
        estimates[5].wear_um = Some([16.0, 14.0, 24.0]);
        let both = score_run("a", &estimates, 2, options);
        assert_eq!((both.coverage, both.mean_error_um, both.width_um), (Some(0.5), Some(4.0), Some(9.0)));
        let after = ScoreAfter { mean_error_um: 6.0, width_um: 10.0, coverage: 0.0 };
        assert_eq!(both.after, Some(after));
    }
}
