//! Arrays written by NumPy and CSV written by pandas: `fixtures/npy` and `fixtures/csv`, described in their
//! READMEs.

use crate::{CsvLayout, RecordDefaults, RecordingFile, decode_csv, decode_npy};
use flankwatch_signal::Record;
use flankwatch_test_support::fixtures;

const RATE_HZ: f64 = 12_800.0;

fn defaults(rate_hz: Option<f64>) -> RecordDefaults {
    RecordDefaults { sample_rate_hz: rate_hz, ..RecordDefaults::default() }
}

/// The records of a file by its path.
fn read(name: &str, rate_hz: Option<f64>) -> Vec<Record> {
    let file = RecordingFile::open(fixtures().join(name), defaults(rate_hz), None)
        .unwrap_or_else(|error| panic!("{name}: {error}"));
    file.map(|recorded| recorded.unwrap().record).collect()
}

/// Whether the records are the channels with these names, a count being worth `unit`.
fn assert_channels(file: &str, records: &[Record], names: &[&str], samples: usize, unit: f64) {
    assert_eq!(records.iter().map(Record::channel).collect::<Vec<_>>(), names, "{file}");
    for (channel, record) in records.iter().enumerate() {
        let count = |k: usize| ((37 * k + 11 * channel) % 201) as f64 - 100.0;
        let expected: Vec<f32> = (0..samples).map(|k| (count(k) * unit) as f32).collect();
        assert_eq!(record.samples(), expected, "{file}, channel {channel}");
    }
}

#[test]
fn arrays_of_numpy_are_read_sample_for_sample() {
    for (name, channels, samples, unit) in [
        ("float32", 1, 100, 0.125),
        ("float64", 1, 5000, 0.125),
        ("float64-big-endian", 1, 100, 0.125),
        ("int8", 1, 100, 1.0),
        ("int16-two-channels", 2, 100, 1.0),
        ("int16-big-endian", 1, 100, 1.0),
        ("int32", 1, 100, 1.0),
        ("int64", 1, 100, 1.0),
        ("float32-three-channels", 3, 100, 0.125),
        ("one-column", 1, 100, 0.125),
        ("float32-transposed", 3, 100, 0.125),
        ("float64-transposed-long", 2, 5000, 0.125),
        ("int16-big-endian-transposed", 2, 100, 1.0),
        ("version-2", 1, 100, 0.125),
        ("version-3", 1, 100, 0.125),
    ] {
        let file = format!("npy/{name}.npy");
        let records = read(&file, Some(RATE_HZ));
        assert_channels(&file, &records, &["1", "2", "3"][..channels], samples, unit);
        let bytes = std::fs::read(fixtures().join(&file)).unwrap();
        assert_eq!(decode_npy(&bytes, &defaults(Some(RATE_HZ))).unwrap(), records, "{name}");
    }
}

#[test]
fn tables_of_pandas_are_read_sample_for_sample() {
    for (name, channels, samples, rate_hz) in [
        ("comma.csv", &["a", "b"][..], 100, None),
        ("semicolon-decimal-comma.csv", &["a", "b"], 100, None),
        ("tab.csv", &["a", "b"], 100, None),
        ("space.csv", &["a", "b"], 100, None),
        ("quoted.csv", &["a, left", "b \"right\""], 100, None),
        ("no-header.csv", &["1", "2"], 100, None),
        ("compressed.csv.gz", &["a"], 5000, None),
        ("exponents.csv", &["a", "b"], 100, None),
        ("latin-1.csv", &["Größe", "Länge"], 100, None),
        ("byte-order-mark.csv", &["a", "b"], 100, None),
        ("times.csv", &["a", "b"], 100, Some(RATE_HZ)),
        ("dates.csv", &["a", "b"], 100, Some(100.0)),
    ] {
        let file = format!("csv/{name}");
        let given = rate_hz.is_none().then_some(RATE_HZ);
        let records = read(&file, given);
        assert_channels(&file, &records, channels, samples, 0.125);
        let expected_hz = rate_hz.unwrap_or(RATE_HZ);
        assert!((records[0].sample_rate_hz() / expected_hz - 1.0).abs() < 1e-6, "{name}");
        if !name.ends_with(".gz") {
            let bytes = std::fs::read(fixtures().join(&file)).unwrap();
            assert_eq!(
                decode_csv(&bytes, CsvLayout::default(), &defaults(given)).unwrap(),
                records,
                "{name}"
            );
        }
    }
    assert_eq!(read("csv/dates.csv", None)[0].start_time().to_string(), "2026-03-01T08:00:00Z");
}
