//! `WaveformBlock` in JSON: the fields of the protobuf message, with `start_time` in RFC 3339 as the readable
//! form of `start_time_ns`.

use std::collections::HashMap;
use std::fmt;
use std::marker::PhantomData;

use jiff::Timestamp;
use serde::de::{Error as _, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::RecordingError;
use super::decoded_block::DecodedBlock;
use super::pulses::{MAX_PULSES, Pulses};
use flankwatch_signal::{MAX_RECORD_SAMPLES, OperatingPoint, Quality, Record};

/// Longest text in a message, in bytes: errors quote it, and each character may take up to six.
const MAX_TEXT_BYTES: usize = 1024;

/// A block of vibration samples of one channel (`flankwatch.v1.WaveformBlock` as JSON). Unknown fields are
/// rejected by name.
#[derive(Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "openapi", schema(as = WaveformBlock))]
#[cfg_attr(not(feature = "openapi"), expect(unreachable_pub, reason = "public as a schema"))]
pub struct JsonBlock {
    /// Time of the first sample; the time of receipt if missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    start_time: Option<Timestamp>,
    /// Nanoseconds UTC since 1970, instead of `start_time`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    start_time_ns: Option<i64>,
    /// Measured sampling rate in hertz.
    #[cfg_attr(feature = "openapi", schema(example = 12800.0))]
    sample_rate_hz: f64,
    /// Index of the first sample since the start of the acquisition.
    #[serde(default)]
    first_sample_index: u64,
    /// Unit of the samples, `m/s2` or `g`; the asset's if empty.
    #[serde(default)]
    #[cfg_attr(feature = "openapi", schema(example = "m/s2"))]
    unit: String,
    /// The samples in `unit`, at most 2²⁴.
    #[serde(deserialize_with = "samples")]
    samples: Vec<f32>,
    /// Quality flags set by the acquisition.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    quality: Option<Quality>,
    /// Measuring channel.
    #[serde(default)]
    #[cfg_attr(feature = "openapi", schema(example = "a1"))]
    channel: String,
    /// Operating point of the machine during the block.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    operating_point: Option<JsonOperatingPoint>,
    /// Pulses of a tachometer on the driving shaft.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tachometer: Option<JsonTachometer>,
    /// Factor by which the sender multiplied the values of its source. The samples are in `unit` already.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    source_scale: Option<f64>,
}

/// A tachometer message in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "openapi", schema(as = Tachometer))]
pub(crate) struct JsonTachometer {
    /// Time of each pulse in nanoseconds UTC since 1970, at most 2²² of them.
    #[serde(default, deserialize_with = "pulse_times")]
    pulse_time_ns: Vec<i64>,
    /// Pulses per revolution.
    pulses_per_revolution: u32,
    /// The shaft's name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    shaft: String,
}

impl JsonTachometer {
    /// Decodes one message.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Pulses, RecordingError> {
        Ok(message::<Self>(bytes, "a Tachometer")?.into())
    }

    /// Appends one message to `bytes` and returns the pulses.
    pub(crate) fn append(pulses: Pulses, bytes: &mut Vec<u8>) -> Pulses {
        let message = Self::from(pulses);
        serde_json::to_writer(bytes, &message).expect("plain fields are JSON");
        message.into()
    }
}

impl From<JsonTachometer> for Pulses {
    fn from(message: JsonTachometer) -> Self {
        Self {
            pulse_time_ns: message.pulse_time_ns,
            pulses_per_revolution: message.pulses_per_revolution,
            shaft: message.shaft,
        }
    }
}

impl From<Pulses> for JsonTachometer {
    fn from(pulses: Pulses) -> Self {
        Self {
            pulse_time_ns: pulses.pulse_time_ns,
            pulses_per_revolution: pulses.pulses_per_revolution,
            shaft: pulses.shaft,
        }
    }
}

