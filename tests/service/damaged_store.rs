//! What is damaged is named, keeps what is whole from being written over, and heals where the bytes come
//! again.

use std::os::unix::fs::FileExt;

use crate::running::{Service, record};

#[test]
fn a_damaged_database_is_named_and_not_written_to() {
    if std::env::var("FLANKWATCH_TEST_DATABASE").is_ok() {
        return;
    }
    let mut service = Service::start();
    service.plain_asset("pump");
    // So many that the schema lies in the first half of the file.
    for n in 0..120 {
        service.upload("pump", &record("1", n));
    }
    service.stop();
    // What may still be in the log is in the copy.
    let copy = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(flankwatch::store::back_up(service.folder(), copy.path())).unwrap();
    // A new file: a connection of the stopped service that is still closing holds a lock on the old one.
    for file in ["flankwatch.db", "flankwatch.db-wal", "flankwatch.db-shm"] {
        let _ = std::fs::remove_file(service.folder().join(file));
    }
    std::fs::copy(copy.path().join("flankwatch.db"), service.folder().join("flankwatch.db")).unwrap();
    let file = std::fs::OpenOptions::new()
        .read(true)
        .write(true)
        .open(service.folder().join("flankwatch.db"))
        .unwrap();
    let pages = file.metadata().unwrap().len() / 4096;
    // The kind of the page, of every page in the second half.
    for page in pages / 2..pages {
        file.write_all_at(&[0xff], page * 4096).unwrap();
    }
    service.launch();
    let ready = service.get("/readyz").expect(503).json();
    assert!(ready["database"].as_str().unwrap().contains("damaged"), "{ready}");
    let block =
        flankwatch::recording::encode_block(&record("1", 200), flankwatch::recording::BlockEncoding::Json);
    service
        .post("/v1/assets/pump/segments", "application/json", &block)
        .expect_problem(503, &["database", "damaged"]);
    service.delete("/v1/assets/pump").expect_problem(503, &["damaged"]);
    service.get("/healthz").expect(200);
}

#[test]
fn a_raw_recording_that_was_lost_or_damaged_heals_when_its_bytes_come_again() {
    let service = Service::start();
    service.plain_asset("pump");
    let segment = service.upload("pump", &record("1", 1));
    let name = segment["raw"]["sha256"].as_str().unwrap();
    let path = service.folder().join("raw").join(&name[..2]).join(name);
    if !path.exists() {
        // In a bucket.
        return;
    }
    let waveform = format!("/v1/segments/{}/waveform", segment["id"].as_str().unwrap());
    let mut damaged = std::fs::read(&path).unwrap();
    damaged[100] ^= 1;
    for damage in [None, Some(damaged)] {
        match damage {
            None => std::fs::remove_file(&path).unwrap(),
            Some(damaged) => std::fs::write(&path, damaged).unwrap(),
        }
        service.get(&waveform).expect(500);
        assert_eq!(service.upload("pump", &record("1", 1))["id"], segment["id"]);
        service.get(&waveform).expect(200);
    }
}
