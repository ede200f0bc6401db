//! Wrong flags, files and environment variables: an error names what is wrong.

use std::fs;
use std::process::Command;

use crate::command::flankwatch;

#[test]
fn invalid_flags_and_files_are_rejected_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let asset = folder.path().join("asset.toml").display().to_string();
    fs::write(&asset, "id = \"a\"\n[gear]\nteeth = [24, 26]\nshaft_speed_hz = -1.0\n").unwrap();
    flankwatch(&["analyze", "x.wav", "--asset", &asset]).expect_failure(&[
        "asset.toml",
        "gear.shaft_speed_hz",
        "-1",
    ]);
    fs::write(&asset, "id = \"a\"\ncolour = 1\n[gear]\nteeth = [24, 26]\nshaft_speed_hz = 1.0\n").unwrap();
    flankwatch(&["analyze", "x.wav", "--asset", &asset]).expect_failure(&["colour"]);
    flankwatch(&["serve", "--port", "1"]).expect_failure(&["--port"]);
    flankwatch(&["simulate", "--out", "run.txt"]).expect_failure(&["run.txt", ".mcap or .wav"]);
    flankwatch(&["simulate", "--out", "run.mcap", "--seconds", "0"]).expect_failure(&["seconds", "0"]);
    flankwatch(&["model", "--contact", "magic"]).expect_failure(&["magic", "threshold"]);
    flankwatch(&["model", "--pair", "absent.toml"]).expect_failure(&["absent.toml"]);
    flankwatch(&["replay", "x.mcap", "--asset", "Not An Id"]).expect_failure(&["Not An Id"]);
}

#[test]
fn options_that_would_be_ignored_are_errors() {
    for (words, expected) in [
        (&["evaluate", "--recorded", "run.wav", "--out", "scores.html"][..], "--out"),
        (&["evaluate", "--leave-one-out", "2", "--seed", "7"], "--seed"),
        (&["evaluate", "--recorded", "run.wav", "--answers", "a.json", "--gap", "3"], "--gap"),
        (
            &["evaluate", "--recorded", "run.wav", "--answers", "a.json", "--inspection-um", "5"],
            "--inspection-um",
        ),
        (&["evaluate", "--recorded", "run.wav", "--answers", "a.json", "--limit-um", "100"], "--limit-um"),
        (&["quarantine", "restore", "one.wav", "--all"], "--all"),
        (&["stream", "--asset", "a", "--follow"], "--follow is given without a file"),
        (
            &["stream", "x.wav", "--asset", "a", "--start-time", "2026-01-01T00:00:00Z", "--spool", "spool"],
            "--spool is given with a file",
        ),
        (&["analyze", "x.wav", "--columns", "fm4", "--format", "csv"], "--columns"),
        (&["analyze", "x.wav", "--envelope", "mesh"], "--envelope"),
        (&["convert", "x.csv", "x.wav", "--asset", "a"], "--asset"),
        (&["convert", "x.csv", "x.wav", "--torque-nm", "5"], "--torque-nm"),
        (&["simulate", "--out", "run.wav", "--asset", "a"], "--asset"),
    ] {
        flankwatch(words).expect_failure(&[expected]);
    }
    let program = || Command::new(env!("CARGO_BIN_EXE_flankwatch"));
    let wrong = program().args(["token", "list"]).env("FLANKWATCH_LOG", "flankwatch=loud").output().unwrap();
    let error = String::from_utf8_lossy(&wrong.stderr);
    assert!(!wrong.status.success() && error.contains("FLANKWATCH_LOG is \"flankwatch=loud\""), "{error}");
}

#[test]
fn an_error_names_the_option_its_value_and_what_was_expected() {
    let time = "expected a time such as 2026-01-31T08:00:00Z";
    for (words, expected) in [
        (&["simulate", "--out", "run.mcap", "--rate", "-5"][..], "--rate is -5, expected a rate"),
        (
            &["simulate", "--out", "run.mcap", "--seconds", "1", "--interval", "0.5"],
            "--interval is 0.5 s, expected at least --seconds (1 s)",
        ),
        (&["simulate", "--out", "run.mcap", "--records", "0"], "0 is not in 1..=1000000"),
        (&["evaluate", "--records", "30"], "--records is 30, expected at least 40"),
        (&["evaluate", "--members", "20000"], "expected a number from 0 to 10240"),
        (&["analyze", "a.wav", "--rate", "0"], "'--rate <HZ>': expected a rate above 0 Hz"),
        (&["simulate", "--out", "run.mcap", "--interval", "0"], "--interval is 0, expected a time above 0 s"),
        (&["library", "build", "--rate", "5"], "--rate is 5, expected a rate"),
        (&["evaluate", "--leave-one-out", "0"], "--leave-one-out is 0, expected at least 1 and at most 319"),
        (
            &["evaluate", "--leave-one-out", "3", "--members", "8"],
            "--leave-one-out is 3, expected at least 1 and at most 1 with --members 8",
        ),
        (
            &["evaluate", "--leave-one-out", "1", "--members", "4"],
            "--members is 4 (1 group), expected at least 2 groups of 4 with --leave-one-out",
        ),
        (&["evaluate", "--leave-one-out", "1", "--wear-records", "0"], "--wear-records is 0"),
        (&["convert", "x.csv", "x.mcap", "--unit", ""], "--unit is empty"),
        (&["stream", "x.raw", "--asset", "a", "--start-time", "2026-01-01"], time),
        (&["serve", "--listen", "localhost:8600"], "expected an IP address and a port"),
    ] {
        flankwatch(words).expect_failure(&[expected]);
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.csv").display().to_string();
    fs::write(&file, "a\n1\n2\n").unwrap();
    flankwatch(&["library", "show", &file]).expect_failure(&["run.csv", "library"]);
    let wav = folder.path().join("a.wav").display().to_string();
    flankwatch(&["convert", &file, &wav, "--rate", "1000"]).expect_success();
    let same = ["convert", &wav, &wav, "--force"];
    flankwatch(&same).expect_failure(&["OUT is", "another file than the recordings"]);
}

#[test]
fn a_command_does_not_create_a_store_for_a_wrong_name() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let place = data.display().to_string();
    for words in [
        &["rebuild"][..],
        &["token", "create", "me"],
        &["token", "list"],
        &["quarantine", "list"],
        &["library", "list"],
    ] {
        let words = [words, &["--data-dir", &place]].concat();
        flankwatch(&words).expect_failure(&["--data-dir is", "expected an existing data folder"]);
        assert!(!data.exists(), "{words:?}");
    }
    fs::create_dir(&data).unwrap();
    flankwatch(&["token", "create", " ", "--data-dir", &place]).expect_failure(&["NAME is empty"]);
    flankwatch(&["token", "create", "me", "--data-dir", &place]).expect_success();
    let listed = flankwatch(&["token", "list", "--data-dir", &place]).expect_success().out();
    assert!(listed.starts_with("id        scope  created") && listed.lines().count() == 2, "{listed}");
}
