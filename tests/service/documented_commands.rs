//! The examples of docs/operations.md about backups, lost and damaged data, run as they stand.

use std::collections::BTreeSet;
use std::path::Path;

use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::signal::Record;
use jiff::{SignedDuration, Timestamp};

use crate::command::flankwatch;
use crate::program::Program;
use crate::running::{plain_asset, samples};

/// Folders of the examples, and their places in the folder of the test.
const PLACES: [(&str, &str); 2] = [("/var/lib", "lib"), ("/backup", "backup")];

/// Commands that send requests to the service.
const SENT: [&str; 4] = ["exclude", "include", "delete", "baseline"];

/// Returns the commands of each shell block below a heading.
fn blocks(heading: &str) -> Vec<Vec<String>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/operations.md");
    let text = std::fs::read_to_string(path).unwrap();
    let begin = text.find(&format!("\n## {heading}\n")).unwrap_or_else(|| panic!("no heading {heading:?}"));
    let section = text[begin + 1..].split("\n## ").next().unwrap();
    let blocks = section.split("```sh\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    let command = |line: &str| Some(line.strip_prefix("flankwatch ")?.split(" #").next()?.trim().to_owned());
    blocks.map(|block| block.lines().filter_map(command).collect()).collect()
}

/// Runs the commands with the folders of the test; returns their names and what they print.
fn run(commands: &[String], folder: &Path, program: Option<&Program>) -> Vec<(String, String)> {
    let run = |command: &String| {
        let mut line = command.clone();
        for (documented, here) in PLACES {
            line = line.replace(documented, folder.join(here).to_str().unwrap());
        }
        let mut words: Vec<&str> = line.split_whitespace().collect();
        if SENT.contains(&words[0]) {
            words.extend(["--url", program.unwrap().url()]);
        }
        let output = flankwatch(&words);
        println!("flankwatch {command}: {}{}", output.out(), output.err());
        let printed = output.expect_success().out();
        (words[0].to_owned(), printed)
    };
    commands.iter().map(run).collect()
}

fn printed(outputs: &[(String, String)]) -> Vec<&str> {
    outputs.iter().map(|(_, printed)| printed.as_str()).collect()
}

#[test]
fn the_examples_of_backups_and_recovery_run() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("lib/flankwatch");
    std::fs::create_dir_all(&data).unwrap();
    let program = Program::start(&data);
    program.make(&plain_asset("gearbox-7"));
    // Old records, those of a bad hour, and those of a healthy day.
    for (first, count, minutes) in
        [("2024-12-31T00:00:00Z", 2, 10), ("2026-03-01T08:00:00Z", 4, 15), ("2026-03-02T00:00:00Z", 8, 60)]
    {
        let first: Timestamp = first.parse().unwrap();
        for n in 0..count {
            let time = first + SignedDuration::from_mins(i64::from(n * minutes));
            let record = Record::new("in", time, 4000.0, "m/s2", samples(n)).unwrap();
            let body = encode_block(&record, BlockEncoding::Protobuf);
            let kind = [("content-type", "application/x-protobuf")];
            assert_eq!(program.send("POST", "/v1/assets/gearbox-7/segments", &kind, &body).status(), 201);
        }
    }
    let [backup, corrections] = &blocks("Backup, and a lost database")[..] else { panic!("two blocks") };
    let corrected = run(corrections, folder.path(), Some(&program));
    for (printed, expected) in
        printed(&corrected).iter().zip(["4 records", "2 records", "2 records", "baseline"])
    {
        assert!(printed.contains(expected), "{expected:?} in {printed:?}");
    }
    let mut outputs = corrected;
    outputs.extend(run(backup, folder.path(), Some(&program)));
    // These need a stopped service.
    program.kill();
    let [anew] = &blocks("A damaged database or recording")[..] else { panic!("one block") };
    outputs.extend(run(anew, folder.path(), None));
    let [quarantine] = &blocks("Protection of raw recordings")[..] else { panic!("one block") };
    let restored = run(quarantine, folder.path(), None);
    assert!(printed(&restored)[2].contains("imported 0 assets and 2 records"), "{restored:?}");
    outputs.extend(restored);

    let names: BTreeSet<&str> = outputs.iter().map(|(name, _)| name.as_str()).collect();
    for name in ["backup", "restore", "verify", "rebuild", "quarantine"].iter().chain(&SENT) {
        assert!(names.contains(name), "{name} has no example: {names:?}");
    }
}
