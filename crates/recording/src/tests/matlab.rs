//! MATLAB files written by SciPy: `fixtures/matlab`, described in its README.

use std::path::PathBuf;

use crate::{Cut, RecordDefaults, RecordingFile, decode_mat};
use flankwatch_signal::Record;

fn path(name: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/matlab")).join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(path(name)).unwrap()
}

fn count(channel: usize, sample: usize) -> f64 {
    ((37 * sample + 11 * channel) % 201) as f64 - 100.0
}

/// Whether these are the samples of a channel, a count being worth `unit`.
fn assert_samples(record: &Record, channel: usize, samples: usize, unit: f64) {
    let expected: Vec<f32> = (0..samples).map(|k| (count(channel, k) * unit) as f32).collect();
    assert_eq!(record.samples(), expected, "channel {channel}");
}

/// The records of a file by its path and by its bytes, which have to be the same.
fn read(name: &str, rate_hz: Option<f64>) -> Vec<Record> {
    let defaults = RecordDefaults { sample_rate_hz: rate_hz, ..RecordDefaults::default() };
    let whole = decode_mat(&bytes(name), &defaults).unwrap_or_else(|error| panic!("{name}: {error}"));
    let file = RecordingFile::open(path(name), defaults, None).unwrap();
    let by_path: Vec<Record> = file.map(|recorded| recorded.unwrap().record).collect();
    assert_eq!(by_path, whole, "{name}");
    whole
}

#[test]
fn matlab_files_of_scipy_are_read_sample_for_sample() {
    for (name, channels, samples, unit) in [
        ("compressed", &["a"][..], 3000, 0.125),
        ("single", &["a"], 100, 0.125),
        ("int16", &["a"], 100, 1.0),
        ("int32-interval", &["a"], 100, 1.0),
        ("int64", &["a"], 100, 1.0),
        ("rows-are-moments", &["data_1", "data_2", "data_3"], 100, 0.125),
        ("columns-are-moments", &["data_1", "data_2", "data_3"], 100, 0.125),
        ("times", &["a", "b"], 100, 0.125),
        ("struct", &["bearing.gs"], 100, 0.125),
        ("struct-in-struct", &["run.signals.in", "run.signals.out"], 100, 0.125),
        ("beside-other-things", &["a"], 100, 0.125),
    ] {
        let records = read(&format!("{name}.mat"), None);
        let names: Vec<&str> = records.iter().map(Record::channel).collect();
        assert_eq!(names, channels, "{name}");
        for (channel, record) in records.iter().enumerate() {
            assert_samples(record, channel, samples, unit);
            assert!((record.sample_rate_hz() / 12_800.0 - 1.0).abs() < 1e-9, "{name}");
        }
    }
}

#[test]
fn a_matlab_file_without_a_rate_needs_one() {
    let records = read("bearing-two-channels.mat", Some(12_000.0));
    assert_eq!(records.iter().map(Record::channel).collect::<Vec<_>>(), ["X097_DE_time", "X097_FE_time"]);
    assert_samples(&records[1], 1, 100, 0.125);
    let refusal =
        |name: &str, defaults: RecordDefaults| decode_mat(&bytes(name), &defaults).unwrap_err().to_string();
    let error = refusal("bearing-two-channels.mat", RecordDefaults::default());
    assert!(error.contains("the sampling rate is missing"), "{error}");
    let other = RecordDefaults { sample_rate_hz: Some(12_000.0), ..RecordDefaults::default() };
    let error = refusal("times.mat", other);
    assert!(error.contains("12000 Hz, expected 12800 Hz according to the times in the file"), "{error}");
}

#[test]
fn given_names_and_scale_override_those_of_the_file() {
    let defaults = RecordDefaults {
        channel: Some("drive end".to_owned()),
        scale: Some(0.5),
        unit: Some("g".to_owned()),
        ..RecordDefaults::default()
    };
    let record = decode_mat(&bytes("int16.mat"), &defaults).unwrap().remove(0);
    assert_eq!((record.channel(), record.unit()), ("drive end", "g"));
    assert_samples(&record, 0, 100, 0.5);
}

#[test]
fn a_file_is_cut_like_all_others() {
    let cut = Some(Cut::Samples(1000));
    let file = RecordingFile::open(path("compressed.mat"), RecordDefaults::default(), cut).unwrap();
    let lengths: Vec<usize> = file.map(|recorded| recorded.unwrap().record.samples().len()).collect();
    assert_eq!(lengths, [1000; 3]);
}

