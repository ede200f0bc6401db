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
        (&["quarantine", "restore", "one.wav", "--all"], "--all"),
        (&["stream", "--asset", "a", "--follow"], "--follow is given without a file"),
        (
            &["stream", "x.wav", "--asset", "a", "--start-time", "2026-01-01T00:00:00Z", "--spool", "spool"],
            "--spool is given with a file",
        ),
    ] {
        flankwatch(words).expect_failure(&[expected]);
    }
    let program = || Command::new(env!("CARGO_BIN_EXE_flankwatch"));
    let wrong = program().args(["token", "list"]).env("FLANKWATCH_LOG", "flankwatch=loud").output().unwrap();
    let error = String::from_utf8_lossy(&wrong.stderr);
    assert!(!wrong.status.success() && error.contains("FLANKWATCH_LOG is \"flankwatch=loud\""), "{error}");
}
