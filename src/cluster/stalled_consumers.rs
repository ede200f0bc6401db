//! Detection of consumers that deliver nothing though records are in the queue.
//!
//! After a crash, NATS 2.9 can restore a consumer with messages that are acknowledged and gone. It tries to
//! deliver these over and over, and the records behind them wait for ever. A consumer that is created again
//! delivers what is in the stream.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use async_nats::jetstream::consumer::Info;

use super::partition::{PARTITIONS, Source};

/// Numbers of records that a worker has of each partition, waiting for their turn or in work.
#[derive(Debug)]
pub(super) struct InHand([AtomicU32; PARTITIONS as usize]);

impl Default for InHand {
    fn default() -> Self {
        Self(std::array::from_fn(|_| AtomicU32::default()))
    }
}

/// A record that a worker has, until it is dropped.
#[derive(Debug)]
pub(super) struct RecordInHand {
    counts: Arc<InHand>,
    source: Source,
}

impl InHand {
    fn of(&self, source: Source) -> Option<&AtomicU32> {
        match source {
            Source::Partition(number) => self.0.get(usize::from(number)),
            Source::Unpartitioned => None,
        }
    }

    /// Counts a record of a source.
    pub(super) fn add(self: &Arc<Self>, source: Source) -> RecordInHand {
        self.of(source).inspect(|count| _ = count.fetch_add(1, Ordering::Relaxed));
        RecordInHand { counts: Arc::clone(self), source }
    }

    fn has(&self, partition: u16) -> bool {
        self.of(Source::Partition(partition)).is_some_and(|count| count.load(Ordering::Relaxed) > 0)
    }
}

impl Drop for RecordInHand {
    fn drop(&mut self) {
        self.counts.of(self.source).inspect(|count| _ = count.fetch_sub(1, Ordering::Relaxed));
    }
}

/// What a consumer has to deliver and has delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Deliveries {
    /// Records that are not acknowledged.
    pub(super) records: u64,
    /// Deliveries so far.
    pub(super) delivered: u64,
}

impl From<&Info> for Deliveries {
    fn from(info: &Info) -> Self {
        let records = info.num_pending + info.num_ack_pending as u64;
        Self { records, delivered: info.delivered.consumer_sequence }
    }
}

/// The consumers that may be stalled: since when, and how much they had delivered by then.
#[derive(Debug, Default)]
pub(super) struct Suspects(HashMap<u16, (Instant, u64)>);

impl Suspects {
    /// Returns the partitions of a worker whose consumers have records for longer than `patience`, but deliver
    /// none, while the worker has none of them.
    pub(super) fn stalled(
        &mut self,
        owned: &BTreeSet<u16>,
        consumers: impl Fn(u16) -> Option<Deliveries>,
        in_hand: &InHand,
        now: Instant,
        patience: Duration,
    ) -> Vec<u16> {
        let mut suspects = HashMap::new();
        let mut stalled = Vec::new();
        for partition in owned.iter().copied().filter(|partition| !in_hand.has(*partition)) {
            let Some(Deliveries { records: 1.., delivered }) = consumers(partition) else { continue };
            let known = self.0.get(&partition).copied().filter(|(_, earlier)| *earlier == delivered);
            let (since, _) = known.unwrap_or((now, delivered));
            if now.duration_since(since) > patience {
                stalled.push(partition);
            } else {
                suspects.insert(partition, (since, delivered));
            }
        }
        self.0 = suspects;
        stalled
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_consumer_is_stalled_if_it_delivers_nothing_for_a_time() {
        let owned = BTreeSet::from([1, 2, 3, 4]);
        let (in_hand, mut suspects, begin) = (Arc::<InHand>::default(), Suspects::default(), Instant::now());
        let record = in_hand.add(Source::Partition(4));
        let mut at = |second: u64| {
            let consumers = |partition| {
                Some(match partition {
                    // Delivers nothing; has nothing; delivers; is processed.
                    1 => Deliveries { records: 1, delivered: 7 },
                    2 => Deliveries { records: 0, delivered: 7 },
                    3 => Deliveries { records: 9, delivered: second },
                    4 => Deliveries { records: 1, delivered: 7 },
                    _ => return None,
                })
            };
            let now = begin + Duration::from_secs(second);
            suspects.stalled(&owned, consumers, &in_hand, now, Duration::from_secs(30))
        };
        assert_eq!([0, 10, 20, 30].map(&mut at), [const { Vec::<u16>::new() }; 4]);
        assert_eq!(at(40), [1]);
        // Its successor has as much time.
        assert!(at(50).is_empty());
        drop(record);
        assert!(at(60).is_empty());
        assert_eq!(at(95), [1, 4]);
    }
}
