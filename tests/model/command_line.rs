//! The commands, run as a user runs them.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;
use tempfile::TempDir;

use crate::command::flankwatch;

pub(super) fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).display().to_string()
}

fn wav(path: &str, channels: &[&[f32]]) {
    let spec = hound::WavSpec {
        channels: channels.len() as u16,
        sample_rate: 8000,
        bits_per_sample: 32,
        sample_format: hound::SampleFormat::Float,
    };
    let mut writer = hound::WavWriter::create(path, spec).unwrap();
    for k in 0..channels[0].len() {
        for channel in channels {
            writer.write_sample(channel[k]).unwrap();
        }
    }
    writer.finalize().unwrap();
}

pub(super) fn analyze(words: &[&str]) -> Vec<Value> {
    let output = flankwatch(&[&["analyze", "--format", "json"], words].concat()).expect_success();
    serde_json::from_str::<Value>(&output.out()).unwrap().as_array().unwrap().clone()
}

#[test]
fn analyze_reads_valid_files_and_rejects_others_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| path(&folder, name);
    wav(&at("one.wav"), &[&[0.5]]);
    wav(&at("stereo.wav"), &[&[1.0, -1.0, 1.0, -1.0], &[3.0, 3.0, 3.0, 3.0]]);
    wav(&at("nan.wav"), &[&[0.0, f32::NAN, 1.0]]);
    fs::write(at("empty.wav"), b"").unwrap();
    fs::write(at("broken.wav"), b"RIFF\x10\0\0\0WAVEjunk").unwrap();
    let whole = fs::read(at("stereo.wav")).unwrap();
    fs::write(at("truncated.wav"), &whole[..whole.len() - 9]).unwrap();
    fs::write(at("letter.txt"), b"dear reader").unwrap();
    fs::write(at("letter.wav"), b"dear reader").unwrap();

    let one = analyze(&[&at("one.wav")]);
    assert_eq!(
        (one.len(), &one[0]["samples"], &one[0]["indicators"]["rms"]),
        (1, &Value::from(1), &Value::from(0.5))
    );
    assert_eq!((&one[0]["wear"], &one[0]["absent"]["kurtosis"]), (&Value::Null, &Value::from("too_short")));
    assert!(one[0]["wear_reason"].as_str().unwrap().contains("--asset"));

    let stereo = analyze(&[&at("stereo.wav")]);
    assert_eq!(stereo.len(), 2);
    // Closed forms: a square wave has kurtosis 1; a constant has none.
    assert!((stereo[0]["indicators"]["kurtosis"].as_f64().unwrap() - 1.0).abs() < 1e-12);
    assert_eq!(
        (&stereo[1]["channel"], &stereo[1]["absent"]["kurtosis"]),
        (&Value::from("2"), &Value::from("constant"))
    );

    for (name, words) in [
        ("nan.wav", &["nan.wav", "NaN at sample 1"][..]),
        ("empty.wav", &["empty.wav"]),
        ("broken.wav", &["broken.wav"]),
        ("truncated.wav", &["truncated.wav"]),
        ("letter.txt", &["letter.txt"]),
        ("letter.wav", &["letter.wav", "text", "expected the content of a .wav file"]),
        ("absent.wav", &["absent.wav", "No such file"]),
    ] {
        flankwatch(&["analyze", &at(name)]).expect_failure(words);
    }
    let mixed = flankwatch(&["analyze", "--format", "json", &at("one.wav"), &at("nan.wav")])
        .expect_failure(&["1 of 2 files"]);
    assert_eq!(serde_json::from_str::<Value>(&mixed.out()).unwrap().as_array().unwrap().len(), 1);
}

#[test]
fn a_two_hour_recording_is_split_into_records() {
    let folder = tempfile::tempdir().unwrap();
    let name = path(&folder, "two-hours.wav");
    let seconds = 2 * 3600;
    // 16-bit PCM at 2 kHz: the header by hand, the samples a hole in the file.
    let bytes: u32 = seconds * 2000 * 2;
    let mut file = File::create(&name).unwrap();
    file.write_all(b"RIFF").unwrap();
    file.write_all(&(36 + bytes).to_le_bytes()).unwrap();
    file.write_all(b"WAVEfmt \x10\0\0\0\x01\0\x01\0").unwrap();
    file.write_all(&2000u32.to_le_bytes()).unwrap();
    file.write_all(&4000u32.to_le_bytes()).unwrap();
    file.write_all(b"\x02\0\x10\0data").unwrap();
    file.write_all(&bytes.to_le_bytes()).unwrap();
    file.seek(SeekFrom::Start(44 + u64::from(bytes) - 2)).unwrap();
    file.write_all(&16384i16.to_le_bytes()).unwrap();
    drop(file);
    let records = analyze(&[&name, "--start-time", "2026-01-01T00:00:00Z"]);
    assert_eq!(records.len(), 720);
    assert_eq!(records[719]["start_time"], "2026-01-01T01:59:50Z");
    // The only sample that is not zero: half of full scale, the last of 20 000.
    assert!((records[719]["indicators"]["rms"].as_f64().unwrap() - 0.5 / 20_000f64.sqrt()).abs() < 1e-9);
}

