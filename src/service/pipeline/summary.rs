//! The summary of a recording: how many of its records were stored, repeated or refused.

use std::collections::BTreeSet;

use jiff::Timestamp;
use serde::Serialize;

use crate::asset::SegmentId;
use crate::signal::Record;

/// Maximum number of refused records that are listed; further ones are only counted.
const MAX_REFUSED_LISTED: usize = 1000;

/// Maximum number of accepted records that are listed; further ones are only counted.
const MAX_TAKEN_LISTED: usize = 10_000;

/// A refused record of a recording.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Refused {
    /// Index of the record in the recording, from 0.
    pub record: u64,
    /// Its channel; null if it could not be read.
    pub channel: Option<String>,
    /// Why it was refused.
    pub reason: String,
}

/// The summary of a recording.
#[derive(Debug, Clone, Default, PartialEq, Serialize, utoipa::ToSchema)]
pub struct BatchSummary {
    /// Records read.
    pub records: u64,
    /// Of these, newly stored.
    pub stored: u64,
    /// Of these, queued for their analysis; absent if records are analysed before the response.
    #[serde(skip_serializing_if = "is_none")]
    pub queued: u64,
    /// Of these, stored before.
    pub repeated: u64,
    /// The refused records, at most the first 1000.
    pub refused: Vec<Refused>,
    /// Number of refused records.
    pub refused_count: u64,
    /// The channels of the accepted records.
    pub channels: BTreeSet<String>,
    /// Names in `recorded_channels` that no record of the recording has; absent if there is none.
    #[serde(skip_serializing_if = "BTreeSet::is_empty")]
    pub missing_channels: BTreeSet<String>,
    /// Start of the earliest accepted record.
    pub first_start_time: Option<Timestamp>,
    /// Start of the latest accepted record.
    pub last_start_time: Option<Timestamp>,
    /// The newly stored or queued records, at most the first 10 000.
    #[serde(skip)]
    pub segments: Vec<SegmentId>,
    /// Total length of the accepted records in seconds.
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
    /// Lists a newly stored or queued record.
    pub(crate) fn take(&mut self, segment: &SegmentId) {
        if self.segments.len() < MAX_TAKEN_LISTED {
            self.segments.push(segment.clone());
        }
    }

    /// Adds the summary of later records.
    pub(crate) fn join(&mut self, later: Self) {
        self.records += later.records;
        self.stored += later.stored;
        self.queued += later.queued;
        self.repeated += later.repeated;
        self.refused_count += later.refused_count;
        let capacity = MAX_REFUSED_LISTED.saturating_sub(self.refused.len());
        self.refused.extend(later.refused.into_iter().take(capacity));
        let capacity = MAX_TAKEN_LISTED.saturating_sub(self.segments.len());
        self.segments.extend(later.segments.into_iter().take(capacity));
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
