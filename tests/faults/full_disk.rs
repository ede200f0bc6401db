//! A full disk: nothing is lost, everything can be read, and writes resume when there is room.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};

use crate::resumable_client::{begin, expect_read, offset, patch, pieces, recording};
use crate::running::{Service, mcap, plain_asset, record};
use flankwatch_test_support::needed;

/// A small file system in memory, unmounted on drop.
struct SmallDisk {
    folder: PathBuf,
    _parent: tempfile::TempDir,
}

impl SmallDisk {
    fn mount() -> Option<Self> {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("disk");
        std::fs::create_dir(&folder).unwrap();
        let mounted =
            Command::new("mount").args(["-t", "tmpfs", "-o", "size=4m", "tmpfs"]).arg(&folder).output();
        mounted.is_ok_and(|output| output.status.success()).then_some(Self { folder, _parent: parent })
    }

    fn path(&self) -> &Path {
        &self.folder
    }

    /// Fills the disk; removing the returned file frees the space.
    fn fill(&self) -> PathBuf {
        let path = self.folder.join("filling");
        let mut file = std::fs::File::create(&path).unwrap();
        while file.write_all(&[1; 4096]).is_ok() {}
        path
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("--lazy").arg(&self.folder).status();
    }
}

fn raw_objects(folder: &Path) -> usize {
    let shards = std::fs::read_dir(folder.join("raw")).unwrap();
    let shards = shards.map(Result::unwrap).filter(|shard| shard.file_name().len() == 2);
    // A file may be removed between being listed and being read.
    let objects = shards.filter_map(|shard| std::fs::read_dir(shard.path()).ok()).flatten().flatten();
    // Skips the metadata files beside the objects.
    objects.filter(|object| object.path().extension().is_none()).count()
}

#[test]
#[ignore = "needs the right to mount a file system"]
fn a_full_disk_is_answered_with_507_and_the_service_recovers() {
    let disk = needed(SmallDisk::mount(), "the right to mount a small file system");
    let ballast = disk.path().join("ballast");
    std::fs::write(&ballast, vec![1; 2 << 20]).unwrap();
    let mut service = Service::start_at(disk.path());
    service.plain_asset("pump");
    let mut stored = Vec::new();
    let mut refused = 0;
    for n in 0..200 {
        let block =
            flankwatch::recording::encode_block(&record("1", n), flankwatch::recording::BlockEncoding::Json);
        let answer = service.post("/v1/assets/pump/segments", "application/json", &block);
        if answer.status == 507 {
            assert_eq!(answer.header("retry-after"), "60");
            answer.expect_problem(507, &[]);
            refused += 1;
            if refused == 5 {
                break;
            }
        } else {
            stored.push(answer.expect(201).json()["id"].as_str().unwrap().to_owned());
        }
    }
    assert_eq!(refused, 5, "{} records went in", stored.len());
    let is_readable = |service: &Service, stored: &[String]| {
        service.get("/healthz").expect(200);
        assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], stored.len());
        for id in stored {
            service.get(&format!("/v1/segments/{id}/waveform")).expect(200);
        }
    };
    is_readable(&service, &stored);
    let ready = service.get("/readyz").expect(503).json();
    assert!(ready["free_space"].as_str().unwrap().contains("write"), "{ready}");
    service.get("/v1/assets/pump/export").expect(200);
    // The object of a record whose rows did not fit is removed.
    let began = std::time::Instant::now();
    while raw_objects(service.folder()) > stored.len() {
        assert!(began.elapsed().as_secs() < 60, "{} raw objects", raw_objects(service.folder()));
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    std::fs::remove_file(&ballast).unwrap();
    // The health check's result is cached for a moment.
    let began = std::time::Instant::now();
    while service.get("/readyz").status != 200 {
        assert!(began.elapsed().as_secs() < 20, "still not ready");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    for n in 200..210 {
        stored.push(service.upload("pump", &record("1", n))["id"].as_str().unwrap().to_owned());
    }
    is_readable(&service, &stored);
    service.restart();
    is_readable(&service, &stored);
    service.stop();
}

#[test]
#[ignore = "needs the right to mount a file system"]
fn a_resumable_upload_waits_while_the_disk_is_full() {
    let disk = needed(SmallDisk::mount(), "the right to mount a small file system");
    let mut service = Service::start_at(disk.path());
    service.plain_asset("pump");
    let whole = recording(0, 20);
    let paths = [begin(&service, whole.len()), begin(&service, whole.len())];
    let at = whole.len() - 1;
    for path in &paths {
        patch(&service, path, 0, &whole[..at]).expect(204);
    }
    let filling = disk.fill();
    // A part that does not fit is not counted.
    patch(&service, &paths[0], at, &whole[at..]).expect_problem(507, &[]);
    assert_eq!(offset(&service, &paths[0]), at);
    // Room for the parts and their rows, but not for the records.
    let file = std::fs::OpenOptions::new().write(true).open(&filling).unwrap();
    file.set_len(file.metadata().unwrap().len() - (64 << 10)).unwrap();
    drop(file);
    for path in &paths {
        patch(&service, path, at, &whole[at..]).expect(204);
        let waiting = service.wait_for(path, |upload| upload["waits_for"] != Value::Null);
        assert_eq!((&waiting["state"], &waiting["error"]), (&"reading".into(), &Value::Null), "{waiting}");
        assert_eq!(offset(&service, path), whole.len());
    }
    // A waiting upload may be deleted, which frees space.
    service.send("DELETE", &paths[1], &[("tus-resumable", "1.0.0")], b"").expect(204);
    assert!(!pieces(&service, &paths[1]).exists());
    std::fs::remove_file(filling).unwrap();
    expect_read(&service, &paths[0], 20);
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 20);
    assert!(!pieces(&service, &paths[0]).exists());
    service.restart();
    expect_read(&service, &paths[0], 20);
}

#[test]
#[ignore = "needs the right to mount a file system"]
fn a_recomputation_that_fills_the_disk_is_repeated_when_there_is_room() {
    let disk = needed(SmallDisk::mount(), "the right to mount a small file system");
    let mut service = Service::start_at(disk.path());
    service.plain_asset("pump");
    let records: Vec<_> = (0..60).map(|n| record("1", n)).collect();
    service.post("/v1/assets/pump/segments", "application/mcap", &mcap(&records)).expect(201);
    let filling = disk.fill();
    let file = std::fs::OpenOptions::new().write(true).open(&filling).unwrap();
    let make_room = || file.set_len(file.metadata().unwrap().len() - (16 << 10)).unwrap();
    let mut description = plain_asset("pump");
    description["bands"] = json!([{ "name": "mesh", "band_hz": [200, 400] }]);
    // Room for the description, and then for a part of the new history.
    while service.put_json("/v1/assets/pump", &description).status == 507 {
        make_room();
    }
    make_room();
    let state = |list: &Value| list["items"][0]["state"].clone();
    service.wait_for("/v1/recomputations?asset=pump", |list| state(list) == "failed");
    let indicators = || service.get("/v1/assets/pump/indicators").expect(200).json();
    assert_eq!(indicators()["items"].as_array().unwrap().len(), 60);
    drop(file);
    std::fs::remove_file(filling).unwrap();
    service.wait_for("/v1/recomputations?asset=pump", |list| state(list) == "finished");
    assert!(indicators()["items"].as_array().unwrap().iter().all(|item| item["band_mesh"].is_number()));
    service.stop();
}