/// An uncompressed MATLAB file of columns of doubles, each with its name, array flags and matrix width.
fn mat(variables: &[(&str, u32, usize, &[f64])]) -> Vec<u8> {
    let element = |kind: u32, data: &[u8]| {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend_from_slice(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let mut file = bytes("int16.mat")[..128].to_vec();
    for (name, flags, columns, values) in variables {
        let shape = [(values.len() / columns) as u32, *columns as u32].map(u32::to_le_bytes).concat();
        let numbers: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let parts = [
            element(6, &[(flags | 6).to_le_bytes(), [0; 4]].concat()),
            element(5, &shape),
            element(1, name.as_bytes()),
            element(9, &numbers),
        ];
        file.extend(element(14, &parts.concat()));
    }
    file
}

#[test]
fn times_counters_and_truth_values_are_no_channels() {
    let acc: Vec<f64> = (0..40).map(|k| count(0, k)).collect();
    let milliseconds: Vec<f64> = (0..40).map(|k| 0.05 * f64::from(k)).collect();
    let truth: Vec<f64> = (0..40).map(|k| f64::from(k % 3 == 0)).collect();
    let file = mat(&[
        ("Fs", 0, 1, &[20_000.0]),
        ("t_ms", 0, 1, &milliseconds),
        ("acc", 0, 1, &acc),
        ("valid", 0x200, 1, &truth),
        ("both", 0, 2, &[&milliseconds[..], &acc].concat()),
    ]);
    let channels = |file: &[u8], defaults: &RecordDefaults| -> Vec<String> {
        decode_mat(file, defaults).unwrap().iter().map(|record| record.channel().to_owned()).collect()
    };
    let defaults = RecordDefaults::default();
    assert_eq!(channels(&file, &defaults), ["acc", "both_2"]);
    let every = RecordDefaults { every_series: true, ..RecordDefaults::default() };
    assert_eq!(channels(&file, &every), ["t_ms", "acc", "valid", "both_1", "both_2"]);
    // Samples that all rise are the samples.
    let rising = mat(&[("Fs", 0, 1, &[20_000.0]), ("ramp", 0, 1, &milliseconds)]);
    assert_eq!(channels(&rising, &defaults), ["ramp"]);
}

#[test]
fn unreadable_files_name_the_problem() {
    let refusal = |bytes: &[u8]| {
        let defaults = RecordDefaults { sample_rate_hz: Some(1000.0), ..RecordDefaults::default() };
        decode_mat(bytes, &defaults).unwrap_err().to_string()
    };
    let mat = bytes("int16.mat");
    for (damaged, words) in [
        (mat[..100].to_vec(), ["mat: header", "100 bytes long"]),
        (mat[..mat.len() - 20].to_vec(), ["mat: length", "are there"]),
        (mat[..mat.len() - 60].to_vec(), ["mat: end", "4 bytes of a variable"]),
        (mat[..128].to_vec(), ["mat: the list of variables is empty", "an array of real numbers"]),
        ([&mat[..126], b"XY", &mat[128..]].concat(), ["mat: byte order", "IM or MI"]),
    ] {
        let error = refusal(&damaged);
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
    // A variable whose header declares more numbers than are present.
    let mut longer = mat.clone();
    let shape = 128 + 8 + 16 + 8 + 4;
    longer[shape] = 200;
    let error = refusal(&longer);
    assert!(error.contains("mat: shape"), "{error}");
}

#[test]
fn unsupported_variables_are_named() {
    let acc: Vec<f64> = (0..40).map(|k| count(0, k)).collect();
    let file = mat(&[("Fs", 0, 1, &[20_000.0]), ("acc", 0x800, 1, &acc)]);
    let error = decode_mat(&file, &RecordDefaults::default()).unwrap_err().to_string();
    assert!(error.contains("variables is Fs, acc (complex)"), "{error}");
}

#[test]
fn a_rate_and_an_interval_must_agree() {
    let acc: Vec<f64> = (0..40).map(|k| count(0, k)).collect();
    let rate = |dt: f64, given: Option<f64>| {
        let file = mat(&[("fs", 0, 1, &[20_000.0]), ("dt", 0, 1, &[dt]), ("acc", 0, 1, &acc)]);
        let defaults = RecordDefaults { sample_rate_hz: given, ..RecordDefaults::default() };
        decode_mat(&file, &defaults)
            .map(|records| records[0].sample_rate_hz())
            .map_err(|error| error.to_string())
    };
    assert_eq!(rate(5e-5, None), Ok(20_000.0));
    assert_eq!(rate(1e-3, Some(1000.0)), Ok(1000.0));
    let error = rate(1e-3, None).unwrap_err();
    assert!(error.contains("20000 Hz by one variable and 1000 Hz by another, an interval"), "{error}");
}

/// A file of zeros inflates to a thousand times its size: more than an upload may take.
#[test]
fn excessive_inflation_is_rejected() {
    use std::io::Write;
    let mut zipped = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    let block = vec![0_u8; 1 << 20];
    for _ in 0..300 {
        zipped.write_all(&block).unwrap();
    }
    let zipped = zipped.finish().unwrap();
    let mut file = bytes("compressed.mat")[..128].to_vec();
    file.extend_from_slice(&15_u32.to_le_bytes());
    file.extend_from_slice(&(zipped.len() as u32).to_le_bytes());
    file.extend_from_slice(&zipped);
    let error = decode_mat(&file, &RecordDefaults::default()).unwrap_err().to_string();
    assert!(error.contains("expected at most 134217728 bytes: split the file into several"), "{error}");
}

#[test]
fn arbitrary_bytes_are_read_or_rejected() {
    let defaults = RecordDefaults { sample_rate_hz: Some(1000.0), ..RecordDefaults::default() };
    for name in ["struct-in-struct.mat", "compressed.mat", "int16.mat", "times.mat"] {
        let whole = bytes(name);
        for at in 0..whole.len() {
            if at % 7 == 0 {
                let _ = decode_mat(&whole[..at], &defaults);
            }
            for value in [0, 1, 0x7f, 0x80, 0xff] {
                let mut damaged = whole.clone();
                damaged[at] = value;
                let _ = decode_mat(&damaged, &defaults);
            }
        }
    }
}
