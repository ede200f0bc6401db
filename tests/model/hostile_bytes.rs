//! The fuzz targets on a stable toolchain: inputs that once failed, and damaged inputs of every kind, the
//! same in every run.

use std::collections::BTreeSet;
use std::fs;
use std::io::Cursor;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flankwatch::recording::{BlockEncoding, McapOptions, McapWriter, WavWriter, encode_block};
use flankwatch::signal::{OperatingPoint, Record};
use jiff::Timestamp;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[allow(unreachable_pub, reason = "the programs of `fuzz` call them")]
#[path = "../../fuzz/src/entries.rs"]
mod entries;

/// Damaged inputs of each kind in every run.
const INPUTS: u64 = 400;

/// Values that replace a number in a damaged input.
const NUMBERS: [&str; 8] = ["1e308", "-1", "0", "1e-320", "18446744073709551616", "nan", "[]", "\"\""];

#[test]
fn fuzz_regressions_do_not_recur() {
    for (name, entry) in entries::ALL {
        let Ok(kept) = fs::read_dir(fuzz().join("regressions").join(name)) else {
            continue;
        };
        for file in kept {
            entry(&fs::read(file.unwrap().path()).unwrap());
        }
    }
}

/// Passes damaged inputs to an entry: the same ones in every run, and further ones until a time has passed.
fn damage((name, entry): &entries::Entry, time: Duration) {
    let whole = whole(name);
    whole.iter().for_each(|bytes| entry(bytes));
    let began = Instant::now();
    for seed in 0.. {
        if seed >= INPUTS && began.elapsed() >= time {
            return println!("{name}: {seed} inputs");
        }
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let bytes = damaged(whole.choose(&mut random).unwrap(), &mut random);
        if catch_unwind(|| entry(&bytes)).is_err() {
            let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{seed}"));
            fs::write(&path, &bytes).unwrap();
            panic!("{name} panics at {}: keep it in fuzz/regressions/{name}", path.display());
        }
    }
}

#[test]
fn damaged_inputs_never_panic() {
    let time = std::env::var("FLANKWATCH_FUZZ_SECONDS").map_or(0, |seconds| seconds.parse().unwrap());
    std::thread::scope(|scope| {
        for entry in &entries::ALL {
            scope.spawn(move || damage(entry, Duration::from_secs(time)));
        }
    });
}

#[test]
fn every_entry_has_a_fuzz_target() {
    let manifest: toml::Table = fs::read_to_string(fuzz().join("Cargo.toml")).unwrap().parse().unwrap();
    let programs = manifest["bin"].as_array().unwrap();
    let programs: BTreeSet<&str> = programs.iter().map(|program| program["name"].as_str().unwrap()).collect();
    let entries: BTreeSet<&str> = entries::ALL.iter().map(|(name, _)| *name).collect();
    assert_eq!(programs, entries);
    for name in programs {
        let text = fs::read_to_string(fuzz().join(format!("fuzz_targets/{name}.rs"))).unwrap();
        assert!(text.contains(&format!("entries::{name}(")), "{name}");
    }
}

fn fuzz() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz")
}

