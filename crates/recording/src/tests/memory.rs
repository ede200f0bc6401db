//! Peak memory of hostile recordings, which are small on the disk: within a small multiple of the longest
//! message.

use std::io::Cursor;

use prost::Message;

use super::*;

/// Just below the longest message that a recording may have, in bytes.
const LONGEST: usize = 79 << 20;

/// A recording compressed with zstd: schema, topic, encoding and bytes of each message.
pub(super) fn mcap_of(messages: &[(&str, &str, &str, Vec<u8>)]) -> Vec<u8> {
    let options = mcap::WriteOptions::new().compression(Some(mcap::Compression::Zstd)).compression_threads(0);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    for (schema, topic, encoding, data) in messages {
        let schema = writer.add_schema(&format!("flankwatch.v1.{schema}"), encoding, &[]).unwrap();
        let channel_id = writer.add_channel(schema, topic, encoding, &Default::default()).unwrap();
        let header = mcap::records::MessageHeader { channel_id, sequence: 1, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// Returns what is read, without keeping it, and the peak of allocated bytes.
fn read_and_peak(bytes: Vec<u8>) -> (Vec<Result<usize, String>>, usize) {
    let mut items = Vec::new();
    let counted = allocation_counter::measure(|| {
        for item in McapReader::new(Cursor::new(bytes)) {
            items.push(
                item.map(|recorded| recorded.record.samples().len()).map_err(|error| error.to_string()),
            );
        }
    });
    (items, usize::try_from(counted.bytes_max).unwrap())
}

/// A field of a protobuf message before its bytes: key and length.
fn head(key: u8, length: usize) -> Vec<u8> {
    let mut head = vec![key];
    prost::encoding::encode_varint(length as u64, &mut head);
    head
}

/// A `Tachometer` message full of pulses of one byte each.
fn many_pulses(bytes: usize) -> Vec<u8> {
    [head(0x0a, bytes), vec![1; bytes]].concat()
}

#[test]
fn too_many_pulses_are_rejected_before_decoding() {
    let json = |before: &str, after: &str| {
        let pulses = "1,".repeat((LONGEST - before.len() - after.len()) / 2 - 1);
        format!("{before}{pulses}1{after}").into_bytes()
    };
    let tachometer = many_pulses(LONGEST);
    for (schema, encoding, data) in [
        ("WaveformBlock", "protobuf", [head(0x4a, tachometer.len()), tachometer.clone()].concat()),
        ("Tachometer", "protobuf", tachometer),
        (
            "WaveformBlock",
            "json",
            json(r#"{"tachometer":{"pulses_per_revolution":1,"pulse_time_ns":["#, "]}}"),
        ),
        ("Tachometer", "json", json(r#"{"pulse_time_ns":["#, "]}")),
    ] {
        let bytes = mcap_of(&[(schema, "/pump/x", encoding, data)]);
        assert!(bytes.len() < 1 << 17, "{} bytes on the disk", bytes.len());
        let (items, peak) = read_and_peak(bytes);
        let refused = items[0].as_ref().unwrap_err();
        assert!(refused.contains("4194304"), "{refused}");
        assert!(peak < 2 * LONGEST, "{schema} in {encoding}: {peak} bytes");
    }
}

#[test]
fn the_maximum_of_pulses_is_in_memory_once() {
    let block = message::WaveformBlock { sample_rate_hz: 1.0, samples: vec![0.5], ..Default::default() };
    let tachometer = many_pulses(1 << 22);
    let bytes = [block.encode_to_vec(), head(0x4a, tachometer.len()), tachometer].concat();
    let mut pulses = 0;
    let counted = allocation_counter::measure(|| {
        let record = decode_block(&bytes, BlockEncoding::Protobuf, &RecordDefaults::default()).unwrap();
        pulses = record.tachometer().unwrap().pulse_times_s.len();
    });
    assert_eq!(pulses, 1 << 22);
    // Eight bytes each, and half of that while the list grows for the last time.
    assert!(counted.bytes_max <= (12 << 22) + 4096, "{} bytes", counted.bytes_max);
}

#[test]
fn an_error_does_not_repeat_a_long_text() {
    for data in [
        format!(r#"{{"{}": 1}}"#, "\u{7f}".repeat(LONGEST - 16)).into_bytes(),
        // A unit of control characters, each of which takes five characters in an error.
        [head(0x22, LONGEST), vec![1; LONGEST]].concat(),
    ] {
        let encoding = if data[0] == b'{' { "json" } else { "protobuf" };
        let (items, peak) = read_and_peak(mcap_of(&[("WaveformBlock", "vibration", encoding, data)]));
        let refused = items[0].as_ref().unwrap_err();
        assert!(refused.len() < 300, "{refused}");
        assert!(peak < 3 * LONGEST, "{encoding}: {peak} bytes");
    }
}

#[test]
fn records_that_wait_for_pulses_are_bounded_by_their_bytes() {
    let block = |_| {
        let mut data = br#"{"sample_rate_hz": 100, "samples": [1]"#.to_vec();
        data.resize(40 << 20, b' ');
        data.push(b'}');
        ("WaveformBlock", "/pump/x/waveform", "json", data)
    };
    let tachometer = ("Tachometer", "/pump/tachometer", "json", br#"{"pulses_per_revolution": 1}"#.to_vec());
    let messages: Vec<_> = std::iter::once(tachometer).chain((0..10).map(block)).collect();
    let bytes = mcap_of(&messages);
    drop(messages);
    let (items, peak) = read_and_peak(bytes);
    assert_eq!(items, vec![Ok(1); 10]);
    assert!(peak < (128 + 3 * 40 + 80) << 20, "{peak} bytes");
}
