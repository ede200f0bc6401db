use super::*;

/// Rate, frames and first and last value of every channel; or part of the error.
enum Expected {
    Read(f64, usize, &'static [[f64; 2]]),
    Refused(&'static str),
}

use Expected::{Read, Refused};

const FLOAT_TONE: &[[f64; 2]] = &[[0.0, 0.50985146], [0.0, 0.50985146]];
const FIVE_24_BIT: &[[f64; 2]] = &[[-1.0, 1.0], [-1.0, 1.0], [-2.384_185_8e-7, 2.384_185_8e-7]];
const FIVE_WIDE: &[[f64; 2]] = &[[-1.0, 1.0], [-1.0, 1.0], [0.0, 0.0]];
const SMALL_16_BIT: &[[f64; 2]] = &[[2.0 / 32_768.0, -7.0 / 32_768.0]];
const FLOAT_RAW: &[[f64; 2]] = &[[2.0, 1019.0]];
const PCM_4_BYTES: &[[f64; 2]] = &[[0.004_441_56, -0.098_833_32]];
const WIDE_32_BIT: &[[f64; 2]] = &[[8.847_564_46e-9, 0.015_640_24], [-1.068_101_26e-4, -0.999_999_93]];
const RIGHT_24_IN_4: &[[f64; 2]] = &[
    [-96.0 / 8_388_608.0, 8_388_607.0 / 8_388_608.0],
    [23_052.0 / 8_388_608.0, -8_360_672.0 / 8_388_608.0],
];

/// Expected values: `soundfile` 0.13 (libsndfile) and `scipy.io.wavfile`, which agree where both read a file, scaled to full scale; for 24 bits at the
/// bottom of 4 bytes, on which they do not agree, the values that the file's origin (hound's tests) states.
const WAV_EDGE: &[(&str, Expected)] = &[
    (
        "hound/testsamples/fuzz/crash-24728523ef4be15c838293b676f6853e73723bf4.wav",
        Refused("ends in the fmt chunk"),
    ),
    (
        "hound/testsamples/fuzz/crash-b8447179832529c48f9c6bf17feab6337bbc78ea.wav",
        Refused("ends in the fmt chunk"),
    ),
    (
        "hound/testsamples/fuzz/crash-cbd757427cea12bd8a21f86cd8cf74d98ce56bee.wav",
        Refused("ends in the fmt chunk"),
    ),
    (
        "hound/testsamples/fuzz/crash-e5471f5b58397287b509db7d026e95f1724454f5.wav",
        Refused("block align is 0 bytes"),
    ),
    (
        "hound/testsamples/fuzz/crash-e879de4eb4d206c59e21f0e01def16457af80fdc.wav",
        Refused("ends in a chunk header"),
    ),
    (
        "hound/testsamples/fuzz/oom-48ae4cd061ff8578ad3f23dc87624bd365cf5216.wav",
        Refused("ends in a chunk before the data"),
    ),
    ("hound/testsamples/nonstandard-01.wav", Read(48_000.0, 1, &[[0.0, 0.0], [0.0, 0.0]])),
    ("hound/testsamples/nonstandard-02.wav", Read(48_000.0, 2, WIDE_32_BIT)),
    (
        "hound/testsamples/pcmwaveformat-16bit-44100Hz-mono-extra.wav",
        Read(44_100.0, 4, SMALL_16_BIT),
    ),
    (
        "hound/testsamples/pcmwaveformat-16bit-44100Hz-mono.wav",
        Read(44_100.0, 4, SMALL_16_BIT),
    ),
    (
        "hound/testsamples/pcmwaveformat-24bit-4byte-48kHz-stereo.wav",
        Read(48_000.0, 2, RIGHT_24_IN_4),
    ),
    (
        "hound/testsamples/pcmwaveformat-8bit-44100Hz-mono.wav",
        Read(44_100.0, 4, &[[0.148_437_5, -0.992_187_5]]),
    ),
    ("hound/testsamples/pop.wav", Read(44_100.0, 100, &[[0.0, -0.076_843_26]])),
    (
        "hound/testsamples/waveformatex-16bit-44100Hz-mono-extra.wav",
        Read(44_100.0, 4, SMALL_16_BIT),
    ),
    (
        "hound/testsamples/waveformatex-16bit-44100Hz-mono.wav",
        Read(44_100.0, 4, SMALL_16_BIT),
    ),
    (
        "hound/testsamples/waveformatex-16bit-44100Hz-stereo.wav",
        Read(
            44_100.0,
            4,
            &[[2.0 / 32_768.0, 17.0 / 32_768.0], [-3.0 / 32_768.0, -19.0 / 32_768.0]],
        ),
    ),
    (
        "hound/testsamples/waveformatex-8bit-11025Hz-mono.wav",
        Read(11_025.0, 4, &[[-1.0, -1.0]]),
    ),
    (
        "hound/testsamples/waveformatex-ieeefloat-44100Hz-mono.wav",
        Read(44_100.0, 4, FLOAT_RAW),
    ),
    (
        "hound/testsamples/waveformatextensible-24bit-192kHz-mono.wav",
        Read(192_000.0, 4, &[[-2.026_557_92e-6, 0.996_091_01]]),
    ),
    (
        "hound/testsamples/waveformatextensible-24bit-4byte-48kHz-stereo.wav",
        Read(48_000.0, 2, RIGHT_24_IN_4),
    ),
    (
        "hound/testsamples/waveformatextensible-32bit-48kHz-stereo.wav",
        Read(48_000.0, 2, WIDE_32_BIT),
    ),
    (
        "hound/testsamples/waveformatextensible-ieeefloat-44100Hz-mono.wav",
        Read(44_100.0, 4, FLOAT_RAW),
    ),
    (
        "scipy/test-1234Hz-le-1ch-10S-20bit-extra.wav",
        Read(1234.0, 10, &[[0.999_998_09, -0.062_499_88]]),
    ),
    ("scipy/test-44100Hz-2ch-32bit-float-be.wav", Read(44_100.0, 441, FLOAT_TONE)),
    ("scipy/test-44100Hz-2ch-32bit-float-le.wav", Read(44_100.0, 441, FLOAT_TONE)),
    ("scipy/test-44100Hz-be-1ch-4bytes.wav", Read(44_100.0, 4410, PCM_4_BYTES)),
    (
        "scipy/test-44100Hz-le-1ch-4bytes-early-eof-no-data.wav",
        Refused("ends in a chunk header before the data chunk at byte 72"),
    ),
    (
        "scipy/test-44100Hz-le-1ch-4bytes-early-eof.wav",
        Refused("ends in the data chunk at byte 1024: 17640 bytes declared, 944 found"),
    ),
    (
        "scipy/test-44100Hz-le-1ch-4bytes-incomplete-chunk.wav",
        Refused("ends in a chunk header before the data chunk at byte 13"),
    ),
    ("scipy/test-44100Hz-le-1ch-4bytes-rf64.wav", Read(44_100.0, 4410, PCM_4_BYTES)),
    ("scipy/test-44100Hz-le-1ch-4bytes.wav", Read(44_100.0, 4410, PCM_4_BYTES)),
    (
        "scipy/test-48000Hz-2ch-64bit-float-le-wavex.wav",
        Read(48_000.0, 480, &[[0.0, 0.506_704_75], [0.0, 0.506_704_75]]),
    ),
    ("scipy/test-8000Hz-be-3ch-5S-24bit.wav", Read(8000.0, 5, FIVE_24_BIT)),
    ("scipy/test-8000Hz-le-1ch-1byte-ulaw.wav", Refused("format tag is 0x0007 (µ-law)")),
    (
        "scipy/test-8000Hz-le-2ch-1byteu.wav",
        Read(8000.0, 800, &[[0.062_5, -0.476_562_5], [0.062_5, -0.484_375]]),
    ),
    (
        "scipy/test-8000Hz-le-3ch-5S-24bit-inconsistent.wav",
        Refused("block align is 4 bytes with 3 channels of 24 bits"),
    ),
    ("scipy/test-8000Hz-le-3ch-5S-24bit-rf64.wav", Read(8000.0, 5, FIVE_24_BIT)),
    ("scipy/test-8000Hz-le-3ch-5S-24bit.wav", Read(8000.0, 5, FIVE_24_BIT)),
    ("scipy/test-8000Hz-le-3ch-5S-36bit.wav", Read(8000.0, 5, FIVE_WIDE)),
    ("scipy/test-8000Hz-le-3ch-5S-45bit.wav", Read(8000.0, 5, FIVE_WIDE)),
    ("scipy/test-8000Hz-le-3ch-5S-53bit.wav", Read(8000.0, 5, FIVE_WIDE)),
    ("scipy/test-8000Hz-le-3ch-5S-64bit.wav", Read(8000.0, 5, FIVE_WIDE)),
    ("scipy/test-8000Hz-le-4ch-9S-12bit.wav", Read(8000.0, 9, &[[0.0, 0.0]; 4])),
    ("scipy/test-8000Hz-le-5ch-9S-5bit.wav", Read(8000.0, 9, &[[0.0, 0.0]; 5])),
];

#[test]
fn every_wav_that_breaks_readers_is_read_right_or_refused() {
    let Some(folder) = data("wav-edge") else { return };
    for (name, expected) in WAV_EDGE {
        let items = read_all(&folder.join(name), None);
        match expected {
            Refused(part) => {
                let error = items.last().unwrap().as_ref().unwrap_err();
                assert!(items.len() == 1 && error.contains(part), "{name}: {error}");
            }
            Read(rate, frames, values) => {
                assert_eq!(items.len(), values.len(), "{name}");
                for (item, [first, last]) in items.iter().zip(*values) {
                    let record = &item.as_ref().unwrap().record;
                    assert_eq!((record.sample_rate_hz(), record.samples().len()), (*rate, *frames), "{name}");
                    // The expected values are printed with 7 to 9 digits.
                    for (sample, value) in [(record.samples()[0], first), (record.samples()[frames - 1], last)] {
                        assert!(
                            (f64::from(sample) - value).abs() <= 2e-7 * value.abs().max(0.1),
                            "{name}: {sample} is not {value}"
                        );
                    }
                }
            }
        }
    }
    let mut there = Vec::new();
    for part in ["hound/testsamples", "hound/testsamples/fuzz", "scipy"] {
        for entry in std::fs::read_dir(folder.join(part)).unwrap() {
            there.extend(Some(entry.unwrap().path()).filter(|path| path.extension().is_some_and(|e| e == "wav")));
        }
    }
    assert_eq!(there.len(), WAV_EDGE.len(), "a file of wav-edge is not in the table");
}

/// What hound reads of little-endian RIFF is what we read.
#[test]
fn hound_reads_the_same_samples() {
    let Some(folder) = data("wav-edge") else { return };
    let mut compared = 0;
    for (name, expected) in WAV_EDGE {
        let (Read(..), Ok(reader)) = (expected, hound::WavReader::open(folder.join(name))) else {
            continue;
        };
        let spec = reader.spec();
        let scale = match spec.sample_format {
            hound::SampleFormat::Int => 2_f64.powi(1 - i32::from(spec.bits_per_sample)),
            hound::SampleFormat::Float => 1.0,
        };
        let theirs: Result<Vec<f64>, hound::Error> = match spec.sample_format {
            hound::SampleFormat::Int => reader.into_samples::<i32>().map(|s| Ok(f64::from(s?) * scale)).collect(),
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
fn recordings_without_vibration_are_refused_with_what_is_in_them() {
    let Some(folder) = data("mcap-rosbag2") else { return };
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
            error.contains("no vibration in it") && (error.contains("(cdr, ") || error.contains("(wrong_format, ")),
            "{path:?}: {error}"
        );
    }
    assert_eq!(files, 18);
    let talker = read_all(&folder.join("talker.mcap"), None).remove(0).unwrap_err();
    assert!(talker.contains("/topic (cdr, std_msgs/msg/String)"), "{talker}");
}

#[test]
fn a_bearing_run_to_failure_is_cut_into_its_records() {
    let Some(folder) = data("bearing-femto-1_1") else { return };
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
    // Medians over the records of the first and the last tenth, from soundfile and NumPy (`sqrt(mean(x**2, axis=1))`).
    for (part, expected) in [(&levels[..280], 0.384_101_32), (&levels[2803 - 280..], 1.415_991_42)] {
        let mut sorted = part.to_vec();
        sorted.sort_by(f64::total_cmp);
        let median = (sorted[139] + sorted[140]) / 2.0;
        assert!((median - expected).abs() < 1e-7, "{median}");
    }
}