/// An operating point message in JSON.
#[derive(Debug, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "openapi", schema(as = GivenOperatingPoint))]
pub(crate) struct JsonOperatingPoint {
    /// Time from which it applies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    start_time: Option<Timestamp>,
    /// Nanoseconds UTC since 1970, instead of `start_time`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    start_time_ns: Option<i64>,
    /// Rotational frequency of the driving shaft in hertz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shaft_speed_hz: Option<f64>,
    /// Torque on the driving shaft in newton metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    torque_nm: Option<f64>,
    /// Oil or housing temperature in degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    temperature_c: Option<f64>,
}

impl JsonOperatingPoint {
    /// Decodes one message.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, RecordingError> {
        message(bytes, "an OperatingPoint")
    }

    /// Returns the message without its time.
    pub(crate) fn operating_point(&self) -> OperatingPoint {
        OperatingPoint {
            shaft_speed_hz: self.shaft_speed_hz,
            torque_nm: self.torque_nm,
            temperature_c: self.temperature_c,
        }
    }
}

/// Returns whether a block has the field `tachometer`, which may be null.
pub(crate) fn has_tachometer(block: &[u8]) -> bool {
    let fields: Result<HashMap<String, IgnoredAny>, _> = serde_json::from_slice(block);
    fields.is_ok_and(|fields| fields.contains_key("tachometer"))
}

impl JsonBlock {
    /// Decodes one block.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, RecordingError> {
        message(bytes, "a WaveformBlock")
    }

    /// Encodes the block.
    pub(crate) fn encode(&self) -> Vec<u8> {
        // Strings, numbers and lists of this struct always serialise into memory.
        serde_json::to_vec(self).expect("a block of plain fields is JSON")
    }

    pub(crate) fn from_record(record: &Record) -> Self {
        let point = record.operating_point();
        Self {
            start_time: Some(record.start_time()),
            start_time_ns: None,
            sample_rate_hz: record.sample_rate_hz(),
            first_sample_index: 0,
            unit: record.unit().to_owned(),
            samples: record.samples().to_vec(),
            quality: (record.quality() != Quality::default()).then_some(record.quality()),
            channel: record.channel().to_owned(),
            operating_point: (point != OperatingPoint::default()).then_some(JsonOperatingPoint {
                shaft_speed_hz: point.shaft_speed_hz,
                torque_nm: point.torque_nm,
                temperature_c: point.temperature_c,
                ..Default::default()
            }),
            tachometer: Pulses::of_record(record).map(JsonTachometer::from),
            source_scale: record.source_scale(),
        }
    }

    pub(crate) fn into_block(self) -> Result<DecodedBlock, RecordingError> {
        let start_time = match (self.start_time, self.start_time_ns) {
            (Some(_), Some(nanoseconds)) => {
                return Err(RecordingError::field(
                    "start_time_ns",
                    nanoseconds,
                    "either start_time or start_time_ns, not both",
                ));
            }
            (Some(time), None) => Some(time),
            (None, Some(nanoseconds)) => {
                Some(Timestamp::from_nanosecond(nanoseconds.into()).map_err(|_| {
                    RecordingError::field("start_time_ns", nanoseconds, "nanoseconds since 1970-01-01 UTC")
                })?)
            }
            (None, None) => None,
        };
        Ok(DecodedBlock {
            start_time,
            sample_rate_hz: self.sample_rate_hz,
            first_sample_index: self.first_sample_index,
            unit: self.unit,
            channel: self.channel,
            samples: self.samples,
            operating_point: self
                .operating_point
                .as_ref()
                .map(JsonOperatingPoint::operating_point)
                .unwrap_or_default(),
            quality: self.quality.unwrap_or_default(),
            pulses: self.tachometer.map(Pulses::from),
            source_scale: self.source_scale,
        })
    }
}

/// Decodes one message of this name after checking the length of its texts.
fn message<'de, T: Deserialize<'de>>(bytes: &'de [u8], name: &'static str) -> Result<T, RecordingError> {
    if bytes.trim_ascii_start().starts_with(b"{") {
        check_texts(bytes)?;
    }
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let parsed = match bytes.trim_ascii_start().first() {
        // Its elements would be taken as the fields in order.
        Some(b'[') => Err(serde_json::Error::custom("an array, expected an object with named fields")),
        _ => T::deserialize(&mut reader).and_then(|message| reader.end().map(|()| message)),
    };
    parsed.map_err(|source| {
        let mut reader = serde_json::Deserializer::from_slice(bytes);
        let fault = serde_path_to_error::deserialize::<_, T>(&mut reader).err();
        let path = fault
            .map(|fault| fault.path().to_string())
            .filter(|path| !path.starts_with(['.', '[']) && !path.contains('?'));
        RecordingError::Json { message: name, path, problem: json_error_words(&source), source }
    })
}

