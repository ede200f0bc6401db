//! Columns of CSV files: their units, and times and counters among them.

use crate::{ColumnRole, CsvLayout, CsvPreview, RecordDefaults, decode_csv};
use flankwatch_signal::Record;

fn read(text: &str, defaults: &RecordDefaults) -> Result<Vec<Record>, String> {
    decode_csv(text.as_bytes(), CsvLayout::default(), defaults).map_err(|error| error.to_string())
}

fn at_rate(sample_rate_hz: f64) -> RecordDefaults {
    RecordDefaults { sample_rate_hz: Some(sample_rate_hz), ..RecordDefaults::default() }
}

fn names(records: &[Record]) -> Vec<&str> {
    records.iter().map(Record::channel).collect()
}

#[test]
fn a_sensitivity_converts_the_stated_unit_to_g() {
    let defaults = RecordDefaults { scale: Some(2.0), sensitivity_mv_per_g: Some(100.0), ..at_rate(10.0) };
    for (header, factor) in
        [("a", 20.0), ("a [V]", 20.0), ("a [1]", 20.0), ("a [mV]", 0.02), ("a (mV)", 0.02)]
    {
        let record = read(&format!("{header}\n1\n-3\n"), &defaults).unwrap().remove(0);
        assert_eq!((record.unit(), record.source_scale()), ("g", Some(factor)), "{header}");
        assert_eq!(record.samples(), [factor as f32, (-3.0 * factor) as f32], "{header}");
    }
    for (header, unit) in [("acc (g)", "g"), ("acc [m/s²]", "m/s2"), ("acc [counts]", "counts")] {
        let error = read(&format!("{header}\n1\n2\n"), &defaults).unwrap_err();
        let expected = format!("is in {unit:?}, expected V, mV or no unit: a sensitivity in mV/g is given");
        assert!(error.contains(&expected), "{error}");
    }
    // The layout of an upload has it too.
    let mut layout = CsvLayout::default();
    layout.sensitivity_mv_per_g = Some(10.0);
    let record = decode_csv(b"a [mV]\n1\n2\n", layout, &at_rate(10.0)).unwrap().remove(0);
    assert_eq!((record.unit(), record.samples()), ("g", &[0.1, 0.2][..]));
}

#[test]
fn a_stated_unit_is_never_replaced_by_the_default() {
    let defaults = RecordDefaults { unit: Some("m/s2".to_owned()), ..at_rate(10.0) };
    for (header, name, unit) in [
        ("vel [in/s]", "vel", "in/s"),
        ("vel [furlong/s]", "vel [furlong/s]", "furlong/s"),
        ("vel\n[furlong/s]", "vel", "furlong/s"),
        ("acc", "acc", "m/s2"),
        ("Motor (V)", "Motor (V)", "m/s2"),
        ("Acc (1)", "Acc (1)", "m/s2"),
        ("Acc [2]", "Acc [2]", "m/s2"),
    ] {
        let record = read(&format!("{header}\n1\n-3\n"), &defaults).unwrap().remove(0);
        assert_eq!((record.channel(), record.unit()), (name, unit), "{header}");
    }
}

#[test]
fn coarse_times_give_a_rate_only_if_they_are_long_enough() {
    let stamped =
        |lines: u32| -> String { (0..lines).map(|k| format!("{},{}\n", k / 20, k % 7)).collect::<String>() };
    let text = |lines| format!("time (ms),a\n{}", stamped(lines));
    let record = read(&text(4000), &RecordDefaults::default()).unwrap().remove(0);
    assert!((record.sample_rate_hz() / 20_000.0 - 1.0).abs() < 1e-4, "{}", record.sample_rate_hz());
    let error = read(&text(100), &RecordDefaults::default()).unwrap_err();
    assert!(error.starts_with("the sampling rate is 2"), "{error}");
    assert!(
        error.contains("% by the times in the file, expected times that give it within 0.1 %"),
        "{error}"
    );
    assert!(error.ends_with("or a rate given with the file"), "{error}");
    assert_eq!(read(&text(100), &at_rate(20_000.0)).unwrap()[0].sample_rate_hz(), 20_000.0);
    assert!(read(&text(4000), &at_rate(20_100.0)).unwrap_err().contains("the sampling rate is 20100 Hz"));
}

#[test]
fn counters_beside_a_time_column_are_no_channels() {
    let text: String = (0..9).map(|k| format!("{k},{}.{k},{},{}\n", k / 10, k * 3 % 7, 1000 * k)).collect();
    let text = format!("index,time,acc,t_us\n{text}");
    let records = read(&text, &RecordDefaults::default()).unwrap();
    assert_eq!((names(&records), records[0].sample_rate_hz()), (vec!["acc"], 10.0));
    let preview = CsvPreview::of(text.as_bytes(), CsvLayout::default(), 3).unwrap();
    let roles: Vec<ColumnRole> = preview.columns.iter().map(|column| column.role).collect();
    use ColumnRole::{Channel, Ignored, Time};
    assert_eq!(roles, [Ignored, Time, Channel, Ignored]);
    assert_eq!(preview.contents.unwrap().envelopes, [[[0.0, 6.0], [1.0, 5.0], [0.0, 4.0]]]);
    // Columns that are given by number are read as they are, and so is everything on demand.
    let layout = CsvLayout::new(None, Some(2), &[1, 3]).unwrap();
    let records = decode_csv(text.as_bytes(), layout, &RecordDefaults::default()).unwrap();
    assert_eq!(names(&records), ["index", "acc"]);
    let every =
        RecordDefaults { every_series: true, unit: Some("g".to_owned()), ..RecordDefaults::default() };
    let records = read(&text.replace("acc", "acc [m/s2]"), &every).unwrap();
    assert_eq!((names(&records), records[1].unit()), (vec!["index", "acc", "t_us"], "g"));
    // Without a time column, a counter may be the time.
    let error = read("acc,n\n3,1\n1,2\n4,3\n1,4\n", &at_rate(10.0)).unwrap_err();
    assert_eq!(
        error,
        "csv line 1: column \"n\" rises by the same step from line to line, like a time: name it time, or do \
         not select it"
    );
    // Samples that all rise are the samples.
    let records = read("t,a\n0,1\n1,2\n2,3\n3,4\n4,5\n", &RecordDefaults::default()).unwrap();
    assert_eq!(names(&records), ["a"]);
}

#[test]
fn a_rate_directly_above_the_samples_is_no_name() {
    for line in ["Sample rate: 20000", "fs=20000", "# fs = 20 kHz", "SampleRate;20000"] {
        let record = read(&format!("{line}\n1.5\n-2\n0\n"), &RecordDefaults::default()).unwrap().remove(0);
        assert_eq!((record.channel(), record.sample_rate_hz()), ("1", 20_000.0), "{line}");
        assert_eq!(record.samples(), [1.5, -2.0, 0.0]);
    }
    let records = read("Sample rate;20000\n1.5;2\n-2;7\n", &RecordDefaults::default()).unwrap();
    assert_eq!((names(&records), records[1].sample_rate_hz()), (vec!["1", "2"], 20_000.0));
}
