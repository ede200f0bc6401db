//! Tachometer pulses that the sender of a stream gives between its samples.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::recording::stream::StreamCut;
use crate::service::error::ServiceError;
use crate::signal::Tachometer;

/// Maximum number of pulses kept for a stream; the oldest are dropped first.
pub(crate) const MAX_PULSES: usize = 65_536;

/// Seconds before a record from which its pulses are included, so that there is a pulse before its first
/// turn.
const LEAD_S: f64 = 1.0;

/// Millionths of a sample within which two pulses are the same: offsets after different indices are rounded
/// differently.
const SAME: u64 = 1000;

/// The position of a pulse: an index, and millionths of a sample after it. Integers are read back exactly
/// from the journal, so that a retried record has the same bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(super) struct Pulse(u64, u32);

impl Pulse {
    fn is_same(self, other: Self) -> bool {
        let index = self.0.min(other.0);
        let millionths = |pulse: Self| 1_000_000 * (pulse.0 - index) + u64::from(pulse.1);
        self.0.abs_diff(other.0) <= 1 && millionths(self).abs_diff(millionths(other)) <= SAME
    }
}

/// Pulses in the order of time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Pulses {
    pulses_per_revolution: u32,
    pulses: Vec<Pulse>,
}

impl Pulses {
    /// Creates pulses at the offsets `after`, in samples, after the index `from`.
    ///
    /// # Errors
    /// [`ServiceError::Field`] for 0 pulses per revolution, too many pulses, offsets out of range, or offsets
    /// that do not increase.
    pub(crate) fn new(from: u64, after: &[f64], pulses_per_revolution: u32) -> Result<Self, ServiceError> {
        let refuse = |field, value: String, expected: &str| {
            Err(ServiceError::Field { field, value, expected: expected.to_owned().into() })
        };
        if pulses_per_revolution == 0 {
            return refuse("pulses_per_revolution", "0".to_owned(), "at least 1");
        }
        if after.len() > MAX_PULSES {
            let expected = format!("at most {MAX_PULSES} in a message");
            return refuse("pulses", format!("{} pulses", after.len()), &expected);
        }
        let is_place = |after: f64| (0.0..1e12).contains(&after);
        if let Some(wrong) = after.iter().find(|after| !is_place(**after)) {
            return refuse("pulses", wrong.to_string(), "offsets from 0 to 1e12 in samples after `from`");
        }
        if from > 1 << 53 {
            return refuse("from", from.to_string(), "an index below 2^53");
        }
        let pulse = |after: &f64| Pulse(from + after.floor() as u64, (after.fract() * 1e6) as u32);
        let pulses: Vec<Pulse> = after.iter().map(pulse).collect();
        if let Some(pair) = pulses.windows(2).position(|pair| pair[0] >= pair[1]) {
            let pair = format!("{} and then {}", after[pair], after[pair + 1]);
            return refuse("pulses", pair, "increasing offsets");
        }
        Ok(Self { pulses_per_revolution, pulses })
    }

    /// Drops pulses among samples already received: these may be in a record.
    pub(super) fn beginning_at(mut self, next: u64) -> Self {
        self.pulses.retain(|pulse| pulse.0 >= next);
        self
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pulses.is_empty()
    }
}

/// The pulses of a stream that records may still need.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct StreamTachometer {
    pulses_per_revolution: u32,
    pulses: VecDeque<Pulse>,
}

impl StreamTachometer {
    /// Adds those pulses that are not known yet, in the order of time.
    pub(super) fn extend(&mut self, more: Pulses) {
        if more.pulses_per_revolution != self.pulses_per_revolution {
            self.pulses_per_revolution = more.pulses_per_revolution;
            self.pulses.clear();
        }
        for pulse in more.pulses {
            let index = self.pulses.partition_point(|known| *known < pulse);
            let mut neighbours = self.pulses.range(index.saturating_sub(1)..self.pulses.len().min(index + 1));
            if !neighbours.any(|known| known.is_same(pulse)) {
                self.pulses.insert(index, pulse);
            }
        }
        let too_many = self.pulses.len().saturating_sub(MAX_PULSES);
        self.pulses.drain(..too_many);
    }

