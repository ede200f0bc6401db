//! Captures: periods of which every sample becomes part of a record, around an alarm or for a measuring
//! campaign.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::recording::stream::{StreamCut, StreamCutter};

/// A range of samples that become back-to-back records. Nothing else is cut meanwhile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Capture {
    /// The first sample that is not in a record of it yet.
    pub(super) from: u64,
    /// Index after the last one.
    pub(super) until: u64,
    /// Length of its records in frames; the last one may be shorter.
    pub(super) record_frames: u64,
    pub(super) is_campaign: bool,
    /// Index after the last sample for an alarm; a campaign that begins meanwhile ends no earlier.
    #[serde(default)]
    pub(super) alarm_until: u64,
}

/// A measuring campaign: the running one, or else the last one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Campaign {
    /// Index and time of its first sample.
    pub(crate) first: u64,
    pub(crate) start_time: Timestamp,
    /// Index after its last sample.
    pub(crate) until: u64,
    /// The time of that sample, once the campaign is over.
    pub(crate) end_time: Option<Timestamp>,
    /// Number of cuts; the records of all channels count as one.
    pub(crate) records: u64,
}

impl Capture {
    /// The next complete record.
    pub(super) fn next_cut(&self, cutter: &StreamCutter) -> Option<StreamCut> {
        let end = (self.from + self.record_frames).min(self.until);
        (end <= cutter.end()).then(|| self.cut(end)).flatten()
    }

    /// A record of the remaining samples received so far.
    pub(super) fn rest(&self, cutter: &StreamCutter) -> Option<StreamCut> {
        self.cut(cutter.end().min(self.until))
    }

    fn cut(&self, end: u64) -> Option<StreamCut> {
        let frames = end.checked_sub(self.from).filter(|frames| *frames > 0)?;
        Some(StreamCut { first: self.from, frames, next_from: end })
    }
}
