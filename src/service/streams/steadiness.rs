//! Since when a machine has done the same.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::signal::OperatingPoint;

/// Operating bins that are remembered: more than an asset has, as they may be renamed.
const MAX_BINS: usize = 32;

/// Since when a machine has done the same, by what the sender said.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Steadiness {
    /// What it did in the beginning.
    began_with: OperatingPoint,
    /// The first sample of it.
    since: u64,
    /// Where the next record of an operating bin begins at the earliest; that of none has an empty name.
    next_of_bins: BTreeMap<String, u64>,
}

impl Steadiness {
    /// The machine does something else from this sample on.
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

    /// A record of a bin is cut; no other one begins before an index.
    pub(super) fn taken(&mut self, bin: String, next_from: u64) {
        self.next_of_bins.insert(bin, next_from);
        while self.next_of_bins.len() > MAX_BINS {
            let oldest = self.next_of_bins.iter().min_by_key(|(_, next)| **next);
            let Some(oldest) = oldest.map(|(bin, _)| bin.clone()) else { return };
            self.next_of_bins.remove(&oldest);
        }
    }
}