    /// Drops pulses that no record from an index on needs.
    pub(super) fn forget_before(&mut self, index: u64, rate_hz: f64) {
        let kept_from = index.saturating_sub(lead(rate_hz));
        let old = self.pulses.partition_point(|pulse| pulse.0 < kept_from);
        self.pulses.drain(..old);
    }

    /// The pulses of a record and of the second before it; `None` without any.
    pub(super) fn of(&self, cut: StreamCut, rate_hz: f64) -> Option<Tachometer> {
        let from = cut.first.saturating_sub(lead(rate_hz));
        let seconds = |pulse: &Pulse| {
            // Exact: differences within a record are far below 2^53.
            let after = pulse.0 as i64 - cut.first as i64;
            (after as f64 + 1e-6 * f64::from(pulse.1)) / rate_hz
        };
        let inside = self.pulses.iter().filter(|pulse| (from..cut.end()).contains(&pulse.0));
        let pulse_times_s: Vec<f64> = inside.map(seconds).collect();
        let pulses_per_revolution = self.pulses_per_revolution;
        (!pulse_times_s.is_empty()).then_some(Tachometer { pulse_times_s, pulses_per_revolution })
    }
}

/// Frames before a record from which its pulses are included.
pub(super) fn lead(rate_hz: f64) -> u64 {
    (LEAD_S * rate_hz) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_has_its_pulses_and_those_of_the_second_before() {
        let mut tachometer = StreamTachometer::default();
        tachometer.extend(Pulses::new(1000, &[0.0, 100.25, 200.5, 300.0], 2).unwrap());
        // Repeated pulses and new ones.
        tachometer.extend(Pulses::new(1200, &[0.5, 100.0, 200.0], 2).unwrap().beginning_at(1300));
        let cut = StreamCut { first: 1150, frames: 200, next_from: 0 };
        let found = tachometer.of(cut, 100.0).unwrap();
        assert_eq!(
            (found.pulse_times_s.as_slice(), found.pulses_per_revolution),
            (&[-0.4975, 0.505, 1.5][..], 2)
        );
        tachometer.forget_before(1300, 100.0);
        assert_eq!(tachometer.of(cut, 100.0).unwrap().pulse_times_s, [0.505, 1.5]);
        assert_eq!(tachometer.of(StreamCut { first: 5000, frames: 10, next_from: 0 }, 100.0), None);
    }

    #[test]
    fn pulses_come_in_any_order_and_count_once() {
        let mut tachometer = StreamTachometer::default();
        // Those of later samples, of earlier ones, and of both again.
        for (from, after) in [(200, &[7.3, 50.9999][..]), (100, &[0.5, 99.0]), (107, &[92.0, 100.3, 144.0])] {
            tachometer.extend(Pulses::new(from, after, 1).unwrap());
        }
        let cut = StreamCut { first: 100, frames: 200, next_from: 0 };
        let found = tachometer.of(cut, 100.0).unwrap().pulse_times_s;
        assert_eq!(found.len(), 4, "{found:?}");
        for (found, expected) in found.iter().zip([0.005, 0.99, 1.073, 1.509_999]) {
            assert!((found - expected).abs() < 1e-6, "{found}, {expected}");
        }
    }

    #[test]
    fn errors_about_pulses_name_their_field() {
        for (from, after, of_revolution, words) in [
            (0, &[1.0][..], 0, "pulses_per_revolution"),
            (0, &[2.0, 2.0], 1, "2 and then 2"),
            (0, &[-1.0], 1, "-1"),
            (0, &[f64::NAN], 1, "NaN"),
            (u64::MAX, &[1.0], 1, "from"),
        ] {
            let error = Pulses::new(from, after, of_revolution).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
