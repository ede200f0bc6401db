//! What became of the records of a recording.

use std::collections::BTreeSet;

use jiff::Timestamp;
use serde::Serialize;

use crate::asset::SegmentId;
use crate::signal::Record;

/// Refused records that are listed by name; further ones are only counted.
const MAX_REFUSED_LISTED: usize = 1000;

/// Taken records that are listed by name; further ones are only counted.
const MAX_TAKEN_LISTED: usize = 10_000;

/// A record of a recording that was not taken.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Refused {
    /// Which record of the recording, counted from 0.
    pub record: u64,
    /// Its channel, where it could be read so far.
    pub channel: Option<String>,
    /// Why not.
    pub reason: String,
}

/// What became of a recording.
#[derive(Debug, Clone, Default, PartialEq, Serialize, utoipa::ToSchema)]
pub struct BatchSummary {
    /// Records read.
    pub records: u64,
    /// Of these, stored now.
    pub stored: u64,
    /// Of these, in the queue to be analysed; absent where they are analysed before the answer.
    #[serde(skip_serializing_if = "is_none")]
    pub queued: u64,
    /// Of these, stored before.
    pub repeated: u64,
    /// Those that were not taken.
    pub refused: Vec<Refused>,
    /// How many were not taken.
    pub refused_count: u64,
    /// The channels of those that were taken.
    pub channels: BTreeSet<String>,
    /// Start of the earliest record taken.
    pub first_start_time: Option<Timestamp>,
    /// Start of the latest record taken.
    pub last_start_time: Option<Timestamp>,
    /// Those that were taken now, the first 10 000.
    #[serde(skip)]
    pub segments: Vec<SegmentId>,
    /// Length of all records taken, in seconds.
    #[serde(skip)]
    pub record_seconds: f64,
}

fn is_none(queued: &u64) -> bool {
    *queued == 0
}

impl BatchSummary {
    pub(crate) fn refuse(&mut self, record: u64, channel: Option<&str>, reason: &impl ToString) {
        self.refused_count += 1;
        if self.refused.len() < MAX_REFUSED_LISTED {
            self.refused.push(Refused {
                record,
                channel: channel.map(str::to_string),
                reason: reason.to_string(),
            });
        }
    }
}

impl BatchSummary {
    /// Lists a record that was taken now.
    pub(crate) fn take(&mut self, segment: &SegmentId) {
        if self.segments.len() < MAX_TAKEN_LISTED {
            self.segments.push(segment.clone());
        }
    }

    /// Adds what became of later records.
    pub(crate) fn join(&mut self, later: Self) {
        self.records += later.records;
        self.stored += later.stored;
        self.queued += later.queued;
        self.repeated += later.repeated;
        self.refused_count += later.refused_count;
        let room = MAX_REFUSED_LISTED.saturating_sub(self.refused.len());
        self.refused.extend(later.refused.into_iter().take(room));
        let room = MAX_TAKEN_LISTED.saturating_sub(self.segments.len());
        self.segments.extend(later.segments.into_iter().take(room));
        self.channels.extend(later.channels);
        self.first_start_time = self.first_start_time.into_iter().chain(later.first_start_time).min();
        self.last_start_time = self.last_start_time.max(later.last_start_time);
        self.record_seconds += later.record_seconds;
    }

    pub(crate) fn add(&mut self, record: &Record) {
        if !self.channels.contains(record.channel()) {
            self.channels.insert(record.channel().to_string());
        }
        let start = record.start_time();
        self.first_start_time = Some(self.first_start_time.map_or(start, |first| first.min(start)));
        self.last_start_time = Some(self.last_start_time.map_or(start, |last| last.max(start)));
        self.record_seconds += record.duration_s();
    }
}
