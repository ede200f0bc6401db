//! Counts of processed records since the start of the service.

use std::sync::atomic::{AtomicU64, Ordering};

/// Counts of records by outcome.
#[derive(Debug, Default)]
pub struct Tally {
    stored: AtomicU64,
    queued: AtomicU64,
    repeated: AtomicU64,
    refused: AtomicU64,
}

/// The outcome of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    Stored,
    Queued,
    Repeated,
    Refused,
}

impl Tally {
    /// Number of records stored.
    pub fn stored(&self) -> u64 {
        self.of(Outcome::Stored).load(Ordering::Relaxed)
    }

    /// Number of records queued for workers.
    pub fn queued(&self) -> u64 {
        self.of(Outcome::Queued).load(Ordering::Relaxed)
    }

    /// Number of records that were stored before.
    pub fn repeated(&self) -> u64 {
        self.of(Outcome::Repeated).load(Ordering::Relaxed)
    }

    /// Number of invalid records.
    pub fn refused(&self) -> u64 {
        self.of(Outcome::Refused).load(Ordering::Relaxed)
    }

    pub(crate) fn count(&self, outcome: Outcome, records: u64) {
        self.of(outcome).fetch_add(records, Ordering::Relaxed);
    }

    fn of(&self, outcome: Outcome) -> &AtomicU64 {
        match outcome {
            Outcome::Stored => &self.stored,
            Outcome::Queued => &self.queued,
            Outcome::Repeated => &self.repeated,
            Outcome::Refused => &self.refused,
        }
    }
}
