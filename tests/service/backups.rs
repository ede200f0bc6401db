//! A data folder backed up, restored, verified, and rebuilt from its raw recordings.

use std::path::Path;
use std::time::{Duration, Instant};

use flankwatch::store::{Finding, Store, StoreSettings};
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
    std::thread::sleep(Duration::from_secs(1));
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
            .contains("imported 1 asset and 14 records")
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
    assert!(output.contains("imported 0 assets and 1 record,"), "{output}");
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
        (&["rebuild", "--anew"], "imported 1 asset and 3 records"),
    ] {
        let output = on(&folder, arguments).expect_success().out();
        assert!(output.contains(imported), "{arguments:?}: {output}");
    }
    on(&folder, &["verify"]).expect_success();
}

#[test]
fn what_users_entered_after_a_backup_survives_a_restore_into_the_same_folder() {
    let place = tempfile::tempdir().unwrap();
    let (folder, copy) = (place.path().join("data"), place.path().join("copy"));
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    for n in 0..8 {
        program.upload("pump", n).unwrap();
    }
    on(&folder, &["backup", copy.to_str().unwrap()]).expect_success();
    let json = [("content-type", "application/json")];
    let event =
        json!({ "time": "2026-01-01T00:05:30Z", "kind": "sensor_replaced", "by": "A. Fitter" }).to_string();
    let mut description = plain_asset("pump");
    description["location"] = json!({ "machine": "Mill 2" });
    for (method, path, body) in [
        ("POST", "/v1/assets/pump/maintenance", event),
        ("PUT", "/v1/assets/pump", description.to_string()),
        ("DELETE", "/v1/assets/pump/segments?to=2026-01-01T00:01:30Z", String::new()),
    ] {
        let answer = program.send(method, path, &json, body.as_bytes());
        assert!(answer.status().is_success(), "{path}: {:?}", answer.into_body().read_to_string());
    }
    let url = program.url();
    let hour = ["--from", "2026-01-01T00:03:00Z", "--to", "2026-01-01T00:04:30Z"];
    flankwatch(&[&["exclude", "--url", url, "--asset", "pump"], &hour[..]].concat()).expect_success();
    let state_with_asset = |program: &Program| {
        let mut asset = program.get("/v1/assets/pump");
        asset.as_object_mut().unwrap().remove("summary");
        (asset, state(program))
    };
    // The history is folded again in the background.
    let began = Instant::now();
    let excluded = |estimates: &Value| {
        estimates.as_array().unwrap().iter().filter(|estimate| estimate["status"] == "excluded").count()
    };
    while excluded(&program.history("pump")[0]) < 2 {
        assert!(began.elapsed().as_secs() < 60, "{:?}", program.history("pump"));
        std::thread::sleep(Duration::from_millis(50));
    }
    let at_end = state_with_asset(&program);
    program.kill();

    remove_database(&folder);
    on(&folder, &["restore", copy.to_str().unwrap()]).expect_success();
    let output = on(&folder, &["rebuild"]).expect_success().out();
    assert!(
        output.contains("imported 0 assets and 0 records, updated 1 asset, deleted 2 records"),
        "{output}"
    );
    on(&folder, &["verify"]).expect_success();
    let restored = Program::start(&folder);
    wait_until_known(&restored);
    let began = Instant::now();
    while state_with_asset(&restored) != at_end {
        assert!(began.elapsed().as_secs() < 60, "{:?} is not {at_end:?}", state_with_asset(&restored));
        std::thread::sleep(Duration::from_millis(50));
    }
    restored.kill();
}

#[test]
fn a_nightly_backup_is_verified_after_records_are_deleted() {
    let place = tempfile::tempdir().unwrap();
    let (folder, copy, elsewhere) =
        (place.path().join("data"), place.path().join("copy"), place.path().join("elsewhere"));
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    for n in 0..4 {
        program.upload("pump", n).unwrap();
    }
    on(&folder, &["backup", copy.to_str().unwrap()]).expect_success();
    let deleted = program.send("DELETE", "/v1/assets/pump/segments?to=2026-01-01T00:00:30Z", &[], b"");
    assert_eq!(deleted.status(), 200);
    let output = on(&folder, &["backup", copy.to_str().unwrap()]).expect_success().out();
    assert!(output.contains("1 raw recording moved into quarantine"), "{output}");
    let output = on(&copy, &["verify"]).expect_success().out();
    assert!(
        output.contains("3 records, 3 raw recordings of") && output.contains("1 in quarantine"),
        "{output}"
    );
    on(&elsewhere, &["restore", copy.to_str().unwrap()]).expect_success();
    on(&elsewhere, &["verify"]).expect_success();

    // The asset is deleted too.
    assert_eq!(program.send("DELETE", "/v1/assets/pump", &[], b"").status(), 204);
    on(&folder, &["backup", copy.to_str().unwrap()]).expect_success();
    on(&copy, &["verify"]).expect_success();
    assert!(!copy.join("raw/assets/pump.json").exists());
    program.kill();
}

#[test]
fn a_record_that_is_deleted_while_it_is_verified_is_no_problem() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("data");
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    for n in 0..60 {
        program.upload("pump", n).unwrap();
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let settings = StoreSettings::Folder(folder.clone());
    let store = runtime.block_on(Store::open_to_read(&settings)).unwrap();
    std::thread::scope(|scope| {
        let deleting = scope.spawn(|| {
            for id in program.segments("pump").keys() {
                assert_eq!(program.send("DELETE", &format!("/v1/segments/{id}"), &[], b"").status(), 204);
            }
        });
        while !deleting.is_finished() {
            let audit = runtime.block_on(store.audit(false, Duration::ZERO)).unwrap();
            let unread = audit.findings.iter().find(|found| matches!(found, Finding::Record { .. }));
            assert_eq!(unread, None);
        }
    });
    runtime.block_on(store.close());
    program.kill();
}

#[test]
fn a_rebuild_waits_where_few_records_are_taken_at_once() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("data");
    let program = Program::start(&folder);
    program.make(&plain_asset("pump"));
    for n in 0..12 {
        program.upload("pump", n).unwrap();
    }
    program.kill();
    let config = place.path().join("flankwatch.toml");
    std::fs::write(&config, "[limits]\nrequests_at_once = 2\n").unwrap();
    let output = on(&folder, &["rebuild", "--anew", "--config", config.to_str().unwrap()]);
    assert!(output.expect_success().out().contains("imported 1 asset and 12 records"));
}