#[test]
fn an_interrupted_analysis_keeps_its_provisional_estimate() {
    let folder = tempfile::tempdir().unwrap();
    let (run, asset, data) = (path(&folder, "run.mcap"), asset_file(&folder), path(&folder, "data"));
    flankwatch(&["simulate", "--out", &run, "--records", "26", "--seconds", "1", "--seed", "3"])
        .expect_success();
    let mut child = Command::new(env!("CARGO_BIN_EXE_flankwatch"))
        .args(["analyze", &run, "--asset", &asset, "--data-dir", &data])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    stderr.read_line(&mut line).unwrap();
    assert!(line.contains("with 96 of 1280 ensemble members: provisional: worn "), "{line}");
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait_with_output().unwrap();
    let table = String::from_utf8(ended.stdout).unwrap();
    assert!(ended.status.success() && table.lines().nth(27).unwrap().contains("  provisional "), "{table}");
    assert!(table.trim_end().lines().last().unwrap().starts_with("provisional: worn "), "{table}");
}

/// Writes a file of an asset without a pair, with these teeth and this speed.
fn plain_asset_file(folder: &TempDir, teeth: [u32; 2], shaft_speed_hz: f64) -> String {
    let name = path(folder, &format!("asset-{}.toml", teeth[0]));
    let gear = format!("[gear]\nteeth = {teeth:?}\nshaft_speed_hz = {shaft_speed_hz:?}");
    fs::write(&name, format!("id = \"pump\"\n{gear}\n[baseline]\nrecords = 8\n")).unwrap();
    name
}

#[test]
fn the_table_asks_about_teeth_and_speed_and_says_why_records_are_not_comparable() {
    let folder = tempfile::tempdir().unwrap();
    let [run, short] = ["run.mcap", "short.mcap"].map(|name| path(&folder, name));
    let simulate = |words: &[&str]| {
        flankwatch(&[&["simulate", "--seed", "3", "--max-wear-um", "1"], words].concat()).expect_success();
    };
    simulate(&["--out", &run, "--records", "8", "--seconds", "2"]);
    simulate(&[
        "--out",
        &short,
        "--records",
        "1",
        "--seconds",
        "0.1",
        "--start-time",
        "2026-02-01T00:00:00Z",
    ]);
    let right = plain_asset_file(&folder, [24, 26], 16.64);
    let table = flankwatch(&["analyze", &run, &short, "--asset", &right]).expect_success().out();
    let row = table.lines().nth(10).unwrap();
    assert!(row.ends_with("  not_comparable: 0.1 s, 0.3 s needed"), "{table}");
    assert!(!table.contains("in doubt"), "{table}");

    let wrong = plain_asset_file(&folder, [32, 80], 30.0);
    let question = |words: &[&str]| {
        let table =
            flankwatch(&[&["analyze", &run, "--asset", &wrong], words].concat()).expect_success().out();
        let last = table.trim_end().lines().last().unwrap().to_owned();
        assert!(
            last.ends_with("; are the tooth counts and the speed correct?") && last.contains(" better than "),
            "{table}"
        );
        last
    };
    let found = question(&[]);
    assert!(found.starts_with("no wear estimate: the shaft speed is in doubt: the lines fit "), "{found}");
    let given = question(&["--shaft-speed-hz", "30"]);
    assert!(given.starts_with("in 8 of 8 records the shaft speed is in doubt: the lines fit "), "{given}");
    assert!(given.contains("32 × 30.00 Hz"), "{given}");
}

