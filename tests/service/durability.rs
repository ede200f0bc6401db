//! After a restart, everything that was acknowledged exists, and nothing else.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::running::{Service, record};

fn everything(service: &Service) -> Vec<Value> {
    let mut all = vec![
        service.get("/v1/assets").expect(200).json(),
        service.get("/v1/assets/pump/wear").expect(200).json(),
        service.get("/v1/assets/pump/wear/history").expect(200).json(),
        service.get("/v1/assets/pump/indicators").expect(200).json(),
    ];
    let list = service.get("/v1/assets/pump/segments").expect(200).json();
    for item in list["items"].as_array().unwrap() {
        let path = format!("/v1/segments/{}", item["id"].as_str().unwrap());
        all.push(service.get(&path).expect(200).json());
        all.push(service.get(&format!("{path}/waveform")).expect(200).json());
    }
    all.push(list);
    all
}

#[test]
fn a_restart_loses_nothing_and_the_history_continues() {
    let mut service = Service::start();
    service.plain_asset("pump");
    service.plain_asset("never-stopped");
    for n in 0..10 {
        service.upload("pump", &record("1", n));
        service.upload("never-stopped", &record("1", n));
    }
    let before = everything(&service);
    service.restart();
    assert_eq!(everything(&service), before);
    for n in 10..14 {
        service.upload("pump", &record("1", n));
        service.upload("never-stopped", &record("1", n));
        service.restart();
    }
    let history = |asset: &str| {
        let mut history = service.get(&format!("/v1/assets/{asset}/wear/history")).expect(200).json();
        for item in history["items"].as_array_mut().unwrap() {
            item.as_object_mut().unwrap().remove("segment_id");
        }
        history
    };
    assert_eq!(history("pump"), history("never-stopped"));
}

#[test]
fn a_damaged_raw_object_is_reported_and_never_returned() {
    let service = Service::start();
    service.plain_asset("pump");
    let segment = service.upload("pump", &record("1", 1));
    let name = segment["raw"]["sha256"].as_str().unwrap();
    let path = service.folder().join("raw").join(&name[..2]).join(name);
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let id = segment["id"].as_str().unwrap();
    service.get(&format!("/v1/segments/{id}/waveform")).expect_problem(500, &["damaged", name]);
    service.get(&format!("/v1/segments/{id}")).expect(200);
}

/// Returns the raw objects on the disk, in folders named by two hexadecimal digits.
pub(crate) fn raw_objects(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for shard in std::fs::read_dir(folder.join("raw")).unwrap() {
        let shard = shard.unwrap();
        if shard.file_name().len() != 2 {
            continue;
        }
        for object in std::fs::read_dir(shard.path()).unwrap() {
            let path = object.unwrap().path();
            if path.extension().is_none() {
                found.push(path);
            }
        }
    }
    found
}

/// Returns the names of the raw objects in quarantine.
pub(crate) fn quarantined(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder.join("raw/quarantine")) else {
        return Vec::new();
    };
    let name = |entry: std::io::Result<std::fs::DirEntry>| {
        entry.unwrap().path().extension().unwrap().to_str().unwrap().to_owned()
    };
    entries.map(name).collect()
}

