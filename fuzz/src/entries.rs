//! Fuzz entry points of all parsers of external data: nothing may panic, and accepted data must be valid.

use std::io::Cursor;
use std::str;

use flankwatch::asset::AssetSpec;
use flankwatch::estimate::{Alarm, AlarmReading, AlarmRule, MaintenanceEvent};
use flankwatch::gear::PairSpec;
use flankwatch::library::{BuildControl, GridSettings, build};
use flankwatch::recording::{
    BlockEncoding, CsvFrames, CsvLayout, CsvPreview, Cut, FlacFrames, Format, Frames, McapReader, NpyFrames,
    RawLayout, RawSample, RecordBlocks, RecordDefaults, RecordingError, WavFrames, decode_block, decode_csv,
    decode_flac, decode_mat, decode_npy, decode_raw, decode_wav,
};
use flankwatch::service::{RecordFormat, ReplayRequest};
use flankwatch::signal::Record;
use jiff::{SignedDuration, Timestamp};

/// A name, which is that of the fuzz target, and its function.
pub type Entry = (&'static str, fn(&[u8]));

/// All entry points.
pub const ALL: [Entry; 14] = [
    ("wav", wav),
    ("mcap", mcap),
    ("csv", csv),
    ("mat", mat),
    ("flac", flac),
    ("npy", npy),
    ("raw", raw),
    ("protobuf_block", protobuf_block),
    ("json_block", json_block),
    ("pair", pair),
    ("api_json", api_json),
    ("csv_upload", csv_upload),
    ("alarm_rule", alarm_rule),
    ("media_type", media_type),
];

/// Largest number of records or frames read from one input.
const MAX_ITEMS: usize = 1000;

/// A WAV recording, whole and cut into short records.
pub fn wav(bytes: &[u8]) {
    let defaults = RecordDefaults::default();
    for record in decode_wav(bytes, &defaults).into_iter().flatten() {
        check(&record);
    }
    check_cut(WavFrames::new(bytes, bytes.len() as u64), &defaults);
}

/// Reads a recording cut into short records.
fn check_cut<F: Frames>(frames: Result<F, RecordingError>, defaults: &RecordDefaults) {
    let blocks = frames.and_then(|frames| RecordBlocks::new(frames, defaults, Some(Cut::Samples(16))));
    for record in blocks.into_iter().flatten().take(MAX_ITEMS).flatten() {
        check(&record);
    }
}

/// An MCAP recording.
pub fn mcap(bytes: &[u8]) {
    let _ = Format::detect(bytes);
    for recorded in McapReader::new(Cursor::new(bytes.to_vec())).take(MAX_ITEMS).flatten() {
        check(&recorded.record);
    }
}

/// A MATLAB file.
pub fn mat(bytes: &[u8]) {
    let defaults = RecordDefaults { sample_rate_hz: Some(1000.0), ..RecordDefaults::default() };
    for record in decode_mat(bytes, &defaults).into_iter().flatten() {
        check(&record);
    }
}

/// A FLAC recording, whole and cut into short records.
pub fn flac(bytes: &[u8]) {
    for record in decode_flac(bytes, &RecordDefaults::default()).into_iter().flatten() {
        check(&record);
    }
    check_cut(FlacFrames::new(bytes), &RecordDefaults::default());
}

/// A NumPy array, whole and cut into short records.
pub fn npy(bytes: &[u8]) {
    let defaults = RecordDefaults { sample_rate_hz: Some(1000.0), ..RecordDefaults::default() };
    for record in decode_npy(bytes, &defaults).into_iter().flatten() {
        check(&record);
    }
    check_cut(NpyFrames::new(Cursor::new(bytes)), &defaults);
}

/// A CSV file.
pub fn csv(bytes: &[u8]) {
    let defaults = RecordDefaults { sample_rate_hz: Some(1000.0), ..RecordDefaults::default() };
    for record in decode_csv(bytes, CsvLayout::default(), &defaults).into_iter().flatten() {
        check(&record);
    }
    let _ = CsvPreview::of(bytes, CsvLayout::default(), 100);
    if let Ok(mut frames) = CsvFrames::new(bytes, &[]) {
        let mut frame = vec![0.0; frames.channels().len()];
        for _ in 0..MAX_ITEMS {
            if !matches!(frames.next_frame(&mut frame), Ok(true)) {
                break;
            }
        }
    }
}

/// Raw samples, with the layout chosen by the first two bytes.
pub fn raw(bytes: &[u8]) {
    let [first, second, samples @ ..] = bytes else {
        return;
    };
    let sample = if first % 2 == 0 { RawSample::F32 } else { RawSample::I16 };
    if let Ok(layout) = RawLayout::new(sample, 4000.0, u32::from(*second), None) {
        for record in decode_raw(samples, layout, &RecordDefaults::default()).into_iter().flatten() {
            check(&record);
        }
    }
}

/// One block in protobuf.
pub fn protobuf_block(bytes: &[u8]) {
    if let Ok(record) = decode_block(bytes, BlockEncoding::Protobuf, &RecordDefaults::default()) {
        check(&record);
    }
}

/// One block in JSON.
pub fn json_block(bytes: &[u8]) {
    if let Ok(record) = decode_block(bytes, BlockEncoding::Json, &RecordDefaults::default()) {
        check(&record);
    }
}

/// The description of a pair, in TOML or JSON. An accepted one has a library, here one of two short states.
pub fn pair(bytes: &[u8]) {
    let of_toml = str::from_utf8(bytes).ok().and_then(|text| PairSpec::from_toml(text).ok());
    for spec in of_toml.into_iter().chain(serde_json::from_slice(bytes).ok()) {
        if spec.check().is_ok() {
            let _ = spec.resolve();
            let grid = GridSettings { states: 2, seconds: 0.1, ..GridSettings::default() };
            let library = build(&spec, &grid.for_pair(&spec), &BuildControl::silent());
            assert_eq!(library.expect("an accepted pair has a library").states().len(), 2);
        }
    }
}

/// JSON bodies of the API other than records, and a description in TOML.
pub fn api_json(bytes: &[u8]) {
    let of_toml = str::from_utf8(bytes).ok().and_then(|text| AssetSpec::from_toml(text).ok());
    for spec in of_toml.into_iter().chain(serde_json::from_slice(bytes).ok()) {
        if spec.validate().is_ok() {
            assert!(spec.alarm_rules().iter().all(|rule| rule.validate().is_ok()));
            let context = spec.mesh_context();
            assert!(context.nominal_shaft_speed_hz.is_finite());
            let again = serde_json::to_vec(&spec).expect("an accepted description can be serialised");
            assert!(
                serde_json::from_slice::<AssetSpec>(&again).is_ok(),
                "a serialised description can be read back"
            );
        }
    }
    let _ = serde_json::from_slice::<ReplayRequest>(bytes);
    let _ = serde_json::from_slice::<MaintenanceEvent>(bytes);
}

/// A CSV upload whose query names columns, a rate and a scale, chosen by the first four bytes.
pub fn csv_upload(bytes: &[u8]) {
    let [time, first, second, values, text @ ..] = bytes else {
        return;
    };
    let columns: Vec<u16> = [*first, *second].into_iter().filter(|&n| n > 0).map(u16::from).collect();
    let time_column = (*time < 128).then_some(u16::from(*time));
    let rate_hz = (values % 2 == 0).then_some(1000.0);
    let Ok(mut layout) = CsvLayout::new(rate_hz, time_column, &columns) else {
        return;
    };
    layout.scale = [None, Some(-0.5), Some(1e300), Some(f64::MIN_POSITIVE)][usize::from(values / 2 % 4)];
    layout.sensitivity_mv_per_g = (values % 16 > 7).then_some(100.0);
    assert_eq!(CsvLayout::from_media_type(&layout.to_string()), Some(layout));
    for record in decode_csv(text, layout, &RecordDefaults::default()).into_iter().flatten() {
        check(&record);
    }
    let _ = CsvPreview::of(text, layout, 100);
}

/// The body of an alarm rule. An accepted one can be evaluated, and its alarm stored and read back.
pub fn alarm_rule(bytes: &[u8]) {
    let Ok(rule) = serde_json::from_slice::<AlarmRule>(bytes) else {
        return;
    };
    if rule.validate().is_err() {
        return;
    }
    let levels = [rule.warning, rule.danger, rule.warning_below, rule.danger_below];
    let values = levels.into_iter().flat_map(|level| {
        let level = level.unwrap_or_default();
        [Some(level), Some(2.0 * level + 1.0), None, Some(0.5 * level - 1.0), Some(f64::MAX)]
    });
    let (mut alarm, mut time) = (Alarm::default(), Timestamp::UNIX_EPOCH);
    for value in values.cycle().take(200) {
        time += SignedDuration::from_secs(3600);
        let changed = alarm.reading(&rule, AlarmReading { time, value }).is_some();
        assert!(!changed || alarm.last().is_some_and(|last| last.time == time));
    }
    let stored = serde_json::to_vec(&alarm).expect("an alarm can be serialised");
    let again: Alarm = serde_json::from_slice(&stored).expect("a serialised alarm can be read back");
    assert_eq!(again, alarm);
}

/// The media type that a record is stored with: it is written as it is read.
pub fn media_type(bytes: &[u8]) {
    let text = str::from_utf8(bytes).unwrap_or_default();
    if let Some(format) = RecordFormat::from_media_type(text) {
        let written = format.media_type();
        let again = RecordFormat::from_media_type(&written).expect("a written media type can be read");
        assert_eq!(again.media_type(), written);
    }
}

fn check(record: &Record) {
    assert!(!record.samples().is_empty() && record.samples().iter().all(|sample| sample.is_finite()));
    assert!(record.sample_rate_hz() > 0.0 && record.duration_s().is_finite());
}