/// Returns an error of the parser in words, without the names of Rust's types.
pub fn json_error_words(error: &serde_json::Error) -> String {
    let message = error.to_string();
    let Some((found, rest)) = message.rsplit_once(", expected ") else { return message };
    let (of_type, place) = rest.split_once(" at line ").map_or((rest, None), |(of, at)| (of, Some(at)));
    let words = match of_type {
        "f64" | "f32" => "a number",
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" | "u64" | "usize" => "a whole number of at least 0",
        "i32" | "i64" => "a whole number",
        "a sequence" => "a list",
        "a map" => "an object",
        of_type if of_type.starts_with("struct ") => "an object",
        _ => return message,
    };
    let place = place.map_or_else(String::new, |place| format!(" at line {place}"));
    format!("{found}, expected {words}{place}")
}

/// Rejects a text that is too long for any field's name or value, before an error quotes it.
fn check_texts(bytes: &[u8]) -> Result<(), RecordingError> {
    let mut left = bytes;
    while let Some(begin) = left.iter().position(|byte| *byte == b'"') {
        let text = &left[begin + 1..];
        let mut is_escaped = false;
        let length = text.iter().position(|byte| {
            let is_end = *byte == b'"' && !is_escaped;
            is_escaped = *byte == b'\\' && !is_escaped;
            is_end
        });
        let length = length.unwrap_or(text.len());
        if length > MAX_TEXT_BYTES {
            return Err(RecordingError::field(
                "the length of a text in the message",
                length,
                "at most 1024 bytes",
            ));
        }
        left = text.get(length + 1..).unwrap_or_default();
    }
    Ok(())
}

/// Reads the samples and stops at the first one above the limit.
fn samples<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f32>, D::Error> {
    deserializer.deserialize_seq(Numbers {
        max: MAX_RECORD_SAMPLES,
        expected: "samples, a list of finite numbers",
        too_many: "samples, cut the recording into shorter records",
        kind: PhantomData,
    })
}

/// Reads the pulse times and stops at the first one above the limit.
fn pulse_times<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<i64>, D::Error> {
    deserializer.deserialize_seq(Numbers {
        max: MAX_PULSES,
        expected: "pulse_time_ns, a list of whole numbers",
        too_many: "pulses, send them in shorter messages",
        kind: PhantomData,
    })
}

/// A list of at most `max` numbers.
struct Numbers<T> {
    max: usize,
    expected: &'static str,
    /// The rest of the error for too many numbers: what they are, and what to do.
    too_many: &'static str,
    kind: PhantomData<T>,
}

