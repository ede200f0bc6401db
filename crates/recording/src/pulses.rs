//! Tachometer pulses, from messages to records.

use std::collections::{HashMap, VecDeque};

use jiff::Timestamp;

pub(crate) use super::message::Tachometer as Pulses;
use flankwatch_signal::{Record, Tachometer};

/// Names of the driving shaft.
const DRIVING: [&str; 2] = ["", "driving"];

/// Name of the driven shaft.
pub(super) const DRIVEN: &str = "driven";

/// Largest number of pulses in a message, and stored per shaft: 11 minutes at 100 Hz with 60 pulses per turn.
pub(super) const MAX_PULSES: usize = 1 << 22;

/// Largest number of pulses stored over all assets of a recording: 64 MiB, shared equally.
const MAX_TOTAL_PULSES: usize = 2 * MAX_PULSES;

impl Pulses {
    /// Converts to the pulses of a record that starts at `start`; `None` if they belong to another shaft.
    pub(crate) fn of(self, start: Timestamp) -> Option<Tachometer> {
        let start_ns = nanoseconds(start);
        DRIVING.contains(&self.shaft.as_str()).then(|| Tachometer {
            // By value: the seconds reuse the memory of the nanoseconds, as there may be millions.
            pulse_times_s: self
                .pulse_time_ns
                .into_iter()
                .map(|time| (i128::from(time) - i128::from(start_ns)) as f64 / 1e9)
                .collect(),
            pulses_per_revolution: self.pulses_per_revolution,
        })
    }

    /// Returns the pulses of a record.
    pub(crate) fn of_record(record: &Record) -> Option<Self> {
        let tachometer = record.tachometer()?;
        let start_ns = nanoseconds(record.start_time());
        let time_ns = tachometer.pulse_times_s.iter();
        Some(Self {
            // A pulse whose time is out of range is clamped to the end of the range.
            pulse_time_ns: time_ns.map(|time| start_ns.saturating_add((time * 1e9).round() as i64)).collect(),
            pulses_per_revolution: tachometer.pulses_per_revolution,
            shaft: String::new(),
        })
    }
}

/// The pulses of one asset's driving shaft in a recording, in time order.
#[derive(Debug, Default)]
pub(crate) struct PulseTrain {
    time_ns: VecDeque<i64>,
    per_revolution: u32,
}

impl PulseTrain {
    /// Adds one message of this shaft and keeps the latest `max` pulses. Pulses not after the latest one are
    /// skipped; a different number of pulses per turn restarts the train.
    fn take(&mut self, pulses: &Pulses, max: usize) {
        if pulses.pulses_per_revolution != self.per_revolution {
            self.time_ns.clear();
            self.per_revolution = pulses.pulses_per_revolution;
        }
        for &time in &pulses.pulse_time_ns {
            if self.time_ns.back().is_none_or(|last| *last < time) {
                if self.time_ns.len() >= max {
                    self.time_ns.pop_front();
                }
                self.time_ns.push_back(time);
            }
        }
    }

    fn truncate_to_latest(&mut self, max: usize) {
        let surplus = self.time_ns.len().saturating_sub(max);
        if surplus > 0 {
            self.time_ns.drain(..surplus);
            self.time_ns.shrink_to_fit();
        }
    }

    /// Returns whether there are pulses after this time.
    pub(crate) fn reaches_past(&self, time_ns: i64) -> bool {
        self.time_ns.back().is_some_and(|last| *last > time_ns)
    }

    /// Returns the pulses from the last one before a record to the first one after it; `None` if there are
    /// fewer than two.
    pub(crate) fn during(&self, record: &Record) -> Option<Pulses> {
        let start_ns = nanoseconds(record.start_time());
        let end_ns = end_ns(record);
        let first = self.time_ns.partition_point(|time| *time <= start_ns).saturating_sub(1);
        let past = (self.time_ns.partition_point(|time| *time < end_ns) + 1).min(self.time_ns.len());
        (past >= first + 2).then(|| Pulses {
            pulse_time_ns: self.time_ns.range(first..past).copied().collect(),
            pulses_per_revolution: self.per_revolution,
            shaft: String::new(),
        })
    }
}

/// The pulse trains of a recording's assets.
#[derive(Debug, Default)]
pub(crate) struct PulseTrains {
    by_asset: HashMap<String, PulseTrain>,
}

