//! Prognosis of when wear passes the user's limit, extrapolated from the posterior of depth and rate.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use super::growth::rates_um;
use crate::library::{DEPTHS, end_um};

/// No prognosis is made while "no growth" has more than this probability, or the median depth is below this
/// part of the library's end.
const MAX_STANDSTILL: f64 = 0.5;
const MIN_DEPTH_PART: f64 = 0.04;

/// Standard deviation of the logarithm of the future rate over the present one: within a class of rates, and
/// through changes of load and lubrication.
const RATE_SCATTER: f64 = 0.4;

/// Normal deviates on each side by which a rate is spread.
const DEVIATES: i32 = 6;

/// Longest time in units that is stated.
const MAX_UNITS: f64 = 1e5;

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

/// Returns when `limit_um` is passed, from the probability `by_rate` over rates and depths at the time `now`;
/// a unit of growth takes `unit_s` seconds.
pub(super) fn prognosis(
    by_rate: &[f32],
    depths_um: &[f64],
    limit_um: f64,
    now: Timestamp,
    unit_s: f64,
) -> Option<Prognosis> {
    let total: f64 = by_rate.iter().map(|p| f64::from(*p)).sum();
    let standing: f64 = by_rate[..DEPTHS].iter().map(|p| f64::from(*p)).sum();
    let median = median_um(by_rate, depths_um);
    if unit_s <= 0.0
        || standing > MAX_STANDSTILL * total
        || median < MIN_DEPTH_PART * end_um(depths_um)
        || median >= limit_um
    {
        return None;
    }
    let mut passes: Vec<(f64, f64)> = Vec::new();
    let mut rate_um = 0.0;
    // A rate of 0 is a pause; after it, wear continues at one of the other rates by their probabilities.
    let growing = by_rate.chunks_exact(DEPTHS).zip(rates_um(depths_um)).skip(1);
    for (row, rate) in growing {
        for (p, depth_um) in row.iter().zip(depths_um).filter(|(p, _)| **p > 1e-6) {
            let weight = f64::from(*p) / (total - standing);
            rate_um += weight * rate;
            for step in -DEVIATES..=DEVIATES {
                let z = 2.5 * f64::from(step) / f64::from(DEVIATES);
                let units = (limit_um - depth_um).max(0.0) / (rate * (RATE_SCATTER * z).exp());
                passes.push((units, weight * (-0.5 * z * z).exp() / spread_total()));
            }
        }
    }
    passes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let quantile = |level: f64| {
        let mut below = 0.0;
        let found = passes.iter().find(|(_, weight)| {
            below += weight;
            below >= level
        });
        found.map_or(f64::INFINITY, |(units, _)| *units)
    };
    let time = |units: f64| {
        let is_near = units <= MAX_UNITS;
        let away = is_near.then(|| SignedDuration::try_from_secs_f64(units * unit_s).ok()).flatten()?;
        now.checked_add(away).ok()
    };
    Some(Prognosis {
        rate_um_per_day: rate_um * 86_400.0 / unit_s,
        limit_um,
        median: time(quantile(0.5))?,
        p05: time(quantile(0.05))?,
        p95: time(quantile(0.95)),
    })
}

fn spread_total() -> f64 {
    let deviate = |step| 2.5 * f64::from(step) / f64::from(DEVIATES);
    (-DEVIATES..=DEVIATES).map(|step| (-0.5 * f64::powi(deviate(step), 2)).exp()).sum()
}

fn median_um(by_rate: &[f32], depths_um: &[f64]) -> f64 {
    let total: f64 = by_rate.iter().map(|p| f64::from(*p)).sum();
    let mut below = 0.0;
    for (depth, um) in depths_um.iter().enumerate() {
        below += by_rate.iter().skip(depth).step_by(DEPTHS).map(|p| f64::from(*p)).sum::<f64>();
        if below >= 0.5 * total {
            return *um;
        }
    }
    depths_um.last().copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::super::growth::RATES;
    use super::*;

    fn sure(rate: usize, depth: usize) -> (Vec<f32>, Vec<f64>) {
        let mut by_rate = vec![0.0; RATES * DEPTHS];
        by_rate[rate * DEPTHS + depth] = 1.0;
        (by_rate, (0..DEPTHS).map(|i| 5.0 * i as f64).collect())
    }

    #[test]
    fn a_known_rate_gives_the_time_to_the_limit() {
        let (by_rate, depths) = sure(3, 10);
        let told = prognosis(&by_rate, &depths, 130.0, Timestamp::UNIX_EPOCH, 3600.0).unwrap();
        let hours = |time: Timestamp| time.duration_since(Timestamp::UNIX_EPOCH).as_secs_f64() / 3600.0;
        assert!((hours(told.median) - 50.0).abs() < 1.0, "{told:?}");
        assert!(hours(told.p05) < 30.0 && hours(told.p95.unwrap()) > 80.0, "{told:?}");
        assert!((told.rate_um_per_day - 24.0 * rates_um(&depths)[3]).abs() < 1e-6);
    }

    #[test]
    fn no_prognosis_without_growth_or_beyond_the_limit() {
        let (standing, depths) = sure(0, 10);
        assert_eq!(prognosis(&standing, &depths, 130.0, Timestamp::UNIX_EPOCH, 3600.0), None);
        let (past, _) = sure(3, 30);
        assert_eq!(prognosis(&past, &depths, 130.0, Timestamp::UNIX_EPOCH, 3600.0), None);
        let (early, _) = sure(3, 1);
        assert_eq!(prognosis(&early, &depths, 130.0, Timestamp::UNIX_EPOCH, 3600.0), None);
    }
}
