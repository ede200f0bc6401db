//! The time of a stream's samples: by their index, with tracking of the rate's drift.

use serde::{Deserialize, Serialize};

/// Length of a window in seconds. Its earliest observation counts, so short delays have no effect.
const WINDOW_S: f64 = 10.0;

/// Number of windows over which the rate is measured: ten minutes.
const MAX_POINTS: usize = 60;

/// Fewest windows for a known rate.
const MIN_POINTS: usize = 6;

/// Deviation in seconds that counts as a clock jump or a long delay.
const JUMP_S: f64 = 0.5;

/// Largest drift that is tracked; crystals stay within 1e-4.
const MAX_DRIFT: f64 = 5e-4;

/// Largest correction rate of a time offset, in seconds per second.
const MAX_STEERING: f64 = 2e-4;

/// Assigns a time to each sample.
///
/// The first observation sets the start of the stream. From then on time follows the index, at the sender's
/// rate corrected by the drift that later observations show. A jump of the sender's clock does not move the
/// time: its offset is subtracted from then on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct StreamClock {
    sample_rate_hz: f64,
    anchor: Option<Anchor>,
    /// Offset of the sender's clock relative to the stream's, in seconds: the sum of its jumps.
    offset_s: f64,
    jumps: u64,
    window: Option<Window>,
    /// Lateness of the last window without a jump.
    late_s: f64,
    /// Seconds since the start according to the sender's rate, and according to the clock.
    points: Vec<(f64, f64)>,
    drift: f64,
}

/// A sample with a fixed time, and the rate of time after it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Anchor {
    first_index: u64,
    first_ns: i64,
    index: u64,
    time_ns: i64,
    /// Relative excess of the sampling rate over the sender's rate.
    drift: f64,
}

/// The earliest observation of a window.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Window {
    begin: u64,
    index: u64,
    time_ns: i64,
    late_s: f64,
}

impl StreamClock {
    /// Creates a clock for a stream with this rate.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self { sample_rate_hz, ..Self::default() }
    }

    /// Records that a sample existed at a time of the sender's clock. Observations must be in sample order.
    pub fn observe(&mut self, index: u64, time_ns: i64) {
        if self.anchor.is_none() {
            let begin = Anchor { first_index: index, first_ns: time_ns, index, time_ns, drift: 0.0 };
            self.anchor = Some(begin);
        }
        let Some(expected_ns) = self.time_ns(index) else { return };
        let late_s = (time_ns as f64 - expected_ns as f64) / 1e9 - self.offset_s;
        match &mut self.window {
            Some(window) if ((index - window.begin) as f64) < WINDOW_S * self.sample_rate_hz => {
                if late_s < window.late_s {
                    *window = Window { index, time_ns, late_s, ..*window };
                }
            }
            window => {
                let over = window.replace(Window { begin: index, index, time_ns, late_s });
                if let Some(over) = over {
                    self.steer(over, index);
                }
            }
        }
    }

    /// Returns the time of a sample in nanoseconds since 1970; `None` before the first observation.
    pub fn time_ns(&self, index: u64) -> Option<i64> {
        let anchor = self.anchor?;
        let frames = index as f64 - anchor.index as f64;
        let seconds = frames / (self.sample_rate_hz * (1.0 + anchor.drift));
        Some(anchor.time_ns.saturating_add((seconds * 1e9).round() as i64))
    }

    /// Returns the excess of the sampling rate over the sender's rate in parts per million; `None` until it
    /// is known.
    pub fn drift_ppm(&self) -> Option<f64> {
        (self.points.len() >= MIN_POINTS).then_some(self.drift * 1e6)
    }

    /// Returns the number of jumps of the sender's clock.
    pub fn jumps(&self) -> u64 {
        self.jumps
    }

    /// Applies the observation of a window from `index` on.
    fn steer(&mut self, window: Window, index: u64) {
        let Some(anchor) = self.anchor else { return };
        if window.late_s.abs() > JUMP_S {
            // Without the jump the clock would have shown the previous lateness.
            let jump_s = window.late_s - self.late_s;
            self.offset_s += jump_s;
            self.jumps += 1;
            // The new window's observation includes the same offset.
            if let Some(now) = &mut self.window {
                now.late_s -= jump_s;
            }
            return;
        }
        self.late_s = window.late_s;
        let by_index_s = (window.index - anchor.first_index) as f64 / self.sample_rate_hz;
        let by_clock_s = (window.time_ns as f64 - anchor.first_ns as f64) / 1e9 - self.offset_s;
        if self.points.len() == MAX_POINTS {
            self.points.remove(0);
        }
        self.points.push((by_index_s, by_clock_s));
        if self.points.len() < MIN_POINTS {
            return;
        }
        self.drift = (1.0 / slope(&self.points) - 1.0).clamp(-MAX_DRIFT, MAX_DRIFT);
        let steering = (window.late_s / (WINDOW_S * 10.0)).clamp(-MAX_STEERING, MAX_STEERING);
        let time_ns = self.time_ns(index).unwrap_or(anchor.time_ns);
        self.anchor = Some(Anchor { index, time_ns, drift: self.drift - steering, ..anchor });
    }
}

