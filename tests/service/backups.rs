//! A data folder backed up, restored, verified, and rebuilt from its raw recordings.

use std::path::Path;

use serde_json::{Value, json};

use crate::command::{CommandOutput, flankwatch};
use crate::durability::{quarantined, raw_objects};
use crate::program::Program;
use crate::running::plain_asset;

/// Runs a command on a data folder.
fn on(folder: &Path, words: &[&str]) -> CommandOutput {
    let mut all = words.to_vec();
    all.extend(["--data-dir", folder.to_str().unwrap()]);
    flankwatch(&all)
}

fn remove_database(folder: &Path) {
    for name in ["flankwatch.db", "flankwatch.db-wal", "flankwatch.db-shm"] {
        let _ = std::fs::remove_file(folder.join(name));
    }
}

/// Returns the responses about an asset whose history no longer changes.
fn state(program: &Program) -> Vec<Value> {
    let mut state = program.history("pump");
    state.push(program.get("/v1/assets/pump/maintenance"));
    state.push(json!(program.segments("pump")));
    state
}

fn wait_until_known(program: &Program) {
    let ready = program.get("/readyz");
    assert_eq!(ready["raw_recordings"], "ok", "{ready}");
}

#[test]
fn a_backup_runs_beside_the_service_and_newer_recordings_are_imported_again() {
    let place = tempfile::tempdir().unwrap();
    let (folder, copy, elsewhere) =
        (place.path().join("data"), place.path().join("copy"), place.path().join("elsewhere"));
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    let event =
        json!({ "time": "2026-01-01T00:05:30Z", "kind": "sensor_replaced", "by": "A. Fitter" }).to_string();
    let json = [("content-type", "application/json")];
    let answer = program.send("POST", "/v1/assets/pump/maintenance", &json, event.as_bytes());
    assert!(answer.status().is_success(), "{:?}", answer.into_body().read_to_string());
    for n in 0..10 {
        program.upload("pump", n).unwrap();
    }
    on(&folder, &["verify"]).expect_success();
    assert!(
        on(&folder, &["backup", copy.to_str().unwrap()])
            .expect_success()
            .out()
            .contains("10 raw recordings, 10 of them new")
    );
    let at_backup = state(&program);
    for n in 10..14 {
        program.upload("pump", n).unwrap();
    }
    let at_end = state(&program);
    // Raised within a minute of the last record, and at a start.
    program.kill();
    Program::start(&folder).kill();

    on(&elsewhere, &["restore", copy.to_str().unwrap()]).expect_success();
    on(&elsewhere, &["verify"]).expect_success();
    let restored = Program::start(&elsewhere);
    wait_until_known(&restored);
    assert_eq!(state(&restored), at_backup);
    restored.kill();

    // The older database with newer recordings.
    on(&folder, &["restore", copy.to_str().unwrap()]).expect_failure(&["has a database already"]);
    remove_database(&folder);
    on(&folder, &["restore", copy.to_str().unwrap()]).expect_success();
    let older = Program::start(&folder);
    assert!(older.get("/readyz")["raw_recordings"].as_str().unwrap().contains("older"));
    std::thread::sleep(std::time::Duration::from_secs(1));
    older.kill();
    assert_eq!((raw_objects(&folder).len(), quarantined(&folder).len()), (14, 0));
    let output = on(&folder, &["verify"]);
    assert!(
        output.out().contains("no record refers to it") && output.out().contains("older"),
        "{}",
        output.out()
    );
    output.expect_failure(&["5 problems"]);
    assert!(on(&folder, &["rebuild"]).expect_success().out().contains("imported 0 assets and 4 records"));
    on(&folder, &["verify"]).expect_success();
    let whole = Program::start(&folder);
    wait_until_known(&whole);
    assert_eq!(state(&whole), at_end);
    whole.kill();

    // Rebuilds everything from the recordings.
    assert!(
        on(&folder, &["rebuild", "--anew"])
            .expect_success()
            .out()
            .contains("imported 1 assets and 14 records")
    );
    on(&folder, &["verify"]).expect_success();
    let anew = Program::start(&folder);
    wait_until_known(&anew);
    assert_eq!(state(&anew), at_end);
    // A running service locks its folder.
    on(&folder, &["rebuild"]).expect_failure(&["in use"]);
    anew.kill();
}

#[test]
fn missing_damaged_and_unreferenced_objects_are_reported() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("data");
    on(&folder, &["verify"]).expect_failure(&["flankwatch.db"]);
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    for n in 0..3 {
        program.upload("pump", n).unwrap();
    }
    program.kill();
    let objects = raw_objects(&folder);
    std::fs::remove_file(&objects[0]).unwrap();
    let mut bytes = std::fs::read(&objects[1]).unwrap();
    bytes[50] ^= 1;
    std::fs::write(&objects[1], bytes).unwrap();
    let left = folder.join("raw/ab").join(format!("ab{}", "0".repeat(62)));
    std::fs::create_dir_all(left.parent().unwrap()).unwrap();
    std::fs::write(&left, b"left").unwrap();
    let output = on(&folder, &["verify"]);
    let out = output.out();
    for (path, what) in
        [(&objects[0], "missing"), (&objects[1], "damaged"), (&left, "no record refers to it")]
    {
        let name = path.file_name().unwrap().to_str().unwrap();
        assert!(out.contains(&format!("object {name}: {what}")), "{out}");
    }
    output.expect_failure(&["3 problems"]);
}

#[test]
fn recordings_in_quarantine_are_listed_and_restored() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("data");
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    program.upload("pump", 1).unwrap();
    let deleted = program.send("DELETE", "/v1/assets/pump", &[], b"");
    assert_eq!(deleted.status(), 204);
    // Created again, so that its records can be restored.
    program.make(&plain_asset("pump"));
    program.kill();
    let name = quarantined(&folder).pop().unwrap();
    assert!(on(&folder, &["quarantine", "list"]).expect_success().out().contains(&name));
    on(&folder, &["quarantine", "restore", "no-such"]).expect_failure(&["no-such"]);
    on(&folder, &["quarantine", "restore", &name[..12]]).expect_success();
    let output = on(&folder, &["rebuild"]).expect_success().out();
    assert!(output.contains("imported 0 assets and 1 records"), "{output}");
    let program = Program::start(&folder);
    assert_eq!(program.segments("pump").len(), 1);
    program.kill();
}

#[test]
fn deleted_records_that_were_imported_again_stay() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("data");
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    for n in 0..3 {
        program.upload("pump", n).unwrap();
    }
    let deleted = program.send("DELETE", "/v1/assets/pump/segments?to=2026-01-01T00:01:30Z", &[], b"");
    assert_eq!(deleted.status(), 200);
    program.kill();
    on(&folder, &["quarantine", "restore", "--all"]).expect_success();
    for (arguments, imported) in [
        (&["rebuild"][..], "imported 0 assets and 0 records"),
        (&["rebuild", "--with-deleted"], "imported 0 assets and 2 records"),
        (&["rebuild", "--anew"], "imported 1 assets and 3 records"),
    ] {
        let output = on(&folder, arguments).expect_success().out();
        assert!(output.contains(imported), "{arguments:?}: {output}");
    }
    on(&folder, &["verify"]).expect_success();
}
