//! Scores of forecasts of the time to a limit.

use jiff::Timestamp;
use serde::Serialize;

use flankwatch_wear::estimate::Prognosis;

/// A forecast of when wear passes the limit, in records from the present one on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Forecast {
    /// Median.
    pub median: f64,
    /// 5 % quantile.
    pub p05: f64,
    /// 95 % quantile; absent where it is too far in the future.
    pub p95: Option<f64>,
}

impl Forecast {
    /// Converts a prognosis at a time, for one record per hour.
    pub(super) fn of(prognosis: &Prognosis, now: Timestamp) -> Self {
        let records = |time: Timestamp| time.duration_since(now).as_secs_f64() / 3600.0;
        Self {
            median: records(prognosis.median),
            p05: records(prognosis.p05),
            p95: prognosis.p95.map(records),
        }
    }
}

/// Scores of the forecasts of one run, over the records before wear passes the limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ForecastScore {
    /// Records before it.
    pub records: usize,
    /// Records with a forecast.
    pub given: usize,
    /// Forecasts whose 5 % to 95 % interval contains the passing.
    pub holding: usize,
    /// Forecasts whose 5 % quantile is later than the passing.
    pub too_late: usize,
    /// Median over the forecasts of the forecast's median over the true time left.
    pub median_ratio: Option<f64>,
    /// The same of the 95 % quantile, infinite where that is absent.
    pub late_ratio: Option<f64>,
}

/// A record after the baseline: its index, the true depth in µm, and the forecast, where there is one.
pub(super) type ForecastRecord = (usize, f64, Option<Forecast>);

/// Scores the forecasts of a run; `None` if wear does not pass the limit in it.
pub(super) fn score_forecasts(records: &[ForecastRecord], limit_um: f64) -> Option<ForecastScore> {
    let (passed, ..) = *records.iter().find(|(_, truth_um, _)| *truth_um >= limit_um)?;
    // The last record before it leaves no time to compare with.
    let before = records.iter().take_while(|(record, ..)| record + 1 < passed);
    let given: Vec<(f64, Forecast)> = before
        .clone()
        .filter_map(|(record, _, forecast)| Some(((passed - record) as f64, (*forecast)?)))
        .collect();
    let median = |of: &dyn Fn(&Forecast) -> f64| {
        // Wear passes the limit between two records.
        let mut ratios: Vec<f64> = given.iter().map(|(left, forecast)| of(forecast) / (left - 0.5)).collect();
        ratios.sort_by(f64::total_cmp);
        ratios.get(ratios.len() / 2).copied()
    };
    let is_too_late = |(left, forecast): &(f64, Forecast)| forecast.p05 > *left;
    let is_too_early =
        |(left, forecast): &(f64, Forecast)| forecast.p95.is_some_and(|late| late < left - 1.0);
    Some(ForecastScore {
        records: before.count(),
        given: given.len(),
        holding: given.iter().filter(|forecast| !is_too_late(forecast) && !is_too_early(forecast)).count(),
        too_late: given.iter().filter(|forecast| is_too_late(forecast)).count(),
        median_ratio: median(&|forecast| forecast.median),
        late_ratio: median(&|forecast| forecast.p95.unwrap_or(f64::INFINITY)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forecasts_are_compared_with_the_passing() {
        // Wear passes 100 µm between the records 7 and 8.
        let forecasts = [None, Some([1.0, 3.25, 9.0]), Some([6.0, 7.0, 8.0]), Some([0.5, 1.0, 2.0])];
        let forecast = |[p05, median, p95]: [f64; 3]| Forecast { median, p05, p95: Some(p95) };
        let at = |index: usize| forecasts[index].map(forecast);
        let records =
            [(4, 40.0, at(0)), (5, 50.0, at(1)), (6, 60.0, at(2)), (7, 70.0, at(3)), (8, 100.0, None)];
        let score = score_forecasts(&records, 100.0).unwrap();
        // Record 7 is the last one before.
        assert_eq!((score.records, score.given, score.holding, score.too_late), (3, 2, 1, 1));
        assert_eq!(score.median_ratio, Some(7.0 / 1.5));
        assert_eq!(score_forecasts(&records, 101.0), None);
        let without = score_forecasts(&records.map(|(record, um, _)| (record, um, None)), 100.0).unwrap();
        assert_eq!((without.given, without.median_ratio), (0, None));
    }
}