/// Returns the slope of the least-squares line through points.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean = |value: fn(&(f64, f64)) -> f64| points.iter().map(value).sum::<f64>() / count;
    let (mean_x, mean_y) = (mean(|point| point.0), mean(|point| point.1));
    let products = |(over, under): (f64, f64), (x, y): &(f64, f64)| {
        (over + (x - mean_x) * (y - mean_y), under + (x - mean_x) * (x - mean_x))
    };
    let (over, under) = points.iter().fold((0.0, 0.0), products);
    if under > 0.0 { over / under } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const RATE_HZ: f64 = 1000.0;
    const BEGIN_NS: i64 = 1_760_000_000_000_000_000;

    /// Returns a clock after `seconds` of samples that arrive faster by `drift` and are seen up to 8 ms late,
    /// and the largest error in seconds. `ahead_s` gives the lead of the sender's clock at each second.
    fn run(seconds: u64, drift: f64, ahead_s: impl Fn(u64) -> f64) -> (StreamClock, f64) {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let (mut clock, mut worst) = (StreamClock::new(RATE_HZ), 0.0_f64);
        for k in 0..seconds * 10 {
            let index = k * 100;
            let true_s = index as f64 / (RATE_HZ * (1.0 + drift));
            let seen_s = true_s + random.random_range(0.0..0.008) + ahead_s(k / 10);
            clock.observe(index, BEGIN_NS + (seen_s * 1e9) as i64);
            let error_s = (clock.time_ns(index).unwrap() - BEGIN_NS) as f64 / 1e9 - true_s;
            worst = worst.max(error_s.abs());
        }
        (clock, worst)
    }

    #[test]
    fn a_drifting_rate_is_tracked_and_reported() {
        for drift in [-1e-4, 0.0, 1e-4] {
            let (clock, worst) = run(3600, drift, |_| 0.0);
            let said = clock.drift_ppm().unwrap();
            assert!((said - drift * 1e6).abs() < 5.0, "{said} ppm of {drift}");
            assert!(worst < 0.02, "{worst} s with {drift}");
            assert_eq!(clock.jumps(), 0);
        }
    }

    #[test]
    fn a_clock_jump_does_not_move_the_time() {
        for jump_s in [3600.0, -3600.0, 2.0] {
            for at in [150, 900] {
                let (clock, worst) = run(2 * at, 5e-5, |second| if second >= at { jump_s } else { 0.0 });
                assert!(worst < 0.02, "{worst} s with a jump of {jump_s} s");
                assert_eq!(clock.jumps(), 1);
                let drift_ppm = clock.drift_ppm().unwrap();
                assert!((drift_ppm - 50.0).abs() < 8.0, "{drift_ppm} ppm with a jump of {jump_s} s");
            }
        }
    }

    #[test]
    fn samples_delayed_for_a_minute_keep_their_time() {
        let late = |second: u64| if (600..660).contains(&second) { 30.0 } else { 0.0 };
        let (_, worst) = run(1800, 0.0, late);
        assert!(worst < 0.02, "{worst} s");
    }

    #[test]
    fn a_stored_clock_continues_unchanged() {
        let (clock, _) = run(200, 1e-4, |_| 0.0);
        let stored = serde_json::to_string(&clock).unwrap();
        assert_eq!(serde_json::from_str::<StreamClock>(&stored).unwrap(), clock);
        assert_eq!(StreamClock::new(RATE_HZ).time_ns(0), None);
    }
}
