//! The state of the recomputation of a channel's history.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::asset::AssetId;

/// The state of a recomputation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecomputationState {
    /// Indicators and features are recomputed from the raw recordings.
    Analysing,
    /// The estimates are recomputed.
    Folding,
    /// The recomputed history is served.
    Finished,
    /// The recomputation failed; the old history is served.
    Failed,
}

/// The recomputation of one channel's history, and its progress.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Recomputation {
    /// The asset.
    pub asset: AssetId,
    /// The channel.
    pub channel: String,
    /// The state.
    pub state: RecomputationState,
    /// Records of the channel at the start.
    pub records_total: u64,
    /// Records reanalysed from their raw bytes.
    pub analysed: u64,
    /// Records that keep their old indicators because their raw bytes are no longer available or cannot be
    /// read.
    pub without_raw: u64,
    /// Records folded.
    pub folded: u64,
    /// Why it failed.
    pub error: Option<String>,
    /// The time of the start.
    pub started_at: Timestamp,
    /// The time of the end.
    pub finished_at: Option<Timestamp>,
}
