//! The trend of the wear depth: how fast the mean depth has grown lately.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

pub(super) const SECONDS_PER_DAY: f64 = 86_400.0;

/// Lengths of the two windows in parts of the machine's age. The long one has less scatter; the short one
/// follows wear that begins or speeds up.
const WINDOW_PARTS: [f64; 2] = [0.5, 0.1];

/// Least growth over the long window, in parts of the mean depth, that is a trend.
const MIN_GROWTH_PART: f64 = 0.05;

/// Least rate of the short window over that of the long one, which scatter alone may turn negative.
const MIN_SHORT_TO_LONG: f64 = 0.1;

/// Largest factor by which an inspection changes the depths before it.
const MAX_RESCALE: f64 = 5.0;

/// Mean depths of one channel's records, weighted exponentially over two windows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Trend {
    newest: Timestamp,
    /// Mean depth of the newest record.
    mean_um: f64,
    /// Whether no record has come since an inspection.
    inspected: bool,
    windows: [Window; 2],
}

/// Sums over records, weighted by age. Times are in days before the newest record.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
struct Window {
    weight: f64,
    time: f64,
    time_squared: f64,
    depth: f64,
    depth_time: f64,
}

impl Trend {
    /// Starts the trend at the end of a baseline.
    pub(super) fn start(ended: Timestamp) -> Self {
        Self { newest: ended, mean_um: 0.0, inspected: false, windows: Default::default() }
    }

    /// Adds a record with the mean of its posterior, at an age of `age_s` seconds.
    pub(super) fn add(&mut self, at: Timestamp, mean_um: f64, age_s: f64) {
        let elapsed_s = at.duration_since(self.newest).as_secs_f64().max(0.0);
        let rescale = match self.inspected && self.mean_um > 0.0 {
            true => (mean_um / self.mean_um).clamp(1.0 / MAX_RESCALE, MAX_RESCALE),
            false => 1.0,
        };
        for (window, part) in self.windows.iter_mut().zip(WINDOW_PARTS) {
            window.rescale(rescale);
            window.pass(elapsed_s, part * age_s);
            window.add(mean_um);
        }
        self.newest = at.max(self.newest);
        self.mean_um = mean_um;
        self.inspected = false;
    }

    /// Takes notice of an inspection. It moves the estimate, while the teeth stay as they are: the depths
    /// before it are corrected by the same factor as the next one.
    pub(super) fn inspect(&mut self) {
        self.inspected = true;
    }

    /// Returns the rates of growth over the long and the short window in µm per day; `None` without growth.
    pub(super) fn rates_um_per_day(&self, age_s: f64) -> Option<[f64; 2]> {
        let [long, short] = [self.windows[0].slope()?, self.windows[1].slope()?];
        let window_days = WINDOW_PARTS[0] * age_s / SECONDS_PER_DAY;
        (long * window_days > MIN_GROWTH_PART * self.mean_um)
            .then(|| [long, short.max(MIN_SHORT_TO_LONG * long)])
    }
}

impl Window {
    fn rescale(&mut self, factor: f64) {
        self.depth *= factor;
        self.depth_time *= factor;
    }

    /// Lets time pass, in which older records lose weight with a time constant of `window_s` seconds.
    fn pass(&mut self, elapsed_s: f64, window_s: f64) {
        if elapsed_s <= 0.0 || window_s <= 0.0 {
            return;
        }
        let days = elapsed_s / SECONDS_PER_DAY;
        self.time_squared += days * (days * self.weight - 2.0 * self.time);
        self.depth_time -= days * self.depth;
        self.time -= days * self.weight;
        let kept = (-elapsed_s / window_s).exp();
        for sum in
            [&mut self.weight, &mut self.time, &mut self.time_squared, &mut self.depth, &mut self.depth_time]
        {
            *sum *= kept;
        }
    }

    /// Adds a record at the present time.
    fn add(&mut self, depth_um: f64) {
        self.weight += 1.0;
        self.depth += depth_um;
    }

    /// Slope of the line of least squares, in µm per day.
    fn slope(&self) -> Option<f64> {
        let spread = self.weight * self.time_squared - self.time * self.time;
        (spread > 1e-12 * self.time_squared.max(f64::MIN_POSITIVE))
            .then(|| (self.weight * self.depth_time - self.time * self.depth) / spread)
    }
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;

    const HOUR_S: f64 = 3600.0;

    fn age_s(hours: i64) -> f64 {
        HOUR_S * hours.max(10) as f64
    }

    fn at(hours: i64) -> Timestamp {
        Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hours)
    }

    /// A trend of hourly records with these depths.
    fn of(depths_um: impl IntoIterator<Item = f64>) -> Trend {
        let mut trend = Trend::start(at(0));
        (1..).zip(depths_um).for_each(|(hour, um)| trend.add(at(hour), um, age_s(hour)));
        trend
    }

    #[test]
    fn constant_growth_gives_its_rate_in_both_windows() {
        let rates = of((1..=40).map(|hour| 2.0 * f64::from(hour))).rates_um_per_day(age_s(40)).unwrap();
        assert!(rates.iter().all(|rate| (rate - 48.0).abs() < 1e-6), "{rates:?}");
    }

    #[test]
    fn the_short_window_follows_growth_that_speeds_up() {
        let [long, short] =
            of((1..=40).map(|hour| 0.1 * f64::from(hour * hour))).rates_um_per_day(age_s(40)).unwrap();
        assert!(long < 0.85 * short && short < 24.0 * 8.0, "{long} {short}");
    }

    #[test]
    fn a_depth_that_stays_has_no_trend() {
        assert_eq!(of([50.0; 40]).rates_um_per_day(age_s(40)), None);
        assert_eq!(of([50.0]).rates_um_per_day(age_s(40)), None);
        // Records whose times are all the same.
        let mut trend = Trend::start(at(0));
        (0..9).for_each(|step| trend.add(at(0), f64::from(step), 0.0));
        assert_eq!(trend.rates_um_per_day(0.0), None);
    }

    #[test]
    fn an_inspection_changes_the_rate_in_proportion_to_the_depth() {
        let mut trend = of((1..=40).map(|hour| 2.0 * f64::from(hour)));
        trend.inspect();
        (41..=50).for_each(|hour| trend.add(at(hour), 1.5 * 2.0 * hour as f64, age_s(hour)));
        let rates = trend.rates_um_per_day(age_s(40)).unwrap();
        // The growth between the last record before it and the first after it counts as a correction.
        assert!(rates.iter().all(|rate| (60.0..75.0).contains(rate)), "{rates:?}");
    }
}