#[test]
fn a_start_cleans_up_after_an_earlier_run() {
    let mut service = Service::start();
    service.plain_asset("pump");
    let kept = service.upload("pump", &record("1", 1))["raw"]["sha256"].as_str().unwrap().to_owned();
    let orphan = service.folder().join("raw/ab").join(format!("ab{}", "0".repeat(62)));
    let unfinished = [service.folder().join("raw/tmp/7"), service.folder().join("uploads/3")];
    service.stop();
    std::fs::create_dir_all(orphan.parent().unwrap()).unwrap();
    for path in unfinished.iter().chain([&orphan]) {
        std::fs::write(path, b"left behind").unwrap();
    }
    service.launch();
    assert!(unfinished.iter().all(|path| !path.exists()));
    let began = std::time::Instant::now();
    while orphan.exists() {
        assert!(began.elapsed().as_secs() < 60, "the orphan is still there");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let left = raw_objects(service.folder());
    assert!(left.len() == 1 && left[0].ends_with(&kept), "{left:?}");
    assert_eq!(quarantined(service.folder()), [orphan.file_name().unwrap().to_str().unwrap()]);
}

#[test]
fn the_quota_removes_the_oldest_raw_recordings_but_not_their_results() {
    let service = Service::start_with(|config| {
        config.work.quotas.bytes_per_asset = Some(100_000);
        config.work.quotas.bytes = Some(150_000);
    });
    for asset in ["pump", "fan"] {
        service.plain_asset(asset);
    }
    // Some 20 kB each as JSON: later times first, so that age is by the record's time and not by receipt.
    let mut segments = Vec::new();
    for n in (0..12).rev() {
        segments.push(service.upload("pump", &record("1", n)));
    }
    let bytes = segments[0]["raw"]["bytes"].as_u64().unwrap();
    // A file may be removed between being listed and being read.
    let kept = |service: &Service| -> u64 {
        let found = raw_objects(service.folder());
        found.iter().filter_map(|path| path.metadata().ok()).map(|found| found.len()).sum()
    };
    let wait_below = |most: u64| {
        let began = std::time::Instant::now();
        while kept(&service) > most {
            assert!(began.elapsed().as_secs() < 60, "{} bytes are kept", kept(&service));
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    };
    wait_below(100_000);
    assert!(kept(&service) > 100_000 - 2 * bytes, "more than needed was given up");
    segments.reverse();
    let waveform =
        |segment: &Value| service.get(&format!("/v1/segments/{}/waveform", segment["id"].as_str().unwrap()));
    waveform(&segments[0]).expect_problem(410, &["no longer available"]);
    waveform(&segments[11]).expect(200);
    let shown =
        service.get(&format!("/v1/segments/{}", segments[0]["id"].as_str().unwrap())).expect(200).json();
    assert_eq!(shown["indicators"], segments[0]["indicators"]);
    // Answers on many records go without what needs the bytes.
    let export = service.get("/v1/assets/pump/export?spectra=12").expect(200);
    let summary = mcap::Summary::read(&export.bytes).unwrap().unwrap();
    let messages = |kind: &str| {
        let topic = format!("/pump/1/{kind}");
        let (id, _) = summary.channels.iter().find(|(_, channel)| channel.topic == topic).unwrap();
        summary.stats.as_ref().unwrap().channel_message_counts[id]
    };
    let has_raw = segments.iter().filter(|segment| waveform(segment).status == 200).count();
    assert!((1..12).contains(&has_raw));
    assert_eq!((messages("indicators"), messages("spectrum")), (12, has_raw as u64));
    let waterfall = service.get("/v1/assets/pump/waterfall").expect(200).json();
    let rows = waterfall["items"].as_array().unwrap();
    assert_eq!(rows.len(), 12);
    assert_eq!(rows.iter().filter(|row| !row["level_db"].is_null()).count(), has_raw);
    // A repeat is answered with what is stored, and does not bring the bytes back.
    assert_eq!(service.upload("pump", &record("1", 0))["id"], segments[0]["id"]);
    for n in 20..26 {
        service.upload("fan", &record("1", n));
    }
    wait_below(150_000);
    assert_eq!(
        service.get("/v1/assets/fan/indicators").expect(200).json()["items"].as_array().unwrap().len(),
        6
    );
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 12);
}

#[test]
fn a_stopping_service_finishes_uploads_and_accepts_no_new_ones() {
    let mut service = Service::start();
    service.plain_asset("pump");
    let stored = std::sync::Mutex::new(Vec::new());
    let url = service.url("/v1/assets/pump/segments");
    let next = std::sync::atomic::AtomicU32::new(0);
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let agent: ureq::Agent =
                    ureq::Agent::config_builder().http_status_as_error(false).build().into();
                loop {
                    let n = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    let block = flankwatch::recording::encode_block(
                        &record("1", n),
                        flankwatch::recording::BlockEncoding::Protobuf,
                    );
                    let sent = agent.post(&url).content_type("application/x-protobuf").send(&block[..]);
                    let Ok(mut response) = sent else { break };
                    assert_eq!(response.status().as_u16(), 201);
                    // A started response is completed.
                    let segment: Value =
                        serde_json::from_str(&response.body_mut().read_to_string().unwrap()).unwrap();
                    stored.lock().unwrap().push(segment["id"].as_str().unwrap().to_owned());
                }
            });
        }
        while stored.lock().unwrap().len() < 20 {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let began = std::time::Instant::now();
        service.stop();
        assert!(began.elapsed() < std::time::Duration::from_secs(31), "longer than the time of grace");
    });
    service.launch();
    for id in stored.into_inner().unwrap() {
        service.get(&format!("/v1/segments/{id}")).expect(200);
    }
}
