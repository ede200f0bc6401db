use std::collections::BTreeMap;

use super::*;

/// One channel of a file of `wav-edge`, or why the file is refused.
///
/// Values: `soundfile` (libsndfile) and `scipy.io.wavfile`, whose samples agree in full scale where both read
/// a file; for 24 bits at the bottom of 4 bytes, on which they do not agree, those that the file's origin
/// (hound's tests) states.
#[derive(Debug, Clone, serde::Deserialize)]
struct Expected {
    file: String,
    sample_rate_hz: Option<f64>,
    samples: Option<usize>,
    first: Option<f64>,
    last: Option<f64>,
    mean_magnitude: Option<f64>,
    refused: Option<String>,
}

/// The expected channels of every file.
fn wav_edge() -> BTreeMap<String, Vec<Expected>> {
    let table = fixtures().join("wav_edge.csv");
    let mut files: BTreeMap<String, Vec<Expected>> = BTreeMap::new();
    for row in ::csv::Reader::from_path(table).unwrap().deserialize() {
        let expected: Expected = row.unwrap();
        files.entry(expected.file.clone()).or_default().push(expected);
    }
    files
}

#[test]
#[ignore = "needs the folder of real recordings"]
fn every_wav_that_breaks_readers_is_read_right_or_refused() {
    let folder = recordings("wav-edge");
    let files = wav_edge();
    for (name, channels) in &files {
        let items = read_all(&folder.join(name), None);
        assert_eq!(items.len(), channels.len(), "{name}: {items:?}");
        for (item, expected) in items.iter().zip(channels) {
            if let Some(part) = &expected.refused {
                let error = item.as_ref().unwrap_err();
                assert!(error.contains(part), "{name}: {error}");
                continue;
            }
            let record = &item.as_ref().unwrap().record;
            assert_eq!(Some(record.sample_rate_hz()), expected.sample_rate_hz, "{name}");
            assert_eq!(Some(record.samples().len()), expected.samples, "{name}");
            let samples: Vec<f64> = record.samples().iter().map(|&x| f64::from(x)).collect();
            let mean = samples.iter().map(|x| x.abs()).sum::<f64>() / samples.len() as f64;
            for (value, expected) in [
                (samples[0], expected.first),
                (samples[samples.len() - 1], expected.last),
                (mean, expected.mean_magnitude),
            ] {
                let expected = expected.unwrap();
                // Half a step of an f32, which a sample is rounded to.
                assert!(
                    (value - expected).abs() <= 6e-8 * expected.abs(),
                    "{name}: {value} is not {expected}"
                );
            }
        }
    }
    let mut there = Vec::new();
    for part in ["hound/testsamples", "hound/testsamples/fuzz", "scipy"] {
        for entry in std::fs::read_dir(folder.join(part)).unwrap() {
            there.extend(
                Some(entry.unwrap().path()).filter(|path| path.extension().is_some_and(|e| e == "wav")),
            );
        }
    }
    assert_eq!(there.len(), files.len(), "a file of wav-edge is not in the table");
}

/// What hound reads of little-endian RIFF is what we read.
#[test]
#[ignore = "needs the folder of real recordings"]
fn hound_reads_the_same_samples() {
    let folder = recordings("wav-edge");
    let mut compared = 0;
    for (name, channels) in &wav_edge() {
        if channels[0].refused.is_some() {
            continue;
        }
        let Ok(reader) = hound::WavReader::open(folder.join(name)) else {
            continue;
        };
        let spec = reader.spec();
        let scale = match spec.sample_format {
            hound::SampleFormat::Int => 2_f64.powi(1 - i32::from(spec.bits_per_sample)),
            hound::SampleFormat::Float => 1.0,
        };
        let theirs: Result<Vec<f64>, hound::Error> = match spec.sample_format {
            hound::SampleFormat::Int => {
                reader.into_samples::<i32>().map(|s| Ok(f64::from(s?) * scale)).collect()
            }
            hound::SampleFormat::Float => reader.into_samples::<f32>().map(|s| Ok(f64::from(s?))).collect(),
        };
        // Some layouts (more than 32 bits) it opens and then cannot read.
        let Ok(theirs) = theirs else { continue };
        let ours = records(&folder.join(name));
        for (k, value) in theirs.iter().enumerate() {
            let sample = ours[k % ours.len()].samples()[k / ours.len()];
            assert_eq!(sample, *value as f32, "{name}: value {k}");
        }
        compared += 1;
    }
    assert!(compared >= 15, "only {compared} files compared");
}

#[test]
#[ignore = "needs the folder of real recordings"]
fn recordings_without_vibration_are_refused_with_what_is_in_them() {
    let folder = recordings("mcap-rosbag2");
    let mut files = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "mcap") {
            continue;
        }
        files += 1;
        let items = read_all(&path, None);
        let error = items[0].as_ref().unwrap_err();
        assert_eq!(items.len(), 1, "{path:?}: {items:?}");
        assert!(
            error.contains("no vibration found")
                && (error.contains("(cdr, ") || error.contains("(wrong_format, ")),
            "{path:?}: {error}"
        );
    }
    assert_eq!(files, 18);
    let talker = read_all(&folder.join("talker.mcap"), None).remove(0).unwrap_err();
    assert!(talker.contains("/topic (cdr, std_msgs/msg/String)"), "{talker}");
}

#[test]
#[ignore = "needs the folder of real recordings"]
fn a_bearing_run_to_failure_is_cut_into_its_records() {
    let folder = recordings("bearing-femto-1_1");
    let path = folder.join("horizontal-2803x2560-25600Hz.wav");
    let levels: Vec<f64> = read_all(&path, Some(Cut::Samples(2560)))
        .into_iter()
        .map(|item| {
            let samples = item.unwrap().record.samples().to_vec();
            assert_eq!(samples.len(), 2560);
            (samples.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / 2560.0).sqrt()
        })
        .collect();
    assert_eq!(levels.len(), 2803);
    // Medians over the records of the first and the last tenth, from soundfile and NumPy
    // (`sqrt(mean(x**2, axis=1))`).
    for (part, expected) in [(&levels[..280], 0.384_101_32), (&levels[2803 - 280..], 1.415_991_42)] {
        let mut sorted = part.to_vec();
        sorted.sort_by(f64::total_cmp);
        let median = (sorted[139] + sorted[140]) / 2.0;
        assert!((median - expected).abs() < 1e-7, "{median}");
    }
}