#[test]
fn a_simulated_run_is_estimated_and_printed_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let (run, asset, data) = (path(&folder, "run.mcap"), asset_file(&folder), path(&folder, "data"));
    let order = ["simulate", "--out", &run, "--records", "120", "--seconds", "1", "--seed", "3"];
    flankwatch(&order).expect_success();
    let records = analyze(&[&run, "--asset", &asset, "--data-dir", &data, "--members", "0"]);
    assert_eq!(records.len(), 120);
    let status = |record: &Value| record["wear"]["status"].as_str().unwrap().to_owned();
    assert!(records[..20].iter().all(|record| status(record) == "collecting_baseline"));
    assert!(records[..20].iter().all(|record| record["wear"]["median_um"].is_null()));
    assert_eq!(records[7]["wear_reason"], "collecting baseline, 8 of 20");
    let mut covered = 0;
    // Wear that grew during the baseline is missing from the first estimates after it.
    for (index, record) in records.iter().enumerate().skip(20) {
        let (wear, truth) = (&record["wear"], record["reference_wear_um"].as_f64().unwrap());
        let um = |name: &str| wear[name].as_f64().unwrap();
        assert!(index < 50 || (um("median_um") - truth).abs() < 10.0 + 0.3 * truth, "{wear} at {truth}");
        covered += usize::from((um("low_um")..=um("high_um")).contains(&truth));
    }
    assert!(covered >= 95, "{covered} of 100 intervals hold the truth");

    let (table, report) =
        (flankwatch(&["analyze", &run]).expect_success().out(), path(&folder, "report.html"));
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!((lines.len(), lines[122]), (123, "no wear estimate: no asset description, see --asset"));
    assert!(lines[0].starts_with("channel ") && lines[1].trim_start().starts_with('#'), "{table}");
    let described = ["analyze", &run, "--asset", &asset, "--data-dir", &data, "--members", "0"];
    let table = flankwatch(&described).expect_success().out();
    let (rows, words) = table.trim_end().rsplit_once('\n').unwrap();
    let widest = rows.lines().map(|line| line.chars().count()).max().unwrap();
    assert!(widest <= 80 && words.chars().count() <= 120, "{widest} columns, and {words}");
    assert!(words.starts_with("worn ") && words.contains("µm"), "{words}");
    let more = flankwatch(&[&described[..], &["--columns", "fm4,file"]].concat()).expect_success().out();
    assert!(more.lines().nth(1).unwrap().contains("fm4") && more.contains("run.mcap"));
    flankwatch(&["analyze", &run, "--columns", "kurtossis"]).expect_failure(&["kurtossis", "kurtosis"]);
    let words = [
        "analyze",
        &run,
        "--asset",
        &asset,
        "--data-dir",
        &data,
        "--format",
        "csv",
        "--report",
        &report,
        "--members",
        "0",
    ];
    let csv = flankwatch(&words).expect_success().out();
    let mut rows = csv::Reader::from_reader(csv.as_bytes());
    let column = |name: &str, row: &csv::StringRecord, header: &csv::StringRecord| {
        row[header.iter().position(|other| other == name).unwrap()].to_owned()
    };
    let header = rows.headers().unwrap().clone();
    let names: std::collections::BTreeSet<&str> = header.iter().collect();
    assert_eq!(names.len(), header.len(), "{header:?}");
    let rows: Vec<csv::StringRecord> = rows.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 120);
    for (row, record) in rows.iter().zip(&records) {
        assert_eq!(column("wear_status", row, &header), status(record));
        assert_eq!(column("wear_reason", row, &header), record["wear_reason"].as_str().unwrap());
        let novelty = &record["wear"]["novelty"];
        let score = novelty["score"].as_f64();
        assert_eq!(column("novelty", row, &header).parse().ok(), score, "{record}");
        let cause = ["sensor_fault", "suspected_fault"].iter().find_map(|name| novelty[name].as_str());
        assert_eq!(column("wear_cause", row, &header), cause.unwrap_or_default(), "{record}");
    }
    let html = fs::read_to_string(&report).unwrap();
    // The page is self-contained.
    assert!(html.contains("Wear depth") && html.contains("<polygon class=\"band\""));
    let html = html.replace(r#"<link rel="icon" href="data:,">"#, "");
    assert!(!html.contains("<script") && !html.contains("<link") && !html.contains("http"));
}

