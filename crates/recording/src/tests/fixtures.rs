use super::*;

/// What a file yields, in order: samples of a record, or part of an error.
enum Expected {
    Samples(&'static [f32]),
    Error(&'static str),
}

use Expected::{Error, Samples};

/// Expected values follow from the description of each file in `fixtures/recordings/README.md`.
const FIXTURES: &[(&str, &[Expected])] = &[
    ("empty.wav", &[Error("0 bytes")]),
    ("zeros.bin", &[Error("the format is unknown")]),
    ("notes.csv", &[Error("the sampling rate is missing")]),
    ("wav-int16.wav", &[Samples(&[1.0 / 32768.0, -2.0 / 32768.0, 0.5, -1.0])]),
    ("wav-one-sample.wav", &[Samples(&[1.0 / 32768.0])]),
    ("wav-no-samples.wav", &[Error("has no samples")]),
    ("wav-truncated.wav", &[Error("ends in the data chunk at byte 52: 4096 bytes declared, 8 found")]),
    ("wav-declares-4-gib.wav", &[Error("4294967294 bytes declared, 8 found")]),
    ("wav-length-left-open.wav", &[Samples(&[1.0 / 32768.0, -2.0 / 32768.0, 0.5, -1.0])]),
    ("wav-bw64.wav", &[Samples(&[1.0 / 32768.0, -2.0 / 32768.0, 0.5, -1.0])]),
    ("wav-rf64-declares-exbibytes.wav", &[Error("1152921504606846976 bytes declared, 8 found")]),
    ("wav-zero-channels.wav", &[Error("channel count is 0")]),
    ("wav-65535-channels.wav", &[Error("channel count is 65535")]),
    ("wav-zero-rate.wav", &[Error("sample rate is 0")]),
    ("wav-rate-above-10-mhz.wav", &[Error("sample_rate_hz is 4294967295")]),
    ("wav-zero-block-align.wav", &[Error("block align is 0 bytes")]),
    ("wav-half-a-frame.wav", &[Error("data chunk length is 8 with frames of 6 bytes")]),
    ("wav-adpcm.wav", &[Error("format tag is 0x0002 (Microsoft ADPCM)")]),
    ("wav-no-fmt.wav", &[Error("fmt chunk is missing")]),
    ("wav-fmt-too-short.wav", &[Error("fmt chunk length is 14")]),
    ("wav-float16.wav", &[Error("float sample size is 16 bits in 2 bytes")]),
    ("wav-float-nan.wav", &[Error("NaN at sample 1, expected finite samples (2 of 4 are not)")]),
    ("wav-float64-beyond-f32.wav", &[Error("inf at sample 1")]),
    ("wav-mixed-padding.wav", &[Error("sample padding is not empty in containers of 4 bytes")]),
    ("wav-left-justified-24-in-4.wav", &[Samples(&[0.5, -0.25])]),
    ("wav-only-riff.wav", &[Error("ends in the RIFF header at byte 4")]),
    ("wav-foreign-subformat.wav", &[Error("subformat is")]),
    ("mcap-unchunked.mcap", &[Samples(&[1.0, 2.0])]),
    (
        "mcap-bad-message-between.mcap",
        &[
            Samples(&[1.0, 2.0]),
            Error("message 2 on \"/p/x/waveform\": not a WaveformBlock in protobuf"),
            Error("message 3 on \"/p/x/waveform\": channel \"x\" has NaN at sample 0"),
            Samples(&[1.0, 2.0]),
        ],
    ),
    ("mcap-truncated.mcap", &[Samples(&[1.0, 2.0]), Error("ends at byte 326 in the middle of a record")]),
    ("mcap-no-data-end.mcap", &[Samples(&[1.0, 2.0]), Error("ends at byte 237 in the middle of the data")]),
    ("mcap-bad-chunk-crc.mcap", &[Samples(&[1.0, 2.0]), Error("damaged at byte 237: Chunk CRC failed")]),
    (
        "mcap-record-declares-exbibytes.mcap",
        &[Samples(&[1.0, 2.0]), Error("damaged at byte 188: a record declares 1152921504606846976 bytes")],
    ),
    (
        "mcap-inner-record-past-chunk.mcap",
        &[
            Samples(&[1.0, 2.0]),
            Error("damaged at byte 237: a record in a chunk needs 1048576 bytes, the record has 3 left"),
        ],
    ),
    (
        "mcap-chunk-declares-exbibytes.mcap",
        &[Error("damaged at byte 34: a chunk declares 1152921504606846976 bytes uncompressed")],
    ),
    (
        "mcap-chunk-compressed-size-lies.mcap",
        &[Error("damaged at byte 34: a chunk declares 1099511627776 bytes of records")],
    ),
    ("mcap-unknown-compression.mcap", &[Error("Unsupported compression format `snappy`")]),
    ("mcap-broken-zstd.mcap", &[Error("damaged at byte 34: Error during decompression")]),
    ("mcap-zstd-of-zeros.mcap", &[Error("no vibration found")]),
    (
        "mcap-undeclared-channel.mcap",
        &[
            Error(
                "message 1 on \"(channel 7)\": channel id is 7, expected the id of a channel declared before",
            ),
            Error("no vibration found"),
        ],
    ),
    (
        "mcap-topic-longer-than-record.mcap",
        &[Error("damaged at byte 34: a channel's topic has 4294967295 bytes")],
    ),
    ("mcap-no-topics.mcap", &[Error("no vibration found")]),
    ("mcap-only-magic.mcap", &[Error("ends at byte 8")]),
    ("mcap-json.mcap", &[Samples(&[1.0, 2.0])]),
    (
        "mcap-reference-wear.mcap",
        &[Error("reference_wear is \"2000\": \"thick\""), Samples(&[1.0, 2.0]), Samples(&[1.0, 2.0])],
    ),
];

fn check(name: &str, expected: &[Expected], items: &[Result<Recorded, String>]) {
    assert_eq!(items.len(), expected.len(), "{name}: {items:?}");
    for (item, expected) in items.iter().zip(expected) {
        match (item, expected) {
            (Ok(recorded), Samples(samples)) => assert_eq!(recorded.record.samples(), *samples, "{name}"),
            (Err(error), Error(part)) => assert!(error.contains(part), "{name}: {error}"),
            _ => panic!("{name}: {item:?}"),
        }
    }
}

#[test]
fn every_hand_made_file_gives_the_expected_items() {
    for (name, expected) in FIXTURES {
        check(name, expected, &read_all(&fixture(name), None));
    }
    let listed = FIXTURES.len();
    let there = std::fs::read_dir(fixture(""))
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().path().extension().is_none_or(|e| e != "md"))
        .count();
    assert_eq!(listed, there, "a file in fixtures/recordings is not in the table");
}

#[test]
fn json_messages_take_the_topic_and_the_operating_point_before_them() {
    let recorded = read_all(&fixture("mcap-json.mcap"), None).remove(0).unwrap();
    assert_eq!(recorded.encoding, BlockEncoding::Json);
    assert_eq!((recorded.record.channel(), recorded.record.unit()), ("gearbox/x", "g"));
    assert_eq!(recorded.record.start_time().as_nanosecond(), 1000, "publish time");
    let point = recorded.record.operating_point();
    assert_eq!(
        (point.shaft_speed_hz, point.torque_nm),
        (Some(29.7), Some(7.0)),
        "the block's own torque wins"
    );
    assert!(recorded.raw.starts_with(b"{\"sample_rate_hz\""));
}

#[test]
fn reference_wear_belongs_to_the_record_of_its_start_time() {
    let items = read_all(&fixture("mcap-reference-wear.mcap"), None);
    let wear: Vec<Option<f64>> = items.iter().flatten().map(|recorded| recorded.reference_wear_um).collect();
    assert_eq!(wear, [Some(12.5), None]);
}

#[test]
fn every_prefix_of_a_recording_is_read_or_rejected() {
    for name in
        ["wav-int16.wav", "wav-left-justified-24-in-4.wav", "mcap-bad-chunk-crc.mcap", "mcap-json.mcap"]
    {
        let bytes = std::fs::read(fixture(name)).unwrap();
        for end in 0..bytes.len() {
            let prefix = bytes[..end].to_vec();
            let failed = if name.starts_with("wav") {
                decode_wav(&prefix, &RecordDefaults::default()).is_err()
            } else {
                McapReader::new(std::io::Cursor::new(prefix)).any(|item| item.is_err())
            };
            // The bytes after the end of the data (footer, end magic) carry nothing.
            assert!(failed || end > bytes.len() - 46, "{name}: {end} bytes were taken for a whole recording");
        }
    }
}

#[test]
fn no_changed_byte_makes_a_reader_panic() {
    for (name, _) in FIXTURES {
        let bytes = std::fs::read(fixture(name)).unwrap();
        for place in 0..bytes.len().min(400) {
            for value in [0, 1, 0x7f, 0xff, bytes[place] ^ 0x20] {
                let mut changed = bytes.clone();
                changed[place] = value;
                let _ = decode_wav(&changed, &RecordDefaults::default());
                if *name != "mcap-zstd-of-zeros.mcap" {
                    McapReader::new(std::io::Cursor::new(changed)).take(20).for_each(drop);
                }
            }
        }
    }
}

#[test]
fn a_given_rate_replaces_one_of_zero() {
    let defaults = RecordDefaults { sample_rate_hz: Some(1000.0), ..RecordDefaults::default() };
    let file = RecordingFile::open(fixture("wav-zero-rate.wav"), defaults, None).unwrap();
    let records: Vec<_> = file.map(|recorded| recorded.unwrap().record).collect();
    assert_eq!(records[0].sample_rate_hz(), 1000.0);
}

#[test]
fn a_missing_channel_is_reported_with_those_there_are() {
    let channels = ["x".to_owned()];
    let opened =
        RecordingFile::open_channels(fixture("wav-int16.wav"), &channels, RecordDefaults::default(), None);
    let errors: Vec<String> = opened.unwrap().map(|item| item.unwrap_err().to_string()).collect();
    assert_eq!(errors, ["channel is \"x\", expected names of channels in the recording: 1"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_pipe_is_refused_with_what_to_do() {
    use std::io::Write;
    use std::os::fd::AsRawFd;
    let (reader, mut writer) = std::io::pipe().unwrap();
    writer.write_all(b"a\n1\n2\n").unwrap();
    drop(writer);
    let path = format!("/proc/self/fd/{}", reader.as_raw_fd());
    let error = RecordingFile::open(path, RecordDefaults::default(), None).err().unwrap().to_string();
    assert!(error.contains("a pipe cannot be read, expected a file"), "{error}");
}
