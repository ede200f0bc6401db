//! The time between records in units of growth.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::growth::{Elapsed, Jumps};

/// Longest interval between two records, in intervals of the baseline: whether the machine ran during a
/// longer gap is not known.
const MAX_INTERVALS: f64 = 100.0;

/// Age of a machine, in intervals of its baseline, from which on a unit of growth is longer than an interval.
const CONSTANT_UNIT_AGE: f64 = 25.0;

/// Part of its age that a machine keeps at an inspection. In the units of its whole age, the depth after an
/// inspection would follow the wear too late.
const AFTER_INSPECTION: f64 = 0.7;

/// Least age that counts, in intervals of the baseline.
const MIN_AGE: f64 = 10.0;

/// A gap is an interval this many times as long as the mean interval between records.
const GAP: f64 = 5.0;

/// Weight of the newest interval in that mean.
const NEWEST_INTERVAL: f64 = 0.2;

/// Evidence of fast wear in the previous records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Signs {
    /// Several records in a row are best explained by greater depths than the interval holds.
    pub(super) deeper: bool,
    /// The mesh lines move now.
    pub(super) moving: bool,
}

/// The clock of one channel, which starts at the end of its baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct GrowthClock {
    /// Mean time between two records of the baseline, in seconds: the first unit of growth.
    interval_s: f64,
    /// Age of the machine in these intervals, since the baseline or since fast wear began. An inspection
    /// lowers it.
    age: f64,
    /// Time of the newest record.
    newest: Timestamp,
    /// Moving mean of the time between two records, in seconds.
    usual_s: f64,
    /// Whether no record has come since an inspection.
    inspected: bool,
}

impl GrowthClock {
    /// Starts the clock at the end of a baseline whose records have a mean distance of `interval_s` seconds.
    pub(super) fn start(ended: Timestamp, interval_s: f64) -> Self {
        Self { interval_s, age: 0.0, newest: ended, usual_s: interval_s, inspected: false }
    }

    /// Returns the intervals of the baseline from one time to another.
    pub(super) fn intervals(&self, from: Timestamp, to: Timestamp) -> f64 {
        if self.interval_s > 0.0 {
            (to.duration_since(from).as_secs_f64() / self.interval_s).clamp(0.0, MAX_INTERVALS)
        } else {
            1.0
        }
    }

    /// Returns what passes up to a record at this time, under a load relative to the described one.
    ///
    /// Where wear is deeper than expected and the lines move, the age restarts at zero.
    pub(super) fn advance(&mut self, at: Timestamp, load: f64, signs: Signs) -> Elapsed {
        let intervals = self.intervals(self.newest, at);
        let is_gap = self.add_interval(at);
        if signs.deeper && signs.moving {
            self.age = 0.0;
        }
        let unit = unit_length(self.age);
        self.age += intervals;
        self.newest = at.max(self.newest);
        self.inspected = false;
        Elapsed {
            units: intervals / unit * load,
            lengthening: unit_length(self.age) / unit,
            jumps: if signs.deeper {
                Jumps::Indicated
            } else if is_gap {
                Jumps::InGap
            } else {
                Jumps::Rare
            },
        }
    }

    /// Shortens the unit of growth at an inspection, once for all inspections between two records.
    pub(super) fn inspect(&mut self) {
        if !self.inspected {
            self.age *= AFTER_INSPECTION;
        }
        self.inspected = true;
    }

    /// Age in seconds, at least that of ten intervals.
    pub(super) fn age_s(&self) -> f64 {
        self.interval_s * self.age.max(MIN_AGE)
    }

    /// Adds the interval before a record at this time to the mean. Returns whether it is a gap.
    fn add_interval(&mut self, at: Timestamp) -> bool {
        let interval_s = at.duration_since(self.newest).as_secs_f64().max(0.0);
        let usual_s = if self.usual_s > 0.0 { self.usual_s } else { interval_s };
        // One gap, however long, does not make the next one usual.
        self.usual_s = usual_s + NEWEST_INTERVAL * (interval_s.min(GAP * usual_s) - usual_s);
        interval_s > GAP * usual_s
    }
}

