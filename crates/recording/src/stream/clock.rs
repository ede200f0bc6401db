//! The time of a stream's samples: by their index, with the drift of the rate followed.

use serde::{Deserialize, Serialize};

/// Seconds of samples of which the earliest observation counts: what is late for a moment does no harm.
const WINDOW_S: f64 = 10.0;

/// Windows that the rate is measured over: ten minutes.
const MAX_POINTS: usize = 60;

/// Windows from which on the rate is known.
const MIN_POINTS: usize = 6;

/// Seconds by which a clock has jumped, or observations are late for long.
const JUMP_S: f64 = 0.5;

/// The greatest drift that is followed; crystals stay within 1e-4.
const MAX_DRIFT: f64 = 5e-4;

/// How fast a time that is off is brought back, in seconds a second.
const MAX_STEERING: f64 = 2e-4;

/// Gives each sample a time.
///
/// The first observation says when the stream began. From then on time goes with the index, at the sender's
/// rate corrected by the drift that later observations show. A clock that jumps moves nothing: from then on
/// it is read with that offset.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct StreamClock {
    sample_rate_hz: f64,
    anchor: Option<Anchor>,
    /// What the sender's clock is ahead of the stream's, in seconds: the sum of its jumps.
    offset_s: f64,
    jumps: u64,
    window: Option<Window>,
    /// What the last window without a jump was late.
    late_s: f64,
    /// Seconds since the beginning by the sender's rate, and by the clock.
    points: Vec<(f64, f64)>,
    drift: f64,
}

/// A sample whose time is fixed, and how fast time goes after it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Anchor {
    first_index: u64,
    first_ns: i64,
    index: u64,
    time_ns: i64,
    /// By how much the samples come faster than the sender's rate says.
    drift: f64,
}

/// The earliest observation of some seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Window {
    begin: u64,
    index: u64,
    time_ns: i64,
    late_s: f64,
}

impl StreamClock {
    /// Of a stream with this rate.
    pub fn new(sample_rate_hz: f64) -> Self {
        Self { sample_rate_hz, ..Self::default() }
    }

    /// A sample was there at a time of the sender's clock. Observations come in the order of samples.
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

    /// The time of a sample in nanoseconds since 1970; none before the first observation.
    pub fn time_ns(&self, index: u64) -> Option<i64> {
        let anchor = self.anchor?;
        let frames = index as f64 - anchor.index as f64;
        let seconds = frames / (self.sample_rate_hz * (1.0 + anchor.drift));
        Some(anchor.time_ns.saturating_add((seconds * 1e9).round() as i64))
    }

    /// By how much samples come faster than the sender's rate says, in parts per million; none while it is
    /// not known.
    pub fn drift_ppm(&self) -> Option<f64> {
        (self.points.len() >= MIN_POINTS).then_some(self.drift * 1e6)
    }

    /// How often the sender's clock jumped.
    pub fn jumps(&self) -> u64 {
        self.jumps
    }

    /// Goes on from `index` with what a window has shown.
    fn steer(&mut self, window: Window, index: u64) {
        let Some(anchor) = self.anchor else { return };
        if window.late_s.abs() > JUMP_S {
            // Without the jump the clock would have shown what it did before.
            let jump_s = window.late_s - self.late_s;
            self.offset_s += jump_s;
            self.jumps += 1;
            // What the new window has seen so far is read with that offset too.
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

/// The slope of the line through points, by least squares.
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

    /// A clock after so many seconds of samples that come `drift` faster and are seen up to 8 ms late;
    /// `ahead_s` is what the sender's clock is ahead at each second. Also the greatest error in seconds.
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
    fn a_rate_that_drifts_is_followed_and_said() {
        for drift in [-1e-4, 0.0, 1e-4] {
            let (clock, worst) = run(3600, drift, |_| 0.0);
            let said = clock.drift_ppm().unwrap();
            assert!((said - drift * 1e6).abs() < 5.0, "{said} ppm of {drift}");
            assert!(worst < 0.02, "{worst} s with {drift}");
            assert_eq!(clock.jumps(), 0);
        }
    }

    #[test]
    fn a_clock_that_jumps_moves_nothing() {
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
    fn samples_that_come_late_for_a_minute_keep_their_time() {
        let late = |second: u64| if (600..660).contains(&second) { 30.0 } else { 0.0 };
        let (_, worst) = run(1800, 0.0, late);
        assert!(worst < 0.02, "{worst} s");
    }

    #[test]
    fn a_stored_clock_goes_on_as_it_was() {
        let (clock, _) = run(200, 1e-4, |_| 0.0);
        let stored = serde_json::to_string(&clock).unwrap();
        assert_eq!(serde_json::from_str::<StreamClock>(&stored).unwrap(), clock);
        assert_eq!(StreamClock::new(RATE_HZ).time_ns(0), None);
    }
}
