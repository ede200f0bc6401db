//! A time of which every sample becomes a record: around an alarm, or a measuring campaign.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::recording::stream::{StreamCut, StreamCutter};

/// Samples that all become records, back to back. Nothing else is cut meanwhile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Capture {
    /// The first sample that is in no record of it yet.
    pub(super) from: u64,
    /// Index after the last one.
    pub(super) until: u64,
    /// Length of its records; the last one may be shorter.
    pub(super) record_frames: u64,
    pub(super) is_campaign: bool,
}

/// A measuring campaign: that which runs, or else the last one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Campaign {
    /// Index of its first sample, and the time of it.
    pub(crate) first: u64,
    pub(crate) start_time: Timestamp,
    /// Index after its last sample.
    pub(crate) until: u64,
    /// The time of that, once it is over.
    pub(crate) end_time: Option<Timestamp>,
    /// Records that were cut for it, those of all channels counted as one.
    pub(crate) records: u64,
}

impl Capture {
    /// The next record that is whole.
    pub(super) fn next_cut(&self, cutter: &StreamCutter) -> Option<StreamCut> {
        let end = (self.from + self.record_frames).min(self.until);
        (end <= cutter.end()).then(|| self.cut(end)).flatten()
    }

    /// What is left of what has come.
    pub(super) fn rest(&self, cutter: &StreamCutter) -> Option<StreamCut> {
        self.cut(cutter.end().min(self.until))
    }

    fn cut(&self, end: u64) -> Option<StreamCut> {
        let frames = end.checked_sub(self.from).filter(|frames| *frames > 0)?;
        Some(StreamCut { first: self.from, frames, next_from: end })
    }
}
