//! Outputs of commands: what they may replace. What recordings of several files share.

use std::fs;

use serde_json::Value;
use tempfile::TempDir;

use super::command_line::path;
use crate::command::flankwatch;

const PAIR: &str = include_str!("../../fixtures/pairs/shen2022.toml");

/// A recording of one channel in a unit.
fn recording(folder: &TempDir, name: &str, unit: &str, amplitude: f64) -> String {
    let sample = |k: u32| amplitude * (0.7 * f64::from(k)).sin();
    let lines: String = (0..4000).map(|k| format!("{}\n", sample(k))).collect();
    let file = path(folder, name);
    fs::write(&file, format!("fs=4000\na [{unit}]\n{lines}")).unwrap();
    file
}

#[test]
fn a_command_replaces_only_outputs_of_the_same_kind() {
    let folder = tempfile::tempdir().unwrap();
    let (run, report) = (recording(&folder, "a.csv", "g", 1.0), path(&folder, "r.html"));
    let (pair, notes) = (path(&folder, "pair.toml"), path(&folder, "notes"));
    fs::write(&pair, PAIR).unwrap();
    fs::write(&notes, "kept").unwrap();
    let contents = || [&run, &pair, &notes].map(|file| fs::read(file).unwrap());
    let before = contents();
    let other = "expected another file than";
    let new = "expected a new file, or a";
    let folder_name = folder.path().display().to_string();
    let one = path(&folder, "one.html");
    for (words, expected) in [
        (&["analyze", &run, "--report", &run][..], [other, "--report is"]),
        (&["analyze", &run, "--report", &notes], [new, "notes"]),
        (&["analyze", &run, "--report", &folder_name], ["a folder, expected the name of a file", "error"]),
        (&["library", "build", "--pair", &pair, "--out", &pair], [other, "--out is"]),
        (&["library", "build", "--out", &notes], [new, "a library to replace"]),
        (&["figures", "--out", &notes], [new, "an HTML page"]),
        (&["figures", "--out", &one, "--data", &one], [other, "--data is"]),
        (&["figures", "--out", &one, "--data", &pair, "--pair", &pair], [other, "the gear pair file"]),
        (&["evaluate", "--out", &notes], [new, "an HTML page"]),
        (&["export", "wear", &run, "--asset", "pump"], [new, "a CSV table of a trend"]),
    ] {
        let output = flankwatch(words).expect_failure(&expected);
        assert_eq!(output.out(), "", "{words:?}: before the work");
    }
    assert_eq!(contents(), before);
    for _ in 0..2 {
        flankwatch(&["analyze", &run, "--report", &report]).expect_success();
    }
    assert!(fs::read_to_string(&report).unwrap().starts_with("<!doctype html"));
}

/// A channel has the unit of its first record, as in the service.
#[test]
fn records_of_a_channel_are_analysed_in_one_unit() {
    let folder = tempfile::tempdir().unwrap();
    let first = recording(&folder, "1.csv", "m/s2", 9.80665);
    let second = recording(&folder, "2.csv", "g", 1.0);
    let third = recording(&folder, "3.csv", "V", 1.0);
    let output = flankwatch(&["analyze", &first, &second, &third, "--format", "json"]).expect_failure(&[
        "3.csv",
        "\"V\"",
        "m/s2",
        "1 of 3 files could not be read",
    ]);
    let records: Value = serde_json::from_str(&output.out()).unwrap();
    let records = records.as_array().unwrap();
    assert_eq!(records.len(), 2);
    let rms = |at: usize| records[at]["indicators"]["rms"].as_f64().unwrap();
    assert!((rms(1) / rms(0) - 1.0).abs() < 1e-6, "{records:?}");
    assert!(records.iter().all(|record| record["unit"] == "m/s2"));

    let asset = path(&folder, "asset.toml");
    let description = "id = \"fan\"\nvelocity_zones = { machine_class = \"class_1\" }
[sensor]\nunit = \"g\"\n[shaft]\nspeed_hz = 20\n";
    fs::write(&asset, description).unwrap();
    let output = flankwatch(&["analyze", &first, "--asset", &asset, "--format", "json"]).expect_success();
    let records: Value = serde_json::from_str(&output.out()).unwrap();
    assert!(records[0]["unit"] == "g" && records[0]["velocity_zone"].is_string(), "{records}");
    let words = ["analyze", &first, "--envelope", "2500,3000", "--format", "json"];
    let err = flankwatch(&words).expect_success().err();
    assert!(err.contains("warning: ") && err.contains("no envelope spectrum"), "{err}");
}
