//! Views of live streams.

use jiff::Timestamp;
use serde::Serialize;

use crate::service::{CampaignStatus, StreamGap, StreamStatus};

/// The result of sending samples in a body.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct StreamAnswer {
    /// Index of the next expected sample: all earlier ones are stored or known to be missing.
    pub(crate) next: Option<u64>,
    /// Gaps that were detected.
    pub(crate) gaps: Vec<StreamGap>,
    /// Samples of each channel in the body that were not stored, as the stream had passed them already.
    pub(crate) repeated: u64,
}

/// The status of a stream.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct StreamView {
    /// Its name.
    name: String,
    /// Sample format.
    sample: &'static str,
    /// Sampling rate in hertz, as specified by the sender.
    sample_rate_hz: f64,
    /// Number of channels.
    channels: usize,
    /// Unit of the samples, if specified by the sender.
    unit: Option<String>,
    /// The channel that is a tachometer.
    tachometer: Option<StreamTachometerView>,
    /// Index of the next expected sample: all earlier ones are stored or known to be missing.
    pub(crate) next: Option<u64>,
    /// The time of that sample.
    next_time: Option<Timestamp>,
    /// Deviation of the actual rate from `sample_rate_hz` in parts per million; positive means faster. None
    /// in the first minute.
    drift_ppm: Option<f64>,
    /// Number of times the sender's clock jumped by more than half a second, or samples stayed late.
    clock_jumps: u64,
    /// Number of gaps.
    pub(crate) gaps: u64,
    /// Missing samples of each channel.
    gap_samples: u64,
    /// Records made from it; those of all channels count as one.
    records: u64,
    /// Records that were refused.
    records_refused: u64,
    /// Why the last of them was refused.
    last_refusal: Option<String>,
    /// Records cut but not stored yet.
    records_waiting: u64,
    /// Bytes of its samples on disk, without records.
    journal_bytes: u64,
    /// The running measuring campaign, or the last one.
    campaign: Option<CampaignStatus>,
}

/// A channel of a stream that is the signal of a tachometer.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct StreamTachometerView {
    /// Its name.
    channel: String,
    /// Level at which a pulse begins.
    level: f64,
    /// By how much the signal falls below the level between two pulses.
    hysteresis: f64,
    /// Pulses per revolution of the driving shaft.
    pulses_per_revolution: u32,
}

/// The streams of an asset.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct StreamList {
    /// By their names.
    pub(crate) items: Vec<StreamView>,
}

/// The levels of a stream, one entry per second.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct LevelView {
    /// Time of the first sample.
    pub(crate) time: Timestamp,
    /// Index of the first sample.
    pub(crate) first: u64,
    /// Samples received per channel: fewer than the rate implies if there is a gap.
    pub(crate) samples: u64,
    /// Root mean square of each channel in the stream's unit, including the mean; null if no sample is a
    /// number.
    pub(crate) rms: Vec<Option<f64>>,
    /// Maximum magnitude of each channel in the stream's unit.
    pub(crate) peak: Vec<Option<f64>>,
}

/// Levels of a stream.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct LevelList {
    /// The seconds in order, at most 100 000.
    pub(crate) items: Vec<LevelView>,
    /// The `cursor` of the next page; none on the last one.
    pub(crate) next_cursor: Option<String>,
}

/// A record made of the last samples.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(crate) struct KeptView {
    /// Start time.
    pub(crate) start_time: Timestamp,
    /// Samples of each channel.
    pub(crate) samples: u64,
}

impl From<StreamStatus> for StreamView {
    fn from(status: StreamStatus) -> Self {
        let format = &status.format;
        let tachometer = format.tachometer().map(|tachometer| StreamTachometerView {
            channel: format.name_of(tachometer),
            level: tachometer.level(),
            hysteresis: tachometer.hysteresis(),
            pulses_per_revolution: tachometer.pulses_per_revolution(),
        });
        Self {
            tachometer,
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
            last_refusal: status.last_refusal,
            records_waiting: status.records_waiting,
            journal_bytes: status.journal_bytes,
            campaign: status.campaign,
        }
    }
}