/// Returns the mean time in seconds between the records of a baseline: the times of its first two records,
/// the end, and their number.
///
/// A first record long before all others does not count: its time is wrong, or the machine stood since.
pub(super) fn baseline_interval_s([first, second]: [Timestamp; 2], ended: Timestamp, records: usize) -> f64 {
    let mean_s = |began: Timestamp, records: usize| {
        let intervals = records.saturating_sub(1).max(1) as f64;
        ended.duration_since(began).as_secs_f64().max(0.0) / intervals
    };
    let later_s = mean_s(second, records.saturating_sub(1));
    let is_stray = second.duration_since(first).as_secs_f64() > MAX_INTERVALS * later_s;
    if is_stray && later_s > 0.0 { later_s } else { mean_s(first, records) }
}

/// Returns the length of a unit of growth in intervals of the baseline, for a machine that has run for `age`
/// such intervals since its baseline. What a machine has not done for long, it is expected to do slowly: a
/// unit is at least a 25th of its age.
fn unit_length(age: f64) -> f64 {
    (age / CONSTANT_UNIT_AGE).max(1.0)
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;

    const EXPECTED: Signs = Signs { deeper: false, moving: false };

    fn at(hours: i64) -> Timestamp {
        Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hours)
    }

    /// A clock after hourly records for 1000 hours.
    fn old() -> GrowthClock {
        let mut clock = GrowthClock::start(at(0), 3600.0);
        for hour in 1..=1000 {
            clock.advance(at(hour), 1.0, EXPECTED);
        }
        clock
    }

    #[test]
    fn a_first_record_long_before_the_others_does_not_stretch_the_interval() {
        let interval_s = |first| baseline_interval_s([at(first), at(1)], at(19), 20);
        assert_eq!(interval_s(0), 3600.0);
        assert_eq!(interval_s(-57), 4.0 * 3600.0);
        assert_eq!(interval_s(-100_000), 3600.0);
        // Records whose times are all the same but one.
        assert_eq!(baseline_interval_s([at(0), at(19)], at(19), 20), 3600.0);
    }

    #[test]
    fn a_unit_lengthens_with_the_age() {
        assert_eq!([0.0, 25.0, 50.0, 2500.0].map(unit_length), [1.0, 1.0, 2.0, 100.0]);
        let mut clock = old();
        assert_eq!(unit_length(clock.age), 40.0);
        let elapsed = clock.advance(at(1020), 1.5, EXPECTED);
        assert!((elapsed.units - 0.75).abs() < 1e-12 && (elapsed.lengthening - 1.02).abs() < 1e-12);
    }

    #[test]
    fn a_machine_is_young_again_if_wear_is_deeper_than_expected_and_the_lines_move() {
        let length_after = |deeper, moving| {
            let mut clock = old();
            clock.advance(at(1001), 1.0, Signs { deeper, moving });
            unit_length(clock.age)
        };
        assert_eq!(length_after(true, true), 1.0);
        assert!(length_after(true, false) > 40.0 && length_after(false, true) > 40.0);
    }

    #[test]
    fn an_inspection_shortens_the_unit() {
        let mut clock = old();
        // Both gears are measured at one stop.
        clock.inspect();
        clock.inspect();
        assert!((unit_length(clock.age) - 28.0).abs() < 1e-9);
        clock.advance(at(1001), 1.0, EXPECTED);
        clock.inspect();
        assert!(unit_length(clock.age) < 20.0);
    }

    #[test]
    fn wear_may_jump_in_a_gap_and_where_records_show_it() {
        let jumps = |hour, signs| old().advance(at(hour), 1.0, signs).jumps;
        assert_eq!(jumps(1005, EXPECTED), Jumps::Rare);
        assert_eq!(jumps(1006, EXPECTED), Jumps::InGap);
        assert_eq!(jumps(1006, Signs { deeper: true, moving: false }), Jumps::Indicated);
    }

    #[test]
    fn a_gap_counts_at_most_a_hundred_intervals() {
        let mut clock = GrowthClock::start(at(0), 3600.0);
        assert_eq!(clock.advance(at(5000), 1.0, EXPECTED).units, 100.0);
        // Records whose times are all the same are one interval apart.
        assert_eq!(GrowthClock::start(at(0), 0.0).advance(at(0), 1.0, EXPECTED).units, 1.0);
    }
}
