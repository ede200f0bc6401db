//! How far the recomputation of a history is.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::asset::AssetId;

/// What a recomputation is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecomputationState {
    /// Indicators and features are computed again from the raw recordings.
    Analysing,
    /// The estimates are computed again.
    Folding,
    /// Everything is served as new.
    Finished,
    /// Could not go on; the old answers are served.
    Failed,
}

/// One channel's history being computed again, and how far it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Recomputation {
    /// The asset.
    pub asset: AssetId,
    /// The channel.
    pub channel: String,
    /// What it is doing.
    pub state: RecomputationState,
    /// Records of the channel when it began.
    pub records_total: u64,
    /// Records analysed again from their raw bytes.
    pub analysed: u64,
    /// Records that keep their old indicators, since their raw bytes are not kept any more or cannot be read.
    pub without_raw: u64,
    /// Records folded.
    pub folded: u64,
    /// Why it failed.
    pub error: Option<String>,
    /// When it began.
    pub started_at: Timestamp,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
}