#[test]
fn a_simulated_run_depends_on_its_seed_only_and_not_on_the_format() {
    let folder = tempfile::tempdir().unwrap();
    let simulate = |out: &str, seed: &str| {
        flankwatch(&["simulate", "--out", out, "--records", "3", "--seconds", "0.5", "--seed", seed])
            .expect_success();
    };
    let (a, b, c) = (path(&folder, "a.mcap"), path(&folder, "b.mcap"), path(&folder, "c.mcap"));
    simulate(&a, "1");
    simulate(&b, "1");
    simulate(&c, "2");
    assert_eq!(fs::read(&a).unwrap(), fs::read(&b).unwrap());
    assert_ne!(fs::read(&a).unwrap(), fs::read(&c).unwrap());
    let wav = path(&folder, "run.wav");
    simulate(&wav, "1");
    let from_wav = analyze(&[&format!("{wav}/record-00002.wav")]);
    let mut from_mcap = analyze(&[&a]);
    // WAV does not say its unit, and a velocity needs one.
    let velocity = from_mcap[2]["indicators"].as_object_mut().unwrap().remove("velocity_rms");
    assert!(velocity.is_some() && from_wav[0]["absent"]["velocity_rms"].is_string());
    assert_eq!(from_wav[0]["indicators"], from_mcap[2]["indicators"]);
    let truth = fs::read_to_string(format!("{wav}/truth.csv")).unwrap();
    assert!(truth.lines().nth(3).unwrap().ends_with(",245"), "{truth}");
    // A shorter run would leave records of this one beside its own.
    flankwatch(&["simulate", "--out", &wav, "--records", "2", "--force"])
        .expect_failure(&["run.wav", "record-00002.wav"]);
    flankwatch(&["simulate", "--out", &a, "--asset", "a b"]).expect_failure(&["a b"]);
    let before = fs::read(&a).unwrap();
    for (out, exists) in [(&a, "a.mcap"), (&wav, "record-00000.wav")] {
        flankwatch(&["simulate", "--out", out, "--records", "3"]).expect_failure(&[exists, "--force"]);
    }
    assert_eq!(fs::read(&a).unwrap(), before);
}

#[test]
fn a_simulated_run_is_scored() {
    let folder = tempfile::tempdir().unwrap();
    let (run, data) = (path(&folder, "run.wav"), path(&folder, "data"));
    flankwatch(&["simulate", "--out", &run, "--records", "24", "--seconds", "0.5"]).expect_success();
    let evaluate = |limit_um: &str| {
        let arguments = ["evaluate", "--recorded", &run, "--members", "8", "--data-dir", &data, "--limit-um"];
        flankwatch(&[&arguments[..], &[limit_um]].concat())
    };
    let table = evaluate("240").expect_success().out();
    let row = table.lines().find(|line| line.starts_with("run.wav")).expect(&table);
    assert!(row.contains("/4 "), "four records follow the baseline: {row}");
    let forecasts =
        table.lines().skip_while(|line| !line.starts_with("time to the limit")).nth(1).expect(&table);
    assert!(forecasts.contains("/2 "), "wear passes the limit with the last record: {forecasts}");
    evaluate("0").expect_failure(&["--limit-um is 0", "expected a depth above 0"]);
}

#[test]
fn an_unchanged_library_is_loaded_and_a_damaged_one_is_rebuilt() {
    let folder = tempfile::tempdir().unwrap();
    let data = path(&folder, "data");
    let build = ["library", "build", "--states", "3", "--seconds", "0.2", "--data-dir", &data];
    let first = flankwatch(&build).expect_success().out();
    let file = only_file(&folder.path().join("data/libraries"));
    let (bytes, time) = (fs::read(&file).unwrap(), fs::metadata(&file).unwrap().modified().unwrap());

    assert_eq!(flankwatch(&build).expect_success().out(), first);
    assert_eq!(fs::metadata(&file).unwrap().modified().unwrap(), time, "loaded, not written again");

    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 1;
    fs::write(&file, damaged).unwrap();
    let again = flankwatch(&build).expect_success();
    assert!(again.err().contains("damaged library file"), "{}", again.err());
    assert_eq!(fs::read(&file).unwrap(), bytes, "the same inputs give the same bytes");

    let id = file.file_stem().unwrap().to_str().unwrap().to_owned();
    let shown = flankwatch(&["library", "show", &id, "--data-dir", &data]).expect_success().out();
    assert!(
        shown.contains("245.0")
            && shown.contains("3 wear states × 1300 N·m × 16.64 Hz")
            && shown.lines().count() == 6,
        "{shown}"
    );
    let other = [&build[..], &["--max-wear-um", "100"]].concat();
    assert_ne!(flankwatch(&other).expect_success().out(), first);
    flankwatch(&["library", "show", "nothing", "--data-dir", &data]).expect_failure(&["nothing"]);
}

