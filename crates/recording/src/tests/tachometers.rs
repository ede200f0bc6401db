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
