//! `flankwatch export`: trends as Parquet and CSV.

use std::fs;

use crate::command::flankwatch;
use crate::running::{Service, record};

#[test]
fn export_writes_the_tables_of_the_api() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..12 {
        service.upload("pump", &record("1", n));
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let url = service.url("");
    let export = |words: &[&str]| {
        flankwatch(&[&["export"], words, &["--asset", "pump", "--url", url.trim_end_matches('/')]].concat())
    };
    let parquet = [("accept", "application/vnd.apache.parquet")];
    for (words, file, path) in [
        (&["indicators"][..], "all.parquet", "indicators"),
        (&["indicators", "--names", "rms,kurtosis"], "two.csv", "indicators?names=rms,kurtosis"),
        (
            &["wear", "--from", "2026-01-01T00:03:00Z"],
            "wear.parquet",
            "wear/history?from=2026-01-01T00:03:00Z",
        ),
        (&["wear", "--to", "2026-01-01T00:03:00Z"], "WEAR.CSV", "wear/history?to=2026-01-01T00:03:00Z"),
    ] {
        let (csv, path) = ([("accept", "text/csv")], format!("/v1/assets/pump/{path}"));
        let accept = if file.ends_with("parquet") { &parquet } else { &csv };
        let expected = service.send("GET", &path, accept, b"").expect(200).bytes;
        export(&[words, &[&at(file)]].concat()).expect_success();
        assert_eq!(fs::read(at(file)).unwrap(), expected, "{file}");
    }
    assert_eq!(fs::read_to_string(at("WEAR.CSV")).unwrap().lines().count(), 4);

    export(&["wear", &at("wear.xlsx")]).expect_failure(&["wear.xlsx", ".parquet or .csv"]);
    export(&["wear", &at("w.csv"), "--names", "rms"]).expect_failure(&["--names is rms"]);
    export(&["indicators", &at("i.csv"), "--names", "rmss"]).expect_failure(&["rmss", "rms"]);
    export(&["indicators", &at("i.csv"), "--channel", "none"]).expect_failure(&["404", "none"]);
    assert!(!fs::exists(at("i.csv")).unwrap());
}

#[test]
fn a_table_without_all_rows_says_so() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..30 {
        service.upload("pump", &record("1", n));
    }
    for (points, expected) in [(10, "true"), (200, "")] {
        let path = format!("/v1/assets/pump/indicators?names=rms&max_points={points}");
        let answer = service.send("GET", &path, &[("accept", "text/csv")], b"").expect(200);
        assert_eq!(answer.header("flankwatch-reduced"), expected);
    }
}
