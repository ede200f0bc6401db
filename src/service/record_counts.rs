//! Counts of processed records since the start of the service.

use std::sync::atomic::{AtomicU64, Ordering};

/// Counts of records by outcome.
#[derive(Debug, Default)]
pub struct RecordCounts([AtomicU64; 4]);

/// The outcome of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordOutcome {
    /// It was stored.
    Stored,
    /// It was queued for workers.
    Queued,
    /// It was stored before.
    Repeated,
    /// It is invalid.
    Refused,
}

impl RecordCounts {
    /// Number of records with this outcome.
    pub fn of(&self, outcome: RecordOutcome) -> u64 {
        self.0[outcome as usize].load(Ordering::Relaxed)
    }

    pub(crate) fn count(&self, outcome: RecordOutcome, records: u64) {
        self.0[outcome as usize].fetch_add(records, Ordering::Relaxed);
    }
}
