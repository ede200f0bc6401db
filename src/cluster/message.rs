//! Encodes queued records as messages of `proto/flankwatch/v1/work.proto` and decodes them.

use bytes::Bytes;
use jiff::Timestamp;
use prost::Message;

use super::ClusterError;
use crate::asset::{AssetId, RawReference, SegmentId};
use crate::service::QueuedRecord;
use crate::settings::SettingError;
use crate::signal::OperatingPoint;
use crate::store::RecordMetadata;

#[expect(unreachable_pub, reason = "generated from the schema, which documents each field")]
mod generated {
    include!("message/work.rs");
}

/// Encodes a record.
///
/// # Errors
/// A time is out of range for 64-bit nanoseconds.
pub(super) fn encode(queued: &QueuedRecord) -> Result<Bytes, ClusterError> {
    let record = &queued.metadata;
    let message = generated::QueuedRecord {
        segment_id: record.id.0.clone(),
        asset: record.asset_id.to_string(),
        asset_created_at_ns: to_ns("asset_created_at", queued.asset_created_at)?,
        channel: record.channel.clone(),
        start_time_ns: to_ns("start_time", record.start_time)?,
        received_at_ns: to_ns("received_at", record.received_at)?,
        unit: record.unit.clone(),
        shaft_speed_hz: record.operating_point.shaft_speed_hz,
        torque_nm: record.operating_point.torque_nm,
        temperature_c: record.operating_point.temperature_c,
        reference_wear_um: record.reference_wear_um,
        raw_sha256: record.raw.sha256.clone(),
        raw_bytes: record.raw.bytes,
        raw_media_type: record.raw.media_type.clone(),
        raw_channel_index: record.raw.channel_index,
    };
    Ok(message.encode_to_vec().into())
}

/// Decodes a record.
///
/// # Errors
/// [`ClusterError::Message`] with the invalid field.
pub(super) fn decode(bytes: &[u8]) -> Result<QueuedRecord, ClusterError> {
    let message =
        generated::QueuedRecord::decode(bytes).map_err(|error| ClusterError::Message(error.to_string()))?;
    let is_hash =
        message.raw_sha256.len() == 64 && message.raw_sha256.bytes().all(|byte| byte.is_ascii_hexdigit());
    if !is_hash {
        let hash = &message.raw_sha256;
        return Err(ClusterError::Message(format!("raw_sha256 is {hash:?}, expected 64 hexadecimal digits")));
    }
    let asset =
        AssetId::new(message.asset).map_err(|error| ClusterError::Message(format!("asset: {error}")))?;
    let metadata = RecordMetadata {
        id: SegmentId(message.segment_id),
        asset_id: asset,
        channel: message.channel,
        start_time: from_ns(message.start_time_ns),
        received_at: from_ns(message.received_at_ns),
        unit: message.unit,
        operating_point: OperatingPoint {
            shaft_speed_hz: message.shaft_speed_hz,
            torque_nm: message.torque_nm,
            temperature_c: message.temperature_c,
        },
        reference_wear_um: message.reference_wear_um,
        raw: RawReference {
            sha256: message.raw_sha256,
            bytes: message.raw_bytes,
            media_type: message.raw_media_type,
            channel_index: message.raw_channel_index,
        },
    };
    Ok(QueuedRecord { metadata, asset_created_at: from_ns(message.asset_created_at_ns), dead_letters: 0 })
}

fn to_ns(field: &str, time: Timestamp) -> Result<i64, ClusterError> {
    i64::try_from(time.as_nanosecond())
        .map_err(|_| SettingError::new(field, time, "a time from 1677-09-21 to 2262-04-11").into())
}

fn from_ns(ns: i64) -> Timestamp {
    // Every 64-bit number of nanoseconds is in the range of `Timestamp`.
    Timestamp::from_nanosecond(ns.into()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> QueuedRecord {
        let metadata = RecordMetadata {
            id: SegmentId("0123".into()),
            asset_id: AssetId::new("pump").unwrap(),
            channel: "gearbox/x".into(),
            start_time: from_ns(-1_000_000_007),
            received_at: from_ns(1_700_000_000_123_456_789),
            unit: "m/s2".into(),
            operating_point: OperatingPoint {
                shaft_speed_hz: Some(0.1 + 0.2),
                torque_nm: None,
                temperature_c: Some(62.5),
            },
            reference_wear_um: Some(12.5),
            raw: RawReference {
                sha256: "ab".repeat(32),
                bytes: u64::MAX,
                media_type: "audio/wav".into(),
                channel_index: 3,
            },
        };
        QueuedRecord { metadata, asset_created_at: from_ns(5), dead_letters: 0 }
    }

    #[test]
    fn a_record_survives_a_round_trip() {
        let bytes = encode(&record()).unwrap();
        assert_eq!(decode(&bytes).unwrap(), record());
        assert!(bytes.len() < 200, "{} bytes", bytes.len());
    }

    #[test]
    fn an_invalid_message_is_rejected_with_the_field() {
        assert!(decode(b"\xff\xff").is_err());
        let mut invalid = record();
        invalid.metadata.raw.sha256 = "../../etc/passwd".into();
        let error = decode(&encode(&invalid).unwrap()).unwrap_err().to_string();
        assert!(error.contains("raw_sha256"), "{error}");
        let mut out_of_range = record();
        out_of_range.metadata.start_time = "2300-01-01T00:00:00Z".parse().unwrap();
        assert!(encode(&out_of_range).unwrap_err().to_string().contains("start_time"));
    }
}
