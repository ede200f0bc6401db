//! Raw recordings survive the loss of the database.

use std::path::Path;

use crate::durability::{quarantined, raw_objects};
use crate::running::{Service, record};

/// Whether the database is outside the folder, so that it cannot be lost with it.
fn is_elsewhere() -> bool {
    std::env::var("FLANKWATCH_TEST_DATABASE").is_ok()
}

fn move_database(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for name in ["flankwatch.db", "flankwatch.db-wal", "flankwatch.db-shm"] {
        let _ = std::fs::remove_file(to.join(name));
        if from.join(name).exists() {
            std::fs::rename(from.join(name), to.join(name)).unwrap();
        }
    }
}

/// Waits until the scan for unreferenced objects is complete.
fn wait_for_sweep() {
    std::thread::sleep(std::time::Duration::from_millis(1500));
}

#[test]
fn a_lost_database_leaves_raw_recordings_in_place() {
    if is_elsewhere() {
        return;
    }
    let mut service = Service::start();
    service.plain_asset("pump");
    for n in 0..5 {
        service.upload("pump", &record("1", n));
    }
    service.stop();
    let lost = tempfile::tempdir().unwrap();
    move_database(service.folder(), lost.path());
    for _ in 0..2 {
        service.launch();
        let ready = service.get("/readyz").expect(200).json();
        assert!(ready["raw_recordings"].as_str().unwrap().contains("rebuild"), "{ready}");
        wait_for_sweep();
        service.stop();
        assert_eq!(raw_objects(service.folder()).len(), 5);
        assert!(quarantined(service.folder()).is_empty());
    }
    // The matching database is accepted again.
    move_database(lost.path(), service.folder());
    service.launch();
    assert_eq!(service.get("/readyz").expect(200).json()["raw_recordings"], "ok");
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 5);
}

#[test]
fn an_older_database_leaves_newer_raw_recordings_in_place() {
    if is_elsewhere() {
        return;
    }
    let mut service = Service::start_with(|config| config.work.quotas.bytes = Some(1));
    service.plain_asset("pump");
    service.stop();
    let older = tempfile::tempdir().unwrap();
    for file in std::fs::read_dir(service.folder()).unwrap() {
        let path = file.unwrap().path();
        if path.file_name().unwrap().to_str().unwrap().starts_with("flankwatch.db") {
            std::fs::copy(&path, older.path().join(path.file_name().unwrap())).unwrap();
        }
    }
    service.launch();
    service.stop();
    // Objects that the older database does not have.
    let name = format!("ab{}", "1".repeat(62));
    std::fs::create_dir_all(service.folder().join("raw/ab")).unwrap();
    std::fs::write(service.folder().join("raw/ab").join(name), b"newer").unwrap();
    move_database(older.path(), service.folder());
    service.launch();
    let ready = service.get("/readyz").expect(200).json();
    assert!(ready["raw_recordings"].as_str().unwrap().contains("older"), "{ready}");
    wait_for_sweep();
    // A quota or the deletion of the asset does not remove them either.
    service.upload("pump", &record("1", 7));
    service.delete("/v1/assets/pump").expect(204);
    wait_for_sweep();
    assert_eq!(raw_objects(service.folder()).len(), 2);
    assert!(quarantined(service.folder()).is_empty());
}

#[test]
fn raw_recordings_of_a_deleted_asset_stay_in_quarantine_for_the_configured_time() {
    let mut service = Service::start();
    service.plain_asset("pump");
    let name = service.upload("pump", &record("1", 1))["raw"]["sha256"].as_str().unwrap().to_owned();
    service.delete("/v1/assets/pump").expect(204);
    assert!(raw_objects(service.folder()).is_empty());
    assert_eq!(quarantined(service.folder()), [name]);
    service.stop();
    // Makes the object 31 days old.
    let folder = service.folder().join("raw/quarantine");
    let path = std::fs::read_dir(&folder).unwrap().next().unwrap().unwrap().path();
    let long_ago = jiff::Timestamp::now() - jiff::SignedDuration::from_hours(31 * 24);
    let name = path.extension().unwrap().to_str().unwrap();
    std::fs::rename(&path, folder.join(format!("{}.{name}", long_ago.strftime("%Y%m%dT%H%M%SZ")))).unwrap();
    service.launch();
    let began = std::time::Instant::now();
    while !quarantined(service.folder()).is_empty() && !is_elsewhere() {
        assert!(began.elapsed().as_secs() < 60, "it is still in quarantine");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
}
