//! How fast wear grows, and when it passes the user's limit.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

/// Powers of time that wear may have grown by, since the baseline's first record.
const POWERS: [f64; 7] = [0.7, 0.85, 1.0, 1.25, 1.5, 1.75, 2.0];

/// Points of the history that are kept: of a longer one every second, then every fourth and so on.
const MOST_POINTS: usize = 64;

/// Standard deviation of the logarithm of the depth at the limit over that now, beyond what the history shows: how much an error of the
/// library may change on the way, for each doubling of the depth.
const DRIFT: f64 = 0.2;

/// Errors of neighbouring depths are alike: this many points of the history count as one.
const ALIKE: f64 = 20.0;

/// How much wider the time's interval is than the depth's where the shape of the wear is not known: wear of another shape also changes how the tracked depth
/// grows, above all towards the library's end.
const SHAPE_DRIFT: f64 = 1.2;

/// Least scatter of the logarithm of depths around a power of time.
const LEAST_SCATTER: f64 = 0.05;

/// The rate is known when the history is at least this long and wear has grown by this many µm and by twice the interval's half.
const LEAST_POINTS: usize = 12;
const LEAST_GROWTH_UM: f64 = 10.0;

/// Normal deviates that spread the depth at the limit.
const DEVIATES: i32 = 8;

/// No time to a limit beyond this many times the history's length is told.
const FARTHEST: f64 = 100.0;

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

/// The latest estimate.
#[derive(Debug, Clone, Copy)]
pub(super) struct Now {
    pub(super) at: Timestamp,
    pub(super) depth_um: f64,
    pub(super) half_width_um: f64,
}

/// Depths so far, thinned.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct WearHistory {
    start: Option<Timestamp>,
    /// Seconds since the start, median and half-width of the interval in µm.
    points: Vec<[f64; 3]>,
    /// Every how many-th record is kept, and how many came since the last one.
    stride: u32,
    since: u32,
}

impl WearHistory {
    /// The history of an asset whose baseline began at this time.
    pub(super) fn from(start: Timestamp) -> Self {
        Self {
            start: Some(start),
            stride: 1,
            ..Self::default()
        }
    }

    /// Puts down a record's estimate.
    pub(super) fn push(&mut self, at: Timestamp, median_um: f64, half_width_um: f64) {
        let Some(start) = self.start else { return };
        self.since += 1;
        if self.since < self.stride {
            return;
        }
        self.since = 0;
        self.points.push([at.duration_since(start).as_secs_f64(), median_um, half_width_um]);
        if self.points.len() > MOST_POINTS {
            let mut index = 0;
            self.points.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stride *= 2;
        }
    }

    /// When `limit_um` is passed, as far as the history tells. The depths of the history are tracked ones; `shape_deviation` is the standard deviation
    /// of the logarithm of true over tracked depth, the same at all times.
    pub(super) fn prognosis(&self, now: Now, limit_um: f64, shape_deviation: f64) -> Option<Prognosis> {
        let start = self.start?;
        let Now {
            at: now,
            depth_um: now_um,
            half_width_um,
        } = now;
        let (first, now_s) = (self.points.first()?, now.duration_since(start).as_secs_f64());
        let grown = now_um - first[1];
        let known = self.points.len() >= LEAST_POINTS && grown > LEAST_GROWTH_UM && grown > 2.0 * half_width_um && now_s > 0.0;
        if !known || now_um >= limit_um {
            return None;
        }
        // What is known of the shape of the growth comes from the upper half of the depths: errors there are smallest against them.
        let used: Vec<&[f64; 3]> = self
            .points
            .iter()
            .filter(|point| point[1] > 0.3 * now_um && point[0] > 0.0)
            .collect();
        let latest = now_s.ln();
        let mut passes: Vec<(f64, f64)> = Vec::new();
        let mut rate = 0.0;
        let misfits: Vec<(f64, f64)> = POWERS.iter().map(|&power| (power, misfit(&used, power, latest, now_um))).collect();
        let least = misfits.iter().map(|(_, misfit)| *misfit).fold(f64::INFINITY, f64::min);
        let scatter = (least / used.len().max(1) as f64).max(LEAST_SCATTER * LEAST_SCATTER);
        let total: f64 = misfits
            .iter()
            .map(|(_, misfit)| (-0.5 * (misfit - least) / scatter / ALIKE).exp())
            .sum();
        let history = DRIFT * (limit_um / now_um).log2() + 0.5 * half_width_um / now_um * (1.0 - now_um / limit_um);
        let drift = history.hypot(SHAPE_DRIFT * shape_deviation);
        for (power, misfit) in misfits {
            let weight = (-0.5 * (misfit - least) / scatter / ALIKE).exp() / total;
            rate += weight * power * now_um / now_s;
            for step in -DEVIATES..=DEVIATES {
                let z = 2.5 * f64::from(step) / f64::from(DEVIATES);
                let depth = (limit_um * (drift * z).exp()).max(now_um);
                let seconds = now_s * (depth / now_um).powf(1.0 / power);
                passes.push((seconds, weight * (-0.5 * z * z).exp()));
            }
        }
        passes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let all: f64 = passes.iter().map(|(_, weight)| weight).sum();
        let quantile = |level: f64| {
            let mut below = 0.0;
            passes
                .iter()
                .find(|(_, weight)| {
                    below += weight;
                    below >= level * all
                })
                .map_or(f64::INFINITY, |(seconds, _)| *seconds)
        };
        let time = |seconds: f64| {
            let told = seconds <= FARTHEST * now_s;
            let away = told.then(|| SignedDuration::try_from_secs_f64(seconds).ok()).flatten()?;
            start.checked_add(away).ok()
        };
        Some(Prognosis {
            rate_um_per_day: rate * 86_400.0,
            limit_um,
            median: time(quantile(0.5))?,
            p05: time(quantile(0.05))?,
            p95: time(quantile(0.95)),
        })
    }
}