impl PulseTrains {
    /// Adds one message; ignores other shafts.
    pub(crate) fn take(&mut self, asset: &str, pulses: &Pulses) {
        if !DRIVING.contains(&pulses.shaft.as_str()) {
            return;
        }
        let is_new = !self.by_asset.contains_key(asset);
        let share = MAX_TOTAL_PULSES / (self.by_asset.len() + usize::from(is_new));
        let max = share.min(MAX_PULSES);
        if is_new {
            for train in self.by_asset.values_mut() {
                train.truncate_to_latest(max);
            }
        }
        self.by_asset.entry(asset.to_owned()).or_default().take(pulses, max);
    }

    /// Returns the pulse train of an asset.
    pub(crate) fn of(&self, asset: &str) -> Option<&PulseTrain> {
        self.by_asset.get(asset)
    }
}

/// Returns the end time of a record: one sampling interval after its last sample.
pub(crate) fn end_ns(record: &Record) -> i64 {
    nanoseconds(record.start_time()).saturating_add((record.duration_s() * 1e9) as i64)
}

/// Returns nanoseconds since 1970, clamped to the 64-bit range.
pub(crate) fn nanoseconds(time: Timestamp) -> i64 {
    let nanoseconds = time.as_nanosecond();
    i64::try_from(nanoseconds).unwrap_or(if nanoseconds < 0 { i64::MIN } else { i64::MAX })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn second(start_s: i64) -> Record {
        Record::new("1", Timestamp::from_second(start_s).unwrap(), 100.0, "g", vec![0.5; 100]).unwrap()
    }

    fn pulses(pulse_time_ns: Vec<i64>) -> Pulses {
        Pulses { pulse_time_ns, pulses_per_revolution: 1, shaft: "driving".to_owned() }
    }

    #[test]
    fn a_record_gets_the_pulses_around_it() {
        let mut train = PulseTrain::default();
        train.take(&pulses((0..40).map(|k| k * 100_000_000 + 50_000_000).collect()), 100);
        let got = train.during(&second(2)).unwrap();
        let times = &got.pulse_time_ns;
        assert_eq!((times.len(), times[0], times[11]), (12, 1_950_000_000, 3_050_000_000));
        let times = got.of(Timestamp::from_second(2).unwrap()).unwrap().pulse_times_s;
        assert!((times[0] + 0.05).abs() < 1e-12 && (times[11] - 1.05).abs() < 1e-12);
        assert!(train.reaches_past(3_900_000_000) && !train.reaches_past(4_000_000_000));
        assert_eq!(train.during(&second(10)), None);
        train.take(&pulses(vec![1, 5_000_000_000]), 100);
        assert_eq!(train.time_ns.back(), Some(&5_000_000_000));
        assert!(!train.time_ns.contains(&1));
    }

    #[test]
    fn pulses_of_another_shaft_are_ignored() {
        let mut other = pulses(vec![1, 2, 3]);
        other.shaft = "driven".to_owned();
        let mut trains = PulseTrains::default();
        trains.take("pump", &other);
        assert!(trains.of("pump").is_none());
        assert_eq!(other.of(Timestamp::UNIX_EPOCH), None);
    }

    #[test]
    fn the_assets_of_a_recording_share_the_pulse_limit() {
        let max = i64::try_from(MAX_PULSES).unwrap();
        let mut trains = PulseTrains::default();
        let kept = |trains: &PulseTrains| -> Vec<usize> {
            let held = ["a", "b", "c"].iter().filter_map(|asset| trains.of(asset));
            held.map(|train| train.time_ns.len()).collect()
        };
        trains.take("a", &pulses((0..max).collect()));
        trains.take("a", &pulses((max..max + 10).collect()));
        assert_eq!(trains.of("a").unwrap().time_ns.front(), Some(&10));
        trains.take("b", &pulses((0..max).collect()));
        assert_eq!(kept(&trains), [MAX_PULSES, MAX_PULSES]);
        trains.take("c", &pulses((0..max).collect()));
        assert_eq!(kept(&trains), [MAX_TOTAL_PULSES / 3; 3]);
        assert!(trains.by_asset.values().all(|train| train.time_ns.capacity() <= MAX_PULSES));
        assert_eq!(trains.of("a").unwrap().time_ns.back(), Some(&(max + 9)));
    }

    #[test]
    fn converting_pulses_to_seconds_takes_no_memory() {
        let many = pulses((0..100_000).collect());
        let counted = allocation_counter::measure(|| {
            let times = many.of(Timestamp::UNIX_EPOCH).unwrap().pulse_times_s;
            assert_eq!((times.len(), times[7]), (100_000, 7e-9));
        });
        assert_eq!(counted.count_total, 0);
    }
}
