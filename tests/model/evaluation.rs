//! `flankwatch evaluate` end to end, with as few runs as possible.

use std::fs;

use crate::command::flankwatch;

#[test]
fn wear_is_tracked_and_faults_are_detected_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (data, page) = (at("data"), at("evaluation.html"));
    let few = ["--runs", "2", "--records", "60", "--states", "20", "--members", "24", "--data-dir", &data];
    for (case, name) in [("gain jump", "gain changed"), ("clipping", "clipped"), ("dead sensor", "dead")] {
        let output = flankwatch(
            &[&["evaluate", "--cases", "faults", "--case", case, "--out", &page], &few[..]].concat(),
        )
        .expect_success();
        let table = output.out();
        let row = table.lines().find(|line| line.starts_with(case)).unwrap_or_else(|| panic!("{table}"));
        let found = row[case.len()..].split_whitespace().nth(7);
        assert_eq!(found, Some("1.000"), "{table}");
        assert!(row.contains(name), "{table}");
        let written = fs::read_to_string(&page).unwrap();
        assert!(written.contains(row.trim_end()), "the page has the table");
    }
    // Depths: the aims of the estimate on the library's own physics, with all members as in the service. Few
    // members cover the unknown parameters too coarsely for these aims.
    let depth = [
        "evaluate",
        "--cases",
        "wear",
        "--case",
        "shape known",
        "--runs",
        "2",
        "--records",
        "300",
        "--states",
        "300",
    ];
    let output = flankwatch(&[&depth[..], &["--data-dir", &data]].concat()).expect_success();
    let table = output.out();
    let row = table.lines().find(|line| line.starts_with("own physics, shape known")).unwrap();
    let number = |column: usize| -> f64 {
        let mut cells = row["own physics, shape known".len()..].split_whitespace();
        cells.nth(column).unwrap().parse().unwrap()
    };
    let (error_um, covered, rank) = (number(0), number(3), number(5));
    assert!(error_um <= 10.0 && covered >= 0.85 && rank >= 0.98, "{table}");
    // Members that are left out of the estimate, as machines that live for many records.
    let left_out = |records: &str, further: &[&str]| -> f64 {
        let words = ["evaluate", "--leave-one-out", "10", "--wear-records", records, "--data-dir", &data];
        let output = flankwatch(&[&words[..], further].concat()).expect_success();
        let table = output.out();
        println!("{table}");
        let last = table.lines().last().unwrap();
        last.split("covered ").nth(1).unwrap().split(',').next().unwrap().parse().unwrap()
    };
    assert!(left_out("960", &["--healthy"]) >= 0.95);
    assert!(left_out("480", &[]) >= 0.8);
    // The last line is of the records from the inspection on.
    assert!(left_out("120", &["--inspection-um", "5"]) >= 0.8);
    flankwatch(&["evaluate", "--case", "sunshine"]).expect_failure(&["--case", "sunshine", "gain jump"]);
    flankwatch(&["evaluate", "--leave-one-out", "1", "--wear-records", "1", "--data-dir", &data])
        .expect_failure(&["--wear-records is 1", "2 to 20000"]);
    flankwatch(&["evaluate", "--runs", "0"]).expect_failure(&["--runs is 0"]);
}
