//! The status of a stream.

use jiff::Timestamp;

use super::campaigns::CampaignStatus;
use super::live::LiveStream;
use super::stored::StoredStream;
use crate::recording::stream::StreamFormat;
use crate::service::error::ServiceError;

/// The status of a stream.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamStatus {
    /// Its name.
    pub name: String,
    /// The format of its samples.
    pub format: StreamFormat,
    /// Index after the last stored sample.
    pub next: Option<u64>,
    /// The time of this index.
    pub next_time: Option<Timestamp>,
    /// Deviation of the actual from the nominal sampling rate in parts per million; positive if samples
    /// arrive faster.
    pub drift_ppm: Option<f64>,
    /// Number of jumps of the sender's clock.
    pub clock_jumps: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Samples of each channel that are missing in the gaps.
    pub gap_samples: u64,
    /// Number of cuts stored as records; the records of all channels count as one.
    pub records: u64,
    /// Number of cuts whose records were refused.
    pub records_refused: u64,
    /// Why the records of the last refused cut were refused.
    pub last_refusal: Option<String>,
    /// Number of cuts that are not stored yet.
    pub records_waiting: u64,
    /// Bytes of the journal on the disk.
    pub journal_bytes: u64,
    /// The running measuring campaign, or else the last one.
    pub campaign: Option<CampaignStatus>,
}

impl StreamStatus {
    pub(super) fn of(stream: &LiveStream, stored: &StoredStream) -> Result<Self, ServiceError> {
        let state = stored.state();
        Ok(Self {
            name: stream.name.clone(),
            format: state.format.clone(),
            next: state.next,
            next_time: state.next.and_then(|next| state.time(next)),
            drift_ppm: state.clock.drift_ppm(),
            clock_jumps: state.clock.jumps(),
            gaps: state.gaps,
            gap_samples: state.gap_samples,
            records: state.records,
            records_refused: state.refused,
            last_refusal: state.last_refusal.clone(),
            records_waiting: state.pending.len() as u64,
            journal_bytes: stored.journal_bytes()?,
            campaign: CampaignStatus::of(state),
        })
    }
}
