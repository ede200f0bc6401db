//! One analysed segment of an asset's vibration.

use std::fmt;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::asset_id::AssetId;
use crate::estimate::WearEstimate;
use crate::signal::{Basis, Features, Indicators, OperatingPoint, ShaftSpeed};

/// Identifier of a segment: the same asset, channel, start time and raw bytes give the same identifier, so
/// repeated records are found.
///
/// It starts with the second of the start time, so that records of about the same time are close together in
/// every index by identifier. With a hash alone, each of 10⁹ rows would be in a different page that has to be
/// read first.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(transparent)]
pub struct SegmentId(pub String);

impl SegmentId {
    /// Derives the identifier of one channel's segment in a raw object.
    pub fn derive(asset: &AssetId, channel: &str, start_time: Timestamp, raw: &RawReference) -> Self {
        let mut hash = Sha256::new();
        let nanoseconds = start_time.as_nanosecond().to_string();
        let mut parts = vec![asset.as_str(), channel, &nanoseconds, &raw.sha256];
        // The same bare samples decoded in another way are another record.
        if raw.media_type.starts_with("application/octet-stream") {
            parts.push(&raw.media_type);
        }
        for part in parts {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part.as_bytes());
        }
        let digest = hex::encode(&hash.finalize()[..8]);
        // Every time that can be stored is within ± 2⁶³ ns, which is less than ± 2³⁴ s; negative ones sort
        // first.
        let second =
            (start_time.as_nanosecond().div_euclid(1_000_000_000) + (1 << 34)).clamp(0, (1 << 36) - 1);
        Self(format!("{second:09x}{}", &digest[..15]))
    }
}

impl fmt::Display for SegmentId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Reference to a segment's raw bytes as received.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RawReference {
    /// SHA-256 of the bytes in hexadecimal: the object's name.
    pub sha256: String,
    /// Number of bytes.
    pub bytes: u64,
    /// Their media type (`audio/wav`, `application/x-protobuf`, `application/json`).
    pub media_type: String,
    /// Index of the channel in the object, from 0.
    pub channel_index: u32,
}

/// One analysed segment of vibration of one channel of an asset.
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
    /// When the service received it.
    pub received_at: Timestamp,
    /// Sampling rate in hertz.
    pub sample_rate_hz: f64,
    /// Number of samples.
    pub samples: u64,
    /// Unit of the samples.
    pub unit: String,
    /// Operating point as given with the record.
    pub operating_point: OperatingPoint,
    /// Shaft speed that was used, and its source; null if none was found.
    pub shaft_speed: Option<ShaftSpeed>,
    /// Reference wear depth in µm from another source (an inspection, a simulation), for comparison only: the
    /// estimate never uses it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_wear_um: Option<f64>,
    /// The raw bytes.
    pub raw: RawReference,
    /// Whether a user excluded it: it stays stored with its indicators, but does not count for the baseline,
    /// the estimate and the alarms.
    #[serde(default)]
    pub excluded: bool,
    /// The basis of indicators and features: preprocessing, quality of the samples, the shaft's angle.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn id(start_time: &str, channel: &str) -> SegmentId {
        let raw = RawReference {
            sha256: "ab".repeat(32),
            bytes: 4,
            media_type: "audio/wav".into(),
            channel_index: 0,
        };
        SegmentId::derive(&AssetId::new("pump").unwrap(), channel, start_time.parse().unwrap(), &raw)
    }

    #[test]
    fn identifiers_are_in_the_order_of_time() {
        let times = [
            "-009999-01-02T01:59:59Z",
            "1677-09-21T00:12:44Z",
            "1969-12-31T23:59:59.5Z",
            "1970-01-01T00:00:00Z",
            "2026-01-01T00:00:00Z",
            "2026-01-01T00:00:01Z",
            "2262-04-11T23:47:16Z",
            "9999-12-30T22:00:00Z",
        ];
        let ids: Vec<String> = times.iter().map(|time| id(time, "1").0).collect();
        assert!(ids.is_sorted(), "{ids:?}");
        assert!(ids.iter().all(|id| id.len() == 24), "{ids:?}");
        assert_ne!(id(times[4], "1"), id(times[4], "2"));
        assert_ne!(id(times[4], "1"), id("2026-01-01T00:00:00.000000001Z", "1"));
        assert_eq!(id(times[4], "1"), id(times[4], "1"));
    }
}
