//! When wear passes the user's limit: what is believed of depth and rate, carried on.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use super::growth::rates_um;
use crate::library::DEPTHS;

/// Nothing is said while "no growth" has more than this probability, or the median depth is below this part
/// of the greatest.
const MAX_STANDSTILL: f64 = 0.5;
const MIN_DEPTH_PART: f64 = 0.04;

/// Standard deviation of the logarithm of the rate on the way over that now: within a class of rates, and as
/// load and lubrication change.
const RATE_SCATTER: f64 = 0.4;

/// Normal deviates that spread a rate.
const DEVIATES: i32 = 6;

/// No time beyond this many units is told.
const MAX_UNITS: f64 = 1e5;

/// Rate of wear and time to the limit, each with its 5 % to 95 % interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Prognosis {
    /// Growth in µm a day of running time between records, now.
    pub rate_um_per_day: f64,
    /// The wear depth that the times are about, in µm.
    pub limit_um: f64,
    /// When the limit is passed: median.
    pub median: Timestamp,
    /// 5 % quantile.
    pub p05: Timestamp,
    /// 95 % quantile; none where the limit may not be passed for very long.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p95: Option<Timestamp>,
}

/// When `limit_um` is passed, from the probability `by_rate` over rates and depths at the time `now`; a unit
/// of growth takes `unit_s` seconds.
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
        || median < MIN_DEPTH_PART * depths_um.last().copied().unwrap_or(0.0)
        || median >= limit_um
    {
        return None;
    }
    let mut passes: Vec<(f64, f64)> = Vec::new();
    let mut rate_um = 0.0;
    // Of a machine that wears: a rate of 0 is a pause, and what comes after it is what is known of the rates
    // above.
    let moving = by_rate.chunks_exact(DEPTHS).zip(rates_um(depths_um)).skip(1);
    for (row, rate) in moving {
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
        let told = units <= MAX_UNITS;
        let away = told.then(|| SignedDuration::try_from_secs_f64(units * unit_s).ok()).flatten()?;
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
    fn a_known_rate_passes_the_limit_when_it_must() {
        let (by_rate, depths) = sure(3, 10);
        let told = prognosis(&by_rate, &depths, 130.0, Timestamp::UNIX_EPOCH, 3600.0).unwrap();
        let hours = |time: Timestamp| time.duration_since(Timestamp::UNIX_EPOCH).as_secs_f64() / 3600.0;
        assert!((hours(told.median) - 50.0).abs() < 1.0, "{told:?}");
        assert!(hours(told.p05) < 30.0 && hours(told.p95.unwrap()) > 80.0, "{told:?}");
        assert!((told.rate_um_per_day - 24.0 * rates_um(&depths)[3]).abs() < 1e-6);
    }

    #[test]
    fn nothing_is_said_without_growth_or_beyond_the_limit() {
        let (standing, depths) = sure(0, 10);
        assert_eq!(prognosis(&standing, &depths, 130.0, Timestamp::UNIX_EPOCH, 3600.0), None);
        let (past, _) = sure(3, 30);
        assert_eq!(prognosis(&past, &depths, 130.0, Timestamp::UNIX_EPOCH, 3600.0), None);
        let (early, _) = sure(3, 1);
        assert_eq!(prognosis(&early, &depths, 130.0, Timestamp::UNIX_EPOCH, 3600.0), None);
    }
}
