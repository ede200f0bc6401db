//! FLAC recordings written by libsndfile: `fixtures/flac`, described in its README.

use std::path::PathBuf;

use crate::{Cut, FlacFrames, RecordBlocks, RecordDefaults, RecordingFile, decode_flac};
use flankwatch_signal::Record;

fn path(name: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/flac")).join(format!("{name}.flac"))
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(path(name)).unwrap()
}

/// A sample as a part of full scale.
fn sample(channel: usize, k: usize, bits: u32) -> f32 {
    let half = 1_i64 << (bits - 1);
    let count = k as i64 * (7919 + 2 * channel as i64) * half / 1000 % (2 * half) - half;
    count as f32 / half as f32
}

#[test]
fn recordings_of_libsndfile_are_read_sample_for_sample() {
    for (name, rate_hz, channels, bits, samples) in [
        ("mono-16", 20_000.0, 1, 16, 5000),
        ("stereo-16", 25_600.0, 2, 16, 3000),
        ("mono-24", 12_800.0, 1, 24, 3000),
        ("stereo-24", 51_200.0, 2, 24, 2000),
        ("mono-8", 8000.0, 1, 8, 3000),
        ("three-channels-24", 10_000.0, 3, 24, 1500),
        ("six-channels-16", 48_000.0, 6, 16, 1000),
        ("eight-channels-16", 4000.0, 8, 16, 800),
        ("one-sample", 1000.0, 1, 16, 1),
        ("shorter-than-a-block", 44_100.0, 2, 24, 100),
    ] {
        let file = RecordingFile::open(path(name), RecordDefaults::default(), None).unwrap();
        let records: Vec<Record> = file.map(|recorded| recorded.unwrap().record).collect();
        assert_eq!(records.len(), channels, "{name}");
        for (channel, record) in records.iter().enumerate() {
            assert_eq!((record.channel(), record.sample_rate_hz()), (&*(channel + 1).to_string(), rate_hz));
            let expected: Vec<f32> = (0..samples).map(|k| sample(channel, k, bits)).collect();
            assert_eq!(record.samples(), expected, "{name}, channel {channel}");
        }
    }
}

#[test]
fn a_recording_is_scaled_and_cut() {
    let defaults = RecordDefaults { scale: Some(50.0), unit: Some("g".into()), ..RecordDefaults::default() };
    let bytes = bytes("stereo-16");
    let frames = FlacFrames::new(&bytes[..]).unwrap();
    let blocks = RecordBlocks::new(frames, &defaults, Some(Cut::Samples(1000))).unwrap();
    let records: Vec<Record> = blocks.map(Result::unwrap).collect();
    assert_eq!(records.iter().map(|record| record.samples().len()).collect::<Vec<_>>(), [1000; 6]);
    let third = &records[5];
    assert_eq!((third.channel(), third.unit(), third.source_scale()), ("2", "g", Some(50.0)));
    assert_eq!(third.samples()[7], (f64::from(sample(1, 2007, 16)) * 50.0) as f32);
}

#[test]
fn damaged_or_truncated_recordings_are_rejected() {
    let read = |bytes: &[u8]| -> Result<Vec<Record>, String> {
        let blocks = RecordBlocks::whole(
            FlacFrames::new(bytes).map_err(|error| error.to_string())?,
            &RecordDefaults::default(),
        );
        blocks.and_then(Iterator::collect).map_err(|error| error.to_string())
    };
    let whole = bytes("mono-16");
    assert_eq!(read(&whole).unwrap()[0].samples().len(), 5000);
    let cut_off = read(&whole[..whole.len() / 2]).unwrap_err();
    assert!(cut_off.starts_with("flac"), "{cut_off}");
    let mut damaged = whole.clone();
    damaged[5000] ^= 1;
    let damaged = read(&damaged).unwrap_err();
    assert!(damaged.starts_with("flac: damaged ("), "{damaged}");
    for end in 0..whole.len().min(300) {
        assert!(read(&whole[..end]).is_err(), "{end} bytes");
    }
}

#[test]
fn frames_beyond_the_declared_length_are_an_error() {
    let mut bytes = bytes("mono-16");
    // The number of frames in the stream information: 36 bits.
    bytes[21] &= 0xf0;
    bytes[22..26].copy_from_slice(&[0, 0, 0, 1]);
    let error = decode_flac(&bytes, &RecordDefaults::default()).unwrap_err().to_string();
    let start = "flac: length is 1 frames, but at least ";
    assert!(
        error.starts_with(start) && error.ends_with("expected as many frames as the file holds"),
        "{error}"
    );
    let frames = FlacFrames::new(&bytes[..]).unwrap();
    let items: Vec<_> = RecordBlocks::whole(frames, &RecordDefaults::default()).unwrap().collect();
    assert_eq!(items.len(), 1, "the error ends the recording");
}