/// Valid inputs of a kind.
fn whole(name: &str) -> Vec<Vec<u8>> {
    let record = || {
        let samples = (0..64).map(|k| (k as f32).sin()).collect();
        let point = OperatingPoint { shaft_speed_hz: Some(29.7), ..OperatingPoint::default() };
        let record =
            Record::new("in", Timestamp::from_second(1_767_225_600).unwrap(), 1000.0, "m/s2", samples);
        record.unwrap().with_operating_point(point).unwrap()
    };
    let pair = || fs::read(fuzz().join("../fixtures/pairs/shen2022.toml")).unwrap();
    match name {
        "wav" => {
            let mut bytes = Cursor::new(Vec::new());
            let mut writer = WavWriter::new(&mut bytes, 2, 1000.0).unwrap();
            (0..64).for_each(|k| writer.write_frame(&[k as f32, -1.0]).unwrap());
            writer.finish().unwrap();
            vec![bytes.into_inner()]
        }
        "mcap" => {
            let mut writer = McapWriter::new(Cursor::new(Vec::new()), McapOptions::default()).unwrap();
            writer.write("/pump/in/waveform", &record()).unwrap();
            vec![writer.finish().unwrap().into_inner()]
        }
        "mat" => ["int16", "struct-in-struct", "compressed"]
            .map(|name| fs::read(fuzz().join(format!("../fixtures/matlab/{name}.mat"))).unwrap())
            .to_vec(),
        "flac" => ["one-sample", "shorter-than-a-block", "mono-8"]
            .map(|name| fs::read(fuzz().join(format!("../fixtures/flac/{name}.flac"))).unwrap())
            .to_vec(),
        "npy" => {
            let text = "{'descr': '<f4', 'fortran_order': False, 'shape': (4, 2), }\n";
            let length = (text.len() as u16).to_le_bytes();
            let by_row = [b"\x93NUMPY\x01\0", &length[..], text.as_bytes(), &[1; 32]].concat();
            vec![by_row, fs::read(fuzz().join("../fixtures/npy/int16-big-endian-transposed.npy")).unwrap()]
        }
        "csv" => vec![b"time;x\n0,1;-2,5e3\n0,2;1\n".to_vec(), b"1.0,2.0\n3.0,4.0\n".to_vec()],
        "raw" => vec![[&[0, 2][..], &[1; 64]].concat(), [&[1, 3][..], &[7; 60]].concat()],
        "protobuf_block" => vec![encode_block(&record(), BlockEncoding::Protobuf)],
        "json_block" => vec![encode_block(&record(), BlockEncoding::Json)],
        "pair" => vec![pair()],
        "api_json" => vec![
            br#"{"id": "a", "name": "b", "gear": {"teeth": [24, 36], "shaft_speed_hz": 16.6, "shaft_ratio": [2, 3]},
                 "sensor": {"unit": "g"}, "baseline": {"records": 20}, "limits": {"warning_um": 100, "danger_um": 200},
                 "alarms": [{"quantity": {"rate_per_day": "wear_um"}, "warning": 4, "over_s": 3600}, {"quantity": "stale_s", "danger": 60}],
                 "operating_bins": [{"name": "c", "torque_nm": [1, 2]}], "envelope_band_hz": [1, 2],
                 "points": [{"channel": "d", "calibration_due": "2026-01-31", "sensitivity": 10}],
                 "bands": [{"name": "low", "band_hz": [10, 1000], "quantity": "velocity"}]}"#
                .to_vec(),
            br#"{"asset": "a", "file": "f.mcap", "pace": "10x"}"#.to_vec(),
            br#"{"time": "2026-03-01T08:00:00Z", "kind": "inspected", "by": "Ada", "inspection": {"depth_um": 60}}"#.to_vec(),
            b"id = \"a\"\n[gear]\nteeth = [24, 26]\nshaft_speed_hz = 16.6\n".to_vec(),
        ],
        "csv_upload" => ["\0\x01\0\0", "\x01\x02\x03\x02", "\x02\x01\0\x05", "\u{7f}\0\0\x04"]
            .map(|layout| [layout, "t;a;b\n0,001;0,5;-2\n0,002;1e3;4\n0,003;1;0\n"].concat().into_bytes())
            .to_vec(),
        "alarm_rule" => [
            r#"{"quantity": "wear_um", "warning": 100, "danger": 200, "hysteresis": 10}"#,
            r#"{"quantity": {"rate_per_day": "wear_um"}, "danger": 4, "over_s": 36000}"#,
            r#"{"quantity": {"indicator": "rms"}, "warning": 1e3, "danger_below": -1e3,
                "settings": {"raise": 1, "raise_of": 1, "clear": 2, "clear_of": 3}}"#,
            r#"{"quantity": "sensor_fault", "danger": 0.5}"#,
        ]
        .map(|text| text.as_bytes().to_vec())
        .to_vec(),
        "media_type" => [
            "audio/wav;scale=50; unit=g",
            "application/x-npy;rate=12800;scale=0.5",
            "application/octet-stream;sample=i16;rate=4000;channels=2;scale=0.001",
            "text/csv;rate=1000;scale=-0.5;time=1;columns=2,3",
            "application/x-protobuf",
        ]
        .map(|text| text.as_bytes().to_vec())
        .to_vec(),
        other => panic!("no whole input for {other}"),
    }
}

/// Applies up to eight kinds of damage to an input.
fn damaged(whole: &[u8], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    for _ in 0..random.random_range(1..=8) {
        let at = random.random_range(0..=bytes.len());
        match random.random_range(0..7) {
            0 => bytes.truncate(at),
            1 => bytes.insert(at, random.random()),
            2 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1_u8 << random.random_range(0..8_u32);
                }
            }
            3 => {
                // An excessive length or count, or 0.
                let value = *[0, 1, u32::MAX, i32::MAX as u32, 0x8000_0000].choose(random).unwrap();
                let end = (at + 4).min(bytes.len());
                bytes.splice(at..end, value.to_le_bytes());
            }
            4 => {
                let end = random.random_range(at..=bytes.len().min(at + 64));
                let copied = bytes[at..end].to_vec();
                bytes.splice(at..at, copied);
            }
            5 => {
                let end = random.random_range(at..=bytes.len().min(at + 16));
                bytes.drain(at..end);
            }
            _ => {
                // The number at or after this position.
                let Some(start) = (at..bytes.len()).find(|&n| bytes[n].is_ascii_digit()) else {
                    continue;
                };
                let length =
                    bytes[start..].iter().take_while(|byte| byte.is_ascii_digit() || **byte == b'.').count();
                let number = *NUMBERS.choose(random).unwrap();
                bytes.splice(start..start + length, number.bytes());
            }
        }
    }
    bytes
}
