use std::io::Cursor;

use prost::Message;

use super::memory::mcap_of;
use super::*;

/// A second of vibration after tachometers: topic, shaft in the message and pulses a second of each. How many
/// pulses the record has.
fn pulses_taken(tachometers: &[(&'static str, &str, i64)]) -> Option<usize> {
    let tachometer = |&(topic, shaft, pulses): &(&'static str, &str, i64)| {
        let message = message::Tachometer {
            pulse_time_ns: (0..pulses).map(|pulse| 1_000_000_000 + pulse * 1_000_000_000 / pulses).collect(),
            pulses_per_revolution: 1,
            shaft: shaft.to_owned(),
        };
        ("Tachometer", topic, "protobuf", message.encode_to_vec())
    };
    let block = message::WaveformBlock {
        start_time_ns: 1_000_000_000,
        sample_rate_hz: 100.0,
        samples: vec![0.5; 100],
        ..Default::default()
    };
    let mut messages: Vec<_> = tachometers.iter().map(tachometer).collect();
    messages.push(("WaveformBlock", "/pump/x/waveform", "protobuf", block.encode_to_vec()));
    let mut records = McapReader::new(Cursor::new(mcap_of(&messages)));
    let record = records.next().unwrap().unwrap().record;
    assert!(records.next().is_none());
    record.tachometer().map(|tachometer| tachometer.pulse_times_s.len())
}

#[test]
fn the_topic_names_the_shaft_where_the_message_does_not() {
    for (topic, shaft, taken) in [
        ("/pump/tachometer", "", Some(20)),
        ("/pump/driving/tachometer", "", Some(20)),
        ("/pump/driven/tachometer", "", None),
        ("/pump/gearbox/driven/tachometer", "", None),
        // The shaft in the message takes precedence.
        ("/pump/driven/tachometer", "driving", Some(20)),
        ("/pump/driving/tachometer", "driven", None),
        // A place, not a shaft.
        ("/pump/gearbox/tachometer", "", Some(20)),
    ] {
        assert_eq!(pulses_taken(&[(topic, shaft, 20)]), taken, "{topic} {shaft:?}");
    }
}

#[test]
fn pulses_of_both_shafts_are_distinguished() {
    let both = [("/pump/driven/tachometer", "", 7), ("/pump/driving/tachometer", "", 20)];
    assert_eq!(pulses_taken(&both), Some(20));
}

/// Schema, topic and bytes of four seconds of one channel.
fn seconds_of(channel: &str) -> Vec<(&'static str, String, Vec<u8>)> {
    let block = |second: i64| message::WaveformBlock {
        start_time_ns: second * 1_000_000_000,
        sample_rate_hz: 100.0,
        samples: vec![0.5; 100],
        ..Default::default()
    };
    let topic = format!("/pump/{channel}/waveform");
    (1..5).map(|second| ("WaveformBlock", topic.clone(), block(second).encode_to_vec())).collect()
}

#[test]
fn channels_one_after_the_other_all_have_the_pulses() {
    let pulses = message::Tachometer {
        pulse_time_ns: (0..120).map(|pulse| pulse * 50_000_000).collect(),
        pulses_per_revolution: 1,
        shaft: String::new(),
    };
    let mut messages = vec![("Tachometer", "/pump/tachometer".to_owned(), pulses.encode_to_vec())];
    messages.extend(seconds_of("a").into_iter().chain(seconds_of("b")));
    let messages: Vec<_> = messages
        .iter()
        .map(|(schema, topic, data)| (*schema, topic.as_str(), "protobuf", data.clone()))
        .collect();
    let pulses: Vec<Option<usize>> = McapReader::new(Cursor::new(mcap_of(&messages)))
        .map(|item| item.unwrap().record.tachometer().map(|tachometer| tachometer.pulse_times_s.len()))
        .collect();
    assert_eq!(pulses, [Some(21); 8]);
}

#[test]
fn the_stored_json_has_the_pulses_of_its_record() {
    let pulses = br#"{"pulses_per_revolution": 1, "pulse_time_ns": [0, 1500000000, 3000000000]}"#.to_vec();
    for (field, taken) in [(r#""channel": "tachometer""#, Some(3)), (r#""tachometer": null"#, None)] {
        let start = r#""start_time_ns": 1000000000, "sample_rate_hz": 1, "samples": [1]"#;
        let block = format!("{{{start}, {field}}}").into_bytes();
        let messages = [
            ("Tachometer", "/pump/tachometer", "json", pulses.clone()),
            ("WaveformBlock", "/pump/x/waveform", "json", block),
        ];
        let recorded = McapReader::new(Cursor::new(mcap_of(&messages))).next().unwrap().unwrap();
        let stored = decode_block(&recorded.raw, BlockEncoding::Json, &RecordDefaults::default()).unwrap();
        for record in [&recorded.record, &stored] {
            assert_eq!(
                record.tachometer().map(|tachometer| tachometer.pulse_times_s.len()),
                taken,
                "{field}"
            );
        }
    }
}

#[test]
fn an_error_names_the_message_that_is_damaged() {
    for (schema, topic, encoding, expected) in [
        ("Tachometer", "/pump/tachometer", "protobuf", "not a Tachometer in protobuf"),
        ("Tachometer", "/pump/tachometer", "json", "not a Tachometer in JSON"),
        ("OperatingPoint", "/pump/operating_point", "protobuf", "not an OperatingPoint in protobuf"),
        ("OperatingPoint", "/pump/operating_point", "json", "not an OperatingPoint in JSON"),
        ("WaveformBlock", "/pump/x/waveform", "protobuf", "not a WaveformBlock in protobuf"),
    ] {
        let bytes = mcap_of(&[(schema, topic, encoding, vec![0xff; 20])]);
        let error = McapReader::new(Cursor::new(bytes)).next().unwrap().unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
