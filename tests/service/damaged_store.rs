//! Damage to the store is reported, stops writes to what is intact, and is repaired when the same bytes are
//! uploaded again.

use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::{Duration, Instant};

use flankwatch::recording::{BlockEncoding, encode_block};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;

use crate::running::{Answer, Service, record};

/// Number of stored records: enough that the schema, without which no start succeeds, is a small part of the
/// file.
const RECORDS: u32 = 360;

/// Returns a stopped service with some records and a copy of its database; `None` with a shared database.
fn with_copy() -> Option<(Service, TempDir)> {
    if std::env::var("FLANKWATCH_TEST_DATABASE").is_ok() {
        return None;
    }
    let mut service = Service::start();
    service.plain_asset("pump");
    for n in 0..RECORDS {
        service.upload("pump", &record("1", n));
    }
    service.stop();
    // The copy includes what is still in the log.
    let copy = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(flankwatch::store::back_up(service.folder(), copy.path(), Duration::MAX)).unwrap();
    Some((service, copy))
}

/// Replaces the database and opens its file.
fn put(copy: &Path, folder: &Path) -> std::fs::File {
    // A new file: a connection of the stopped service that is still closing holds a lock on the old one.
    for file in ["flankwatch.db", "flankwatch.db-wal", "flankwatch.db-shm"] {
        let _ = std::fs::remove_file(folder.join(file));
    }
    let path = folder.join("flankwatch.db");
    std::fs::copy(copy.join("flankwatch.db"), &path).unwrap();
    std::fs::OpenOptions::new().read(true).write(true).open(path).unwrap()
}

/// Waits until the service reports not ready, which on a busy machine may be after the start.
fn not_ready(service: &Service) -> Option<Answer> {
    (0..100).find_map(|_| {
        let answer = service.get("/readyz");
        std::thread::sleep(Duration::from_millis(100));
        (answer.status == 503).then_some(answer)
    })
}

#[test]
fn a_damaged_database_is_reported_and_not_written_to() {
    let Some((mut service, copy)) = with_copy() else { return };
    let file = put(copy.path(), service.folder());
    let pages = file.metadata().unwrap().len() / 4096;
    // The kind of the page, of every page in the second half.
    for page in pages / 2..pages {
        file.write_all_at(&[0xff], page * 4096).unwrap();
    }
    service.launch();
    let ready = not_ready(&service).expect("not ready within 10 s").json();
    assert!(ready["database"].as_str().unwrap().contains("damaged"), "{ready}");
    let block = encode_block(&record("1", RECORDS), BlockEncoding::Json);
    service
        .post("/v1/assets/pump/segments", "application/json", &block)
        .expect_problem(503, &["database", "damaged"]);
    service.delete("/v1/assets/pump").expect_problem(503, &["damaged"]);
    service.get("/healthz").expect(200);
}

#[test]
fn a_database_with_another_header_is_refused_at_once() {
    let Some((mut service, copy)) = with_copy() else { return };
    put(copy.path(), service.folder()).write_all_at(b"no database at all", 0).unwrap();
    let began = Instant::now();
    let refusal = service.try_launch().unwrap_err();
    assert!(refusal.contains("flankwatch.db") && refusal.contains("header"), "{refusal}");
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
    put(copy.path(), service.folder());
    service.launch();
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], RECORDS);
}

#[test]
fn flipped_bits_of_a_database_are_reported_and_nothing_hangs() {
    let Some((mut service, copy)) = with_copy() else { return };
    let mut started = 0;
    for seed in 0..8 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let file = put(copy.path(), service.folder());
        let bytes = file.metadata().unwrap().len();
        // The schema is in the first pages; without it nothing starts.
        let first = if seed % 2 == 0 { 0 } else { bytes / 4 };
        for _ in 0..200 {
            let place = random.random_range(first..bytes);
            let mut byte = [0];
            file.read_exact_at(&mut byte, place).unwrap();
            byte[0] ^= 1 << random.random_range(0..8);
            file.write_all_at(&byte, place).unwrap();
        }
        drop(file);
        if let Err(refusal) = service.try_launch() {
            let names = ["flankwatch.db", "data folder"];
            assert!(names.iter().any(|name| refusal.contains(name)), "seed {seed}: {refusal}");
            continue;
        }
        started += 1;
        let ready = not_ready(&service).unwrap_or_else(|| panic!("seed {seed}: not found")).json();
        assert!(ready["database"].as_str().unwrap().contains("damaged"), "seed {seed}: {ready}");
        for what in ["", "/pump", "/pump/segments", "/pump/indicators", "/pump/wear", "/pump/wear/history"] {
            let answer = service.get(&format!("/v1/assets{what}"));
            if answer.status >= 500 {
                let detail = answer.json()["detail"].as_str().unwrap_or_default().to_owned();
                assert!(detail.contains("damaged"), "seed {seed}, {what}: {detail}");
            }
        }
        let block = encode_block(&record("1", RECORDS), BlockEncoding::Json);
        let answer = service.post("/v1/assets/pump/segments", "application/json", &block);
        assert_eq!(answer.status, 503, "seed {seed}");
        service.stop();
    }
    assert!(started > 0);
}

#[test]
fn a_lost_or_damaged_raw_recording_is_restored_by_a_repeated_upload() {
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
