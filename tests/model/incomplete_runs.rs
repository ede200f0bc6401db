//! Commands that lack something or are stopped: what is computed is printed, and no half file is left.

use std::fs;
use std::process::Command;

use serde_json::Value;

use super::command_line::{analyze, asset_file, path};
use crate::command::flankwatch;

#[cfg(unix)]
#[test]
fn an_interrupted_simulation_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let files = || fs::read_dir(folder.path()).unwrap().count();
    let mut child = Command::new(env!("CARGO_BIN_EXE_flankwatch"))
        .args(["simulate", "--records", "10000", "--out", &path(&folder, "run.mcap")])
        .spawn()
        .unwrap();
    let began = std::time::Instant::now();
    while files() == 0 {
        assert!(began.elapsed().as_secs() < 100);
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    // The file appears just after the handler of Ctrl-C.
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(files(), 0);
}

#[test]
fn a_recording_without_a_time_shows_none_and_channels_are_chosen() {
    let folder = tempfile::tempdir().unwrap();
    let name = path(&folder, "a.csv");
    let rows: String = (0..400).map(|n| format!("{n},{},1\n", n % 2)).collect();
    fs::write(&name, format!("n,x,y\n{rows}")).unwrap();
    flankwatch(&["analyze", &name, "--rate", "1000"]).expect_failure(&["\"n\"", "do not select it"]);
    let words = ["analyze", &name, "--rate", "1000", "--channels", "x"];
    let output = flankwatch(&words).expect_success();
    assert!(output.err().contains("a.csv: no time in the recording"), "{}", output.err());
    let table = output.out();
    assert!(table.starts_with("channel x (no unit): 1 record, without a time\n"), "{table}");
    assert!(table.contains("+0:00:00") && !table.contains("1970"), "{table}");
    let wav = path(&folder, "a.wav");
    flankwatch(&["convert", &name, &wav, "--rate", "1000", "--channels", "x"]).expect_success();
    let other = flankwatch(&["analyze", &wav, "--rate", "500", "--format", "csv"]).expect_success();
    assert!(other.err().contains("a.wav: --rate 500 overrides 1000 Hz"), "{}", other.err());
    assert!(other.out().contains(",500,400,"), "{}", other.out());
    let found = analyze(&[&words[1..], &["--record-seconds", "0.2"]].concat());
    assert_eq!((found.len(), &found[1]["start_time"], &found[1]["channel"]), (2, &Value::Null, &"x".into()));
    flankwatch(&["analyze", &name, "--channels", "x"])
        .expect_failure(&["sampling rate is missing", "(see --rate)"]);
}

#[test]
fn an_analysis_is_printed_although_its_library_cannot_be_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (run, asset, data) = (path(&folder, "run.mcap"), asset_file(&folder), path(&folder, "data"));
    flankwatch(&["simulate", "--out", &run, "--records", "22", "--seconds", "0.5"]).expect_success();
    // A file where the folder should be.
    fs::write(&data, "").unwrap();
    let words = ["analyze", &run, "--asset", &asset, "--data-dir", &data, "--format", "csv"];
    let output = flankwatch(&words);
    assert!(
        output.out().lines().count() == 23 && output.out().contains("library_failed"),
        "{}",
        output.out()
    );
    output.expect_failure(&["error: ", "data"]);
    flankwatch(&["analyze", &run, "--report", &path(&folder, "none/r.html")]).expect_failure(&[
        "r.html",
        "there is no folder",
        "none",
    ]);
}
