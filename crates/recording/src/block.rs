//! Conversion between a `WaveformBlock` message and a [`Record`], in protobuf or JSON.

use jiff::Timestamp;
use prost::Message;

use super::RecordingError;
use super::decoded_block::DecodedBlock;
use super::json::JsonBlock;
use super::message::{self, WaveformBlock};
use super::pulses::{Pulses, nanoseconds};
use super::record_defaults::RecordDefaults;
use super::{packed_samples, pulse_count};
use flankwatch_signal::{MAX_RECORD_SAMPLES, OperatingPoint, Quality, Record, RecordError};

/// Encoding of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BlockEncoding {
    /// Protobuf, `proto/flankwatch/v1/vibration.proto`.
    Protobuf,
    /// JSON with the same field names; `start_time` in RFC 3339 may replace `start_time_ns`.
    Json,
}

/// Decodes one block.
///
/// A missing start time (0 in protobuf), channel, unit or field of the operating point is filled from
/// `defaults`; a channel without a name is `"1"`.
///
/// # Errors
/// An invalid field, named in the error; more than [`MAX_RECORD_SAMPLES`] samples or 4 194 304 pulses, which
/// are rejected before memory is allocated.
pub fn decode_block(
    bytes: &[u8],
    encoding: BlockEncoding,
    defaults: &RecordDefaults,
) -> Result<Record, RecordingError> {
    decode_message(bytes, encoding)?.into_record(None, defaults)
}

/// Decodes one block of a stream, as [`decode_block`] does, and returns the index of its first sample with
/// it.
///
/// # Errors
/// Those of [`decode_block`].
pub fn decode_indexed_block(
    bytes: &[u8],
    encoding: BlockEncoding,
    defaults: &RecordDefaults,
) -> Result<(u64, Record), RecordingError> {
    let block = decode_message(bytes, encoding)?;
    Ok((block.first_sample_index, block.into_record(None, defaults)?))
}

/// Encodes one block.
///
/// Samples, rate, operating point and quality are preserved exactly, pulse times to a nanosecond. The start
/// time is exact for the years 1678 to 2261 (the range of 64-bit nanoseconds) and is clamped to that range in
/// protobuf.
pub fn encode_block(record: &Record, encoding: BlockEncoding) -> Vec<u8> {
    match encoding {
        BlockEncoding::Protobuf => message_of(record).encode_to_vec(),
        BlockEncoding::Json => JsonBlock::from_record(record).encode(),
    }
}

/// Decodes a block without validating its fields.
pub(crate) fn decode_message(bytes: &[u8], encoding: BlockEncoding) -> Result<DecodedBlock, RecordingError> {
    match encoding {
        BlockEncoding::Protobuf => {
            // A sample takes 4 bytes packed and 5 unpacked: more bytes than this cannot be a record and are
            // not decoded.
            let max_bytes = 5 * MAX_RECORD_SAMPLES + (1 << 16);
            if bytes.len() > max_bytes {
                return Err(RecordingError::field(
                    "the block's length in bytes",
                    bytes.len(),
                    "at most 83951616 bytes: cut it into shorter records",
                ));
            }
            let invalid = RecordingError::protobuf("a WaveformBlock");
            let block = match packed_samples::split(bytes) {
                // A split message has at most 64 KiB besides its samples, hence not too many pulses.
                Some((samples, others)) => {
                    WaveformBlock { samples, ..WaveformBlock::decode(&others[..]).map_err(invalid)? }
                }
                None => {
                    pulse_count::check_block(bytes)?;
                    WaveformBlock::decode(bytes).map_err(invalid)?
                }
            };
            Ok(DecodedBlock {
                start_time: timestamp_of(block.start_time_ns)?,
                sample_rate_hz: block.sample_rate_hz,
                first_sample_index: block.first_sample_index,
                unit: block.unit,
                channel: block.channel,
                samples: block.samples,
                operating_point: block.operating_point.as_ref().map(operating_point_of).unwrap_or_default(),
                quality: block.quality.map_or_else(Quality::default, |quality| Quality {
                    clipped: quality.clipped,
                    gap: quality.gap,
                }),
                pulses: block.tachometer,
                source_scale: block.source_scale,
            })
        }
        BlockEncoding::Json => JsonBlock::decode(bytes)?.into_block(),
    }
}

/// Converts a record to a protobuf message without an index.
pub(crate) fn message_of(record: &Record) -> WaveformBlock {
    let point = record.operating_point();
    WaveformBlock {
        start_time_ns: nanoseconds(record.start_time()),
        sample_rate_hz: record.sample_rate_hz(),
        first_sample_index: 0,
        unit: record.unit().to_owned(),
        samples: record.samples().to_vec(),
        quality: (record.quality() != Quality::default())
            .then_some(message::Quality { clipped: record.quality().clipped, gap: record.quality().gap }),
        channel: record.channel().to_owned(),
        operating_point: (point != OperatingPoint::default()).then_some(message::OperatingPoint {
            start_time_ns: 0,
            shaft_speed_hz: point.shaft_speed_hz,
            torque_nm: point.torque_nm,
            temperature_c: point.temperature_c,
        }),
        tachometer: Pulses::of_record(record),
        source_scale: record.source_scale(),
    }
}

/// Converts the message without its time.
pub(crate) fn operating_point_of(message: &message::OperatingPoint) -> OperatingPoint {
    OperatingPoint {
        shaft_speed_hz: message.shaft_speed_hz,
        torque_nm: message.torque_nm,
        temperature_c: message.temperature_c,
    }
}

