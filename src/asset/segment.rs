//! One analysed stretch of an asset's vibration.

use std::fmt;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::AssetId;
use crate::estimate::WearEstimate;
use crate::signal::{Basis, Features, Indicators, OperatingPoint, ShaftSpeed};

/// Identifier of a segment: the same asset, channel, start time and raw bytes give the same identifier, so a repeat is found.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(transparent)]
pub struct SegmentId(pub String);

impl SegmentId {
    /// The identifier of one channel's stretch in a raw object.
    pub fn derive(asset: &AssetId, channel: &str, start_time: Timestamp, raw: &RawReference) -> Self {
        let mut hash = Sha256::new();
        let start_time = start_time.as_nanosecond().to_string();
        let mut parts = vec![asset.as_str(), channel, &start_time, &raw.sha256];
        // Bare samples are another record where they are read in another way.
        if raw.media_type.starts_with("application/octet-stream") {
            parts.push(&raw.media_type);
        }
        for part in parts {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part.as_bytes());
        }
        let digest = hash.finalize();
        Self(digest.iter().take(12).map(|byte| format!("{byte:02x}")).collect())
    }
}

impl fmt::Display for SegmentId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Where a segment's raw bytes are kept, as they came.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RawReference {
    /// SHA-256 of the bytes in hexadecimal: the object's name.
    pub sha256: String,
    /// Their number.
    pub bytes: u64,
    /// Their media type (`audio/wav`, `application/x-protobuf`, `application/json`).
    pub media_type: String,
    /// Which channel of the object, counted from 0.
    pub channel_index: u32,
}

/// One analysed stretch of vibration of one channel of an asset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Segment {
    /// Identifier.
    pub id: SegmentId,
    /// The asset it belongs to.
    pub asset_id: AssetId,
    /// The measuring channel.
    pub channel: String,
    /// The time of the first sample.
    pub start_time: Timestamp,
    /// When the service took it.
    pub received_at: Timestamp,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Number of samples.
    pub samples: u64,
    /// Unit of the samples.
    pub unit: String,
    /// Operating point as given with the record.
    pub operating_point: OperatingPoint,
    /// Shaft speed that was used, and where it came from; none where none was found.
    pub shaft_speed: Option<ShaftSpeed>,
    /// Wear depth in µm known from elsewhere (an inspection, a simulation), for comparison only: the estimate never uses it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_wear_um: Option<f64>,
    /// Where the raw bytes are.
    pub raw: RawReference,
    /// What indicators and features rest on: preprocessing, quality of the samples, the shaft's angle.
    #[serde(flatten)]
    pub basis: Basis,
    /// Condition indicators.
    #[serde(flatten)]
    pub indicators: Indicators,
    /// Features for the wear estimate.
    pub features: Features,
    /// The wear estimate after this record.
    pub wear: WearEstimate,
}
