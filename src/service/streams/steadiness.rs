//! How long the operating point of a machine has been steady.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::signal::OperatingPoint;

/// Maximum number of operating bins that are remembered: more than an asset can have, because bins may be
/// renamed.
const MAX_BINS: usize = 32;

/// Since when the operating point given by the sender has been steady.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Steadiness {
    /// The operating point at the start of the steady period.
    began_with: OperatingPoint,
    /// The first sample of the steady period.
    since: u64,
    /// The earliest first sample of the next record in each operating bin; the empty name stands for no bin.
    next_of_bins: BTreeMap<String, u64>,
}

impl Steadiness {
    /// Starts a new steady period at a sample.
    pub(super) fn begin(&mut self, point: OperatingPoint, index: u64) {
        (self.began_with, self.since) = (point, index);
    }

    pub(super) fn began_with(&self) -> &OperatingPoint {
        &self.began_with
    }

    pub(super) fn since(&self) -> u64 {
        self.since
    }

    pub(super) fn next_of(&self, bin: &str) -> u64 {
        self.next_of_bins.get(bin).copied().unwrap_or(0)
    }

    /// Records that a record of a bin is cut; the next one starts no earlier than an index.
    pub(super) fn add_cut(&mut self, bin: String, next_from: u64) {
        self.next_of_bins.insert(bin, next_from);
        while self.next_of_bins.len() > MAX_BINS {
            let oldest = self.next_of_bins.iter().min_by_key(|(_, next)| **next);
            let Some(oldest) = oldest.map(|(bin, _)| bin.clone()) else { return };
            self.next_of_bins.remove(&oldest);
        }
    }
}