/// Converts a time of a protobuf message; 0 means that it is missing.
fn timestamp_of(nanoseconds: i64) -> Result<Option<Timestamp>, RecordingError> {
    if nanoseconds == 0 {
        return Ok(None);
    }
    Timestamp::from_nanosecond(nanoseconds.into())
        .map(Some)
        .map_err(|_| RecordingError::field("start_time_ns", nanoseconds, "nanoseconds since 1970-01-01 UTC"))
}

/// Rejects a sample count that no record can have, before memory is allocated.
pub(crate) fn check_sample_count(channel: &str, samples: usize) -> Result<(), RecordError> {
    if samples > MAX_RECORD_SAMPLES {
        return Err(RecordError::TooLong { channel: channel.to_owned(), samples });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn any_record() -> impl Strategy<Value = Record> {
        let finite = prop::num::f32::NORMAL | prop::num::f32::ZERO | prop::num::f32::SUBNORMAL;
        (
            "[a-z0-9/ä]{1,12}",
            prop_oneof![Just(1i64), 1..i64::MAX, i64::MIN..-1],
            1e-3f64..1e7,
            "[a-z/²0-9]{1,8}",
            prop::collection::vec(finite, 1..200),
            prop::option::of(1e-6f64..1e4),
            [prop::option::of(-1e6f64..1e6), prop::option::of(-1e2f64..1e3)],
            any::<[bool; 2]>(),
            prop::option::of(1e-6f64..1e6),
        )
            .prop_map(
                |(
                    channel,
                    time,
                    rate,
                    unit,
                    samples,
                    shaft_speed_hz,
                    [torque_nm, temperature_c],
                    [clipped, gap],
                    source_scale,
                )| {
                    let time = Timestamp::from_nanosecond(time.into()).unwrap();
                    Record::new(channel, time, rate, unit, samples)
                        .unwrap()
                        .with_operating_point(OperatingPoint { shaft_speed_hz, torque_nm, temperature_c })
                        .unwrap()
                        .with_quality(Quality { clipped, gap })
                        .with_source_scale(source_scale)
                },
            )
    }

    proptest! {
        #[test]
        fn a_record_comes_back_exactly(record in any_record()) {
            for encoding in [BlockEncoding::Protobuf, BlockEncoding::Json] {
                let bytes = encode_block(&record, encoding);
                prop_assert_eq!(&decode_block(&bytes, encoding, &RecordDefaults::default()).unwrap(), &record);
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            for encoding in [BlockEncoding::Protobuf, BlockEncoding::Json] {
                let _ = decode_block(&bytes, encoding, &RecordDefaults::default());
            }
        }

        #[test]
        fn a_changed_byte_never_panics(record in any_record(), place in any::<prop::sample::Index>(), byte in any::<u8>()) {
            for encoding in [BlockEncoding::Protobuf, BlockEncoding::Json] {
                let mut bytes = encode_block(&record, encoding);
                let place = place.index(bytes.len());
                bytes[place] = byte;
                let _ = decode_block(&bytes, encoding, &RecordDefaults::default());
            }
        }
    }

    #[test]
    fn defaults_fill_missing_fields_of_a_block() {
        let block = WaveformBlock { sample_rate_hz: 100.0, samples: vec![1.0], ..Default::default() };
        let defaults = RecordDefaults {
            channel: Some("x".to_owned()),
            start_time: Timestamp::from_second(5).unwrap(),
            unit: Some("g".to_owned()),
            operating_point: OperatingPoint { shaft_speed_hz: Some(30.0), ..OperatingPoint::default() },
            ..RecordDefaults::default()
        };
        let record = decode_block(&block.encode_to_vec(), BlockEncoding::Protobuf, &defaults).unwrap();
        assert_eq!((record.channel(), record.unit(), record.start_time().as_second()), ("x", "g", 5));
        assert_eq!(record.operating_point().shaft_speed_hz, Some(30.0));
        let bare = decode_block(&block.encode_to_vec(), BlockEncoding::Protobuf, &RecordDefaults::default())
            .unwrap();
        assert_eq!((bare.channel(), bare.unit()), ("1", "1"));
    }

    #[test]
    fn values_that_are_not_finite_are_rejected() {
        let mut block =
            WaveformBlock { sample_rate_hz: 100.0, samples: vec![0.0, f32::NAN], ..Default::default() };
        let refused = |block: &WaveformBlock| {
            decode_block(&block.encode_to_vec(), BlockEncoding::Protobuf, &RecordDefaults::default())
                .unwrap_err()
                .to_string()
        };
        assert!(refused(&block).contains("NaN at sample 1"));
        block.samples.pop();
        block.sample_rate_hz = f64::INFINITY;
        assert!(refused(&block).contains("sample_rate_hz is inf"));
        block.sample_rate_hz = 1.0;
        block.unit = "m".repeat(65);
        assert!(refused(&block).contains("unit is"));
        block.unit = String::new();
        block.source_scale = Some(0.0);
        assert!(refused(&block).contains("source_scale is 0"));
    }

    #[test]
    fn too_many_bytes_are_not_decoded() {
        let bytes = vec![0; 5 * MAX_RECORD_SAMPLES + (1 << 16) + 1];
        let error = decode_block(&bytes, BlockEncoding::Protobuf, &RecordDefaults::default()).unwrap_err();
        assert!(error.to_string().contains("83951617"), "{error}");
    }
}
