//! What is answered of live streams.

use jiff::Timestamp;
use serde::Serialize;

use super::stream_campaigns::CampaignView;
use crate::service::StreamStatus;

/// How a stream stands.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct StreamView {
    /// Its name.
    name: String,
    /// How a sample is written.
    sample: &'static str,
    /// Sampling rate in hertz, as the sender says it.
    sample_rate_hz: f64,
    /// Number of channels.
    channels: usize,
    /// Unit of the samples, where the sender says it.
    unit: Option<String>,
    /// Index of the sample that is to come next: all before it are kept or known to be missing.
    pub(super) next: Option<u64>,
    /// The time of that sample.
    next_time: Option<Timestamp>,
    /// By how much samples come faster than `sample_rate_hz` says, in parts per million; none in the first
    /// minute.
    drift_ppm: Option<f64>,
    /// How often the sender's clock jumped by more than half a second, or samples were late for long.
    clock_jumps: u64,
    /// Gaps in it.
    pub(super) gaps: u64,
    /// Samples of each channel that are missing in them.
    gap_samples: u64,
    /// Records made of it, those of all channels counted as one.
    records: u64,
    /// Records that were refused; the log says why.
    records_refused: u64,
    /// Records that are cut and not stored yet.
    records_waiting: u64,
    /// Bytes of its samples on the disk, without those of records.
    journal_bytes: u64,
    /// The measuring campaign that runs, or else the last one.
    campaign: Option<CampaignView>,
}

/// What became of samples.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct StreamAnswer {
    /// Index of the sample that is to come next: all before it are kept or known to be missing.
    pub(super) next: Option<u64>,
    /// Gaps that were found.
    pub(super) gaps: Vec<GapView>,
}

/// Samples that never came.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
pub(super) struct GapView {
    /// Index of the first one.
    pub(super) first: u64,
    /// How many of each channel.
    pub(super) samples: u64,
}

/// The streams of an asset.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct StreamList {
    /// By their names.
    pub(super) items: Vec<StreamView>,
}

/// The levels of a stream, one entry a second.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct LevelView {
    /// Time of the first sample.
    pub(super) time: Timestamp,
    /// Index of the first sample.
    pub(super) first: u64,
    /// Samples of each channel that came: fewer than the rate says where there is a gap.
    pub(super) samples: u64,
    /// Root mean square of each channel in the stream's unit, with the mean in it; null where no sample is a
    /// number.
    pub(super) rms: Vec<Option<f64>>,
    /// Greatest magnitude of each channel in the stream's unit.
    pub(super) peak: Vec<Option<f64>>,
}

/// Levels of a stream.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct LevelList {
    /// The seconds in their order, the first 100 000.
    pub(super) items: Vec<LevelView>,
}

/// A record made of the last samples.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct KeptView {
    /// When it begins.
    pub(super) start_time: Timestamp,
    /// Samples of each channel.
    pub(super) samples: u64,
}

impl From<StreamStatus> for StreamView {
    fn from(status: StreamStatus) -> Self {
        let format = &status.format;
        Self {
            sample: format.sample().name(),
            sample_rate_hz: format.sample_rate_hz(),
            channels: format.channels(),
            unit: format.unit.clone(),
            name: status.name,
            next: status.next,
            next_time: status.next_time,
            drift_ppm: status.drift_ppm,
            clock_jumps: status.clock_jumps,
            gaps: status.gaps,
            gap_samples: status.gap_samples,
            records: status.records,
            records_refused: status.records_refused,
            records_waiting: status.records_waiting,
            journal_bytes: status.journal_bytes,
            campaign: status.campaign.map(CampaignView::from),
        }
    }
}