/// Writes an asset file with the paper's pair.
pub(super) fn asset_file(folder: &TempDir) -> String {
    let pair = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/pairs/shen2022.toml"))
        .unwrap();
    let pair: toml::Table = pair.parse().unwrap();
    let mut gear = toml::Table::new();
    gear.insert("teeth".to_owned(), vec![24, 26].into());
    gear.insert("shaft_speed_hz".to_owned(), 16.64.into());
    gear.insert("pair".to_owned(), pair.into());
    let mut asset = toml::Table::new();
    asset.insert("id".to_owned(), "gearbox".into());
    asset.insert("gear".to_owned(), gear.into());
    let name = path(folder, "asset.toml");
    fs::write(&name, asset.to_string()).unwrap();
    name
}

fn only_file(folder: &Path) -> PathBuf {
    let files: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    files[0].clone()
}

#[test]
fn completions_and_manual_pages_cover_every_command() {
    let help = flankwatch(&["--help"]).expect_success().out();
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let commands: Vec<&str> = listed
        .map_while(|line| line.trim_start().split(' ').next().filter(|name| !name.is_empty()))
        .filter(|name| *name != "help")
        .collect();
    assert!(commands.contains(&"serve") && commands.contains(&"completions"), "{commands:?}");
    for shell in ["bash", "zsh", "fish"] {
        let script = flankwatch(&["completions", shell]).expect_success().out();
        for command in &commands {
            assert!(script.contains(command), "{shell}: {command}");
        }
        assert!(script.contains("data-dir"), "{shell}");
    }
    flankwatch(&["completions", "tcsh"]).expect_failure(&["tcsh", "bash", "zsh", "fish"]);
    let folder = tempfile::tempdir().unwrap();
    flankwatch(&["manual", &path(&folder, "man")]).expect_success();
    for command in commands {
        let page = fs::read_to_string(folder.path().join(format!("man/flankwatch-{command}.1"))).unwrap();
        assert!(page.contains(".SH SYNOPSIS") && page.contains(".SH DESCRIPTION"), "{page}");
    }
    assert!(folder.path().join("man/flankwatch.1").is_file());
}

#[test]
fn analyze_scales_values_reads_arrays_and_parses_times_in_file_names() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| path(&folder, name);
    let spec = hound::WavSpec {
        channels: 1,
        sample_rate: 8000,
        bits_per_sample: 16,
        sample_format: hound::SampleFormat::Int,
    };
    let mut writer = hound::WavWriter::create(at("pump_20260131_120000.wav"), spec).unwrap();
    for k in 0..64 {
        writer.write_sample(if k % 2 == 0 { 16384_i16 } else { -16384 }).unwrap();
    }
    writer.finalize().unwrap();
    // Half of 5 V at 100 mV/g.
    let words = ["--scale", "5", "--sensitivity-mv-per-g", "100", "--time-from-name", "%Y%m%d_%H%M%S"];
    let found = analyze(&[&[at("pump_20260131_120000.wav").as_str()], &words[..]].concat());
    assert_eq!((&found[0]["unit"], &found[0]["indicators"]["rms"]), (&Value::from("g"), &Value::from(25.0)));
    assert_eq!(found[0]["start_time"], "2026-01-31T12:00:00Z");

    let description = "{'descr': '<i2', 'fortran_order': False, 'shape': (4, 2), }\n";
    let mut array = b"\x93NUMPY\x01\0".to_vec();
    array.extend_from_slice(&(description.len() as u16).to_le_bytes());
    array.extend_from_slice(description.as_bytes());
    for value in [1_i16, 3, -1, 3, 1, 3, -1, 3] {
        array.extend_from_slice(&value.to_le_bytes());
    }
    fs::write(at("array.npy"), &array).unwrap();
    let found = analyze(&[&at("array.npy"), "--rate", "1000", "--scale", "0.5"]);
    assert_eq!((found.len(), &found[0]["indicators"]["rms"]), (2, &Value::from(0.5)));
    assert_eq!(found[1]["indicators"]["peak"], 1.5);

    let refuse = |words: &[&str], expected: &[&str]| {
        flankwatch(&[&["analyze"], words].concat()).expect_failure(expected);
    };
    refuse(&[&at("array.npy")], &["array.npy", "sample rate"]);
    refuse(&[&at("array.npy"), "--rate", "1000", "--scale", "0"], &["--scale is 0"]);
    refuse(&[&at("array.npy"), "--time-from-name", "%Y"], &["array.npy", "%Y"]);
    array.truncate(array.len() - 1);
    fs::write(at("array.npy"), &array).unwrap();
    refuse(&[&at("array.npy"), "--rate", "1000"], &["array.npy", "4 frames", "3 are there"]);
}