/// Sum of squares of the logarithms of depths around a power of time through the latest depth, the factor fitted.
fn misfit(points: &[&[f64; 3]], power: f64, latest: f64, now_um: f64) -> f64 {
    let residuals = || {
        points
            .iter()
            .map(|point| (point[1] / now_um).ln() - power * (point[0].ln() - latest))
    };
    let mean = residuals().sum::<f64>() / points.len().max(1) as f64;
    residuals().map(|residual| (residual - mean).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn latest(at: Timestamp, depth_um: f64, half_width_um: f64) -> Now {
        Now {
            at,
            depth_um,
            half_width_um,
        }
    }

    fn history(power: f64, records: u32, of: u32) -> (WearHistory, Timestamp) {
        let start = Timestamp::UNIX_EPOCH;
        let mut history = WearHistory::from(start);
        let at = |i: u32| start + SignedDuration::from_hours(i64::from(i));
        for i in 1..=records {
            history.push(at(i), 240.0 * (f64::from(i) / f64::from(of)).powf(power), 5.0);
        }
        (history, at(records))
    }

    /// Wear as a power of time: the crossing is at (200/240)^(1/p) of the life.
    #[test]
    fn the_crossing_of_a_power_of_time_is_within_the_interval() {
        for power in [0.8, 1.0, 1.5, 1.9] {
            for half in [150, 200, 230] {
                let (history, now) = history(power, half, 300);
                let now_um = 240.0 * (f64::from(half) / 300.0).powf(power);
                let truth = 300.0 * (200.0_f64 / 240.0).powf(1.0 / power);
                let told = history.prognosis(latest(now, now_um, 5.0), 200.0, 0.0).unwrap();
                let hours = |time: Timestamp| time.duration_since(Timestamp::UNIX_EPOCH).as_secs_f64() / 3600.0;
                assert!(
                    hours(told.p05) < truth && truth < hours(told.p95.unwrap()),
                    "{power} {half}: {told:?}"
                );
                assert!((hours(told.median) / truth - 1.0).abs() < 0.1, "{power} {half}: {told:?}");
                let rate = 24.0 * power * now_um / f64::from(half);
                assert!((told.rate_um_per_day / rate - 1.0).abs() < 0.25, "{told:?} {rate}");
            }
        }
    }

    #[test]
    fn nothing_is_said_before_the_rate_is_known_or_after_the_limit() {
        let (history, now) = history(1.0, 5, 300);
        assert_eq!(history.prognosis(latest(now, 4.0, 2.0), 200.0, 0.0), None);
        let (history, now) = self::history(1.0, 290, 300);
        assert_eq!(history.prognosis(latest(now, 232.0, 2.0), 200.0, 0.0), None);
        // Half the interval is as wide as what has grown.
        assert_eq!(history.prognosis(latest(now, 100.0, 80.0), 200.0, 0.0), None);
    }

    #[test]
    fn a_long_history_stays_short() {
        let (history, _) = history(1.0, 10_000, 10_000);
        assert!(history.points.len() <= MOST_POINTS && history.points.len() > MOST_POINTS / 3);
    }
}