impl<'de, T: Deserialize<'de>> Visitor<'de> for Numbers<T> {
    type Value = Vec<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.expected)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut numbers = Vec::new();
        while let Some(number) = list.next_element()? {
            if numbers.len() == self.max {
                return Err(A::Error::custom(format_args!("more than {} {}", self.max, self.too_many)));
            }
            numbers.push(number);
        }
        // Buffered memory is counted by the number of values.
        numbers.shrink_to_fit();
        Ok(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{BlockEncoding, RecordDefaults, decode_block};
    use super::*;

    fn decode(json: &str) -> Result<flankwatch_signal::Record, String> {
        decode_block(json.as_bytes(), BlockEncoding::Json, &RecordDefaults::default())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn both_forms_of_the_time_are_equivalent() {
        let text = decode(r#"{"start_time": "2026-01-02T03:04:05.000000006Z", "sample_rate_hz": 1e4, "samples": [1, -2.5]}"#).unwrap();
        let number =
            decode(r#"{"start_time_ns": 1767323045000000006, "sample_rate_hz": 1e4, "samples": [1, -2.5]}"#)
                .unwrap();
        assert_eq!(text, number);
        assert_eq!(text.samples(), [1.0, -2.5]);
    }

    #[test]
    fn an_error_names_what_is_wrong() {
        for (json, expected) in [
            ("", "EOF"),
            ("[]", "an array, expected an object"),
            (&format!("RIFF\"{}", "x".repeat(2000)), "expected value at line 1"),
            ("3", "invalid type: integer `3`, expected an object"),
            (r#"{"sample_rate_hz": "1", "samples": [1]}"#, r#"string "1", expected a number at line 1"#),
            (r#"{"sample_rate_hz": 1, "samples": [1], "tachometer": 3}"#, "expected an object"),
            (r#"{"sample_rate_hz": 1, "samples": [1], "volume": 3}"#, "unknown field `volume`"),
            (r#"{"samples": [1]}"#, "missing field `sample_rate_hz`"),
            (r#"{"sample_rate_hz": 1}"#, "missing field `samples`"),
            (r#"{"sample_rate_hz": 1, "samples": []}"#, "no samples"),
            (r#"{"sample_rate_hz": 1, "samples": [NaN]}"#, "expected value at line 1"),
            (r#"{"sample_rate_hz": 1, "samples": [null]}"#, "invalid type: null"),
            (r#"{"sample_rate_hz": 1, "samples": [1, 1e39]}"#, "out of range"),
            (r#"{"sample_rate_hz": 1, "samples": [1e999]}"#, "out of range"),
            (r#"{"sample_rate_hz": -1, "samples": [1]}"#, "sample_rate_hz is -1"),
            (r#"{"sample_rate_hz": 1, "samples": [1], "start_time": "yesterday"}"#, "failed to parse"),
            (
                r#"{"sample_rate_hz": 1, "samples": [1], "start_time": "2026-01-01T00:00:00Z", "start_time_ns": 1}"#,
                "not both",
            ),
            (
                r#"{"sample_rate_hz": 1, "samples": [1], "operating_point": {"shaft_speed_hz": 0}}"#,
                "shaft_speed_hz is 0",
            ),
            (
                r#"{"sample_rate_hz": 1, "samples": [1], "operating_point": {"rpm": 1}}"#,
                "unknown field `rpm`",
            ),
        ] {
            let error = decode(json).unwrap_err();
            assert!(error.contains(expected), "{json}: {error}");
        }
    }

    #[test]
    fn one_pulse_too_many_is_rejected() {
        let tachometer = |pulses: usize| {
            let times = vec!["1"; pulses].join(",");
            format!(r#"{{"pulses_per_revolution": 1, "pulse_time_ns": [{times}]}}"#)
        };
        let decode_tachometer =
            |pulses| JsonTachometer::decode(tachometer(pulses).as_bytes()).map_err(|error| error.to_string());
        assert_eq!(decode_tachometer(MAX_PULSES).unwrap().pulse_time_ns.len(), MAX_PULSES);
        let refused = "more than 4194304 pulses, send them in shorter messages";
        assert!(decode_tachometer(MAX_PULSES + 1).unwrap_err().contains(refused));
        let block = format!(
            r#"{{"sample_rate_hz": 1, "samples": [1], "tachometer": {}}}"#,
            tachometer(MAX_PULSES + 1)
        );
        assert!(decode(&block).unwrap_err().contains(refused));
    }

    #[test]
    fn a_long_text_is_not_quoted() {
        let long = "\u{7f}".repeat(1025);
        for json in [
            format!(r#"{{"{long}": 1}}"#),
            format!(r#"{{"sample_rate_hz": "{long}", "samples": [1]}}"#),
            format!(r#"{{"sample_rate_hz": 1, "samples": [1], "unit": "\"{}"#, &long[2..]),
        ] {
            let error = decode(&json).unwrap_err();
            assert_eq!(error, "the length of a text in the message is 1025, expected at most 1024 bytes");
        }
        let quoted = r#"{"sample_rate_hz": 1, "samples": [1], "unit": "\\", "channel": "\"x\""}"#;
        assert_eq!(decode(quoted).unwrap().channel(), "\"x\"");
    }
}
