//! Prognosis of when wear passes the user's limit: the posterior of the depth, with the trend of the past.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use super::trend::SECONDS_PER_DAY;

/// No prognosis is made while "no growth" has more than this probability, or the median depth is below this
/// part of the library's end.
const MAX_STANDSTILL: f32 = 0.5;
const MIN_DEPTH_PART: f64 = 0.04;

/// Future rate over the present one: wear speeds up, and estimates follow it late.
const SPEEDING_UP: f64 = 1.25;

/// Standard deviation of the logarithm of the future rate, by the trend's own error and through changes of
/// load and lubrication.
const RATE_SCATTER: f64 = 0.5;

/// Power of the depth over its mean with which the rate is expected: an error that is common to all depths of
/// a machine scales its growth too.
const RATE_POWER: f64 = 0.5;

/// Normal deviates on each side by which a rate is spread.
const DEVIATES: i32 = 4;

/// Longest time that is stated, in ages of the machine.
const MAX_AGES: f64 = 1000.0;

/// Rate of wear and time to the limit, each with its 5 % to 95 % interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Prognosis {
    /// Present rate of growth in µm per day, by the times of the records.
    pub rate_um_per_day: f64,
    /// The wear limit in µm.
    pub limit_um: f64,
    /// Time at which the limit is passed: median.
    pub median: Timestamp,
    /// 5 % quantile of this time.
    pub p05: Timestamp,
    /// 95 % quantile of this time; absent where it is too far in the future.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p95: Option<Timestamp>,
}

/// What a prognosis extrapolates.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outlook<'a> {
    /// Depths in µm and their probability.
    pub(super) depths_um: &'a [f64],
    pub(super) by_depth: &'a [f64],
    /// Probability that wear does not grow.
    pub(super) standstill: f32,
    /// Rates of growth in µm per day, equally probable; `None` without growth.
    pub(super) rates_um_per_day: Option<[f64; 2]>,
    /// Age of the machine in seconds.
    pub(super) age_s: f64,
}

impl Outlook<'_> {
    /// Returns when `limit_um` is passed, from the time `now` on.
    pub(super) fn prognosis(&self, limit_um: f64, now: Timestamp) -> Option<Prognosis> {
        let rates = self.rates_um_per_day.filter(|_| self.standstill <= MAX_STANDSTILL)?;
        let end_um = self.depths_um.last().copied()?;
        let median_um = self.median_um()?;
        if median_um < MIN_DEPTH_PART * end_um || median_um >= limit_um {
            return None;
        }
        let mut passes = self.passes(limit_um, rates);
        passes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total: f64 = passes.iter().map(|(_, weight)| weight).sum();
        let quantile = |level: f64| {
            let mut below = 0.0;
            let found = passes.iter().find(|(_, weight)| {
                below += weight;
                below >= level * total
            });
            found.map_or(f64::INFINITY, |(days, _)| *days)
        };
        let time = |days: f64| {
            let seconds = days * SECONDS_PER_DAY;
            let is_near = seconds <= MAX_AGES * self.age_s;
            let away = is_near.then(|| SignedDuration::try_from_secs_f64(seconds).ok()).flatten()?;
            now.checked_add(away).ok()
        };
        Some(Prognosis {
            rate_um_per_day: rates.iter().sum::<f64>() / rates.len() as f64,
            limit_um,
            median: time(quantile(0.5))?,
            p05: time(quantile(0.05))?,
            p95: time(quantile(0.95)),
        })
    }

    /// Returns days until the limit is passed, with their weights.
    fn passes(&self, limit_um: f64, rates: [f64; 2]) -> Vec<(f64, f64)> {
        let deviates = (-DEVIATES..=DEVIATES).map(|step| 2.5 * f64::from(step) / f64::from(DEVIATES));
        let scatter: Vec<(f64, f64)> =
            deviates.map(|z| ((RATE_SCATTER * z).exp(), (-0.5 * z * z).exp())).collect();
        let mean_um: f64 = self.depths_um.iter().zip(self.by_depth).map(|(um, p)| um * p).sum();
        let cells = self.depths_um.iter().zip(self.by_depth).filter(|(_, p)| **p > 1e-6);
        let pass = |(depth_um, p): (&f64, &f64)| {
            let left_um = (limit_um - depth_um).max(0.0);
            let relative = (depth_um.max(1.0) / mean_um).powf(RATE_POWER);
            let of_rate = |rate: f64| left_um / (SPEEDING_UP * relative * rate);
            rates.map(|rate| (of_rate(rate), *p))
        };
        let spread =
            |(days, p): (f64, f64)| scatter.iter().map(move |(factor, weight)| (days / factor, p * weight));
        cells.flat_map(pass).flat_map(spread).collect()
    }

    fn median_um(&self) -> Option<f64> {
        let total: f64 = self.by_depth.iter().sum();
        let mut below = 0.0;
        let at_median = |(_, p): &(&f64, &f64)| {
            below += **p;
            below >= 0.5 * total
        };
        self.depths_um.iter().zip(self.by_depth).find(at_median).map(|(um, _)| *um)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AGE_S: f64 = 30.0 * SECONDS_PER_DAY;

    /// The outlook for one certain depth.
    fn prognosis(
        depth_um: f64,
        standstill: f32,
        rates: Option<[f64; 2]>,
        limit_um: f64,
    ) -> Option<Prognosis> {
        let depths_um: Vec<f64> = (0..50).map(|i| 5.0 * f64::from(i)).collect();
        let by_depth: Vec<f64> = depths_um.iter().map(|um| f64::from(u8::from(*um == depth_um))).collect();
        let outlook = Outlook {
            depths_um: &depths_um,
            by_depth: &by_depth,
            standstill,
            rates_um_per_day: rates,
            age_s: AGE_S,
        };
        outlook.prognosis(limit_um, Timestamp::UNIX_EPOCH)
    }

    #[test]
    fn a_known_rate_gives_the_time_to_the_limit() {
        let found = prognosis(50.0, 0.1, Some([40.0; 2]), 150.0).unwrap();
        let days =
            |time: Timestamp| time.duration_since(Timestamp::UNIX_EPOCH).as_secs_f64() / SECONDS_PER_DAY;
        assert!((days(found.median) - 2.0).abs() < 0.01, "{found:?}");
        assert!(days(found.p05) < 1.1 && (3.5..6.0).contains(&days(found.p95.unwrap())), "{found:?}");
        assert_eq!(found.rate_um_per_day, 40.0);
    }

    #[test]
    fn two_rates_are_equally_probable() {
        let days =
            |time: Timestamp| time.duration_since(Timestamp::UNIX_EPOCH).as_secs_f64() / SECONDS_PER_DAY;
        let found = prognosis(50.0, 0.1, Some([4.0, 400.0]), 150.0).unwrap();
        assert!(days(found.p05) < 0.2 && days(found.p95.unwrap()) > 30.0, "{found:?}");
    }

    #[test]
    fn no_prognosis_without_growth_or_beyond_the_limit() {
        assert_eq!(prognosis(50.0, 0.6, Some([40.0; 2]), 150.0), None);
        assert_eq!(prognosis(50.0, 0.1, None, 150.0), None);
        assert_eq!(prognosis(150.0, 0.1, Some([40.0; 2]), 150.0), None);
        assert_eq!(prognosis(5.0, 0.1, Some([40.0; 2]), 150.0), None);
    }

    #[test]
    fn a_time_too_far_in_the_future_is_not_stated() {
        assert_eq!(prognosis(50.0, 0.1, Some([1e-9; 2]), 150.0), None);
    }
}
