//! Libraries are simulated in the background: records are stored meanwhile, and their wear is estimated
//! afterwards.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use flankwatch::gear::PairSpec;
use flankwatch::library::{EnsembleSettings, GridSettings, library_id};
use serde_json::{Value, json};

use crate::running::{Service, asset_with_pair, plain_asset, record};

/// Returns the path of an asset's library.
fn library_path(service: &Service, asset: &Value) -> PathBuf {
    let pair: PairSpec = serde_json::from_value(asset["gear"]["pair"].clone()).unwrap();
    let id = library_id(&pair, &GridSettings::default().for_pair(&pair));
    service.folder().join("libraries").join(id).with_extension("fwlib")
}

/// Blocks a simulation when it reads the checkpoint of an earlier one: a pipe takes the checkpoint's place.
struct HeldSimulation {
    pipe: PathBuf,
}

impl HeldSimulation {
    fn of(library: &Path) -> Self {
        let pipe = library.with_extension("fwlib.parts");
        fs::create_dir_all(pipe.parent().unwrap()).unwrap();
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        Self { pipe }
    }

    /// Releases the simulation, once it is blocked.
    fn let_go(self) {
        let writer = File::options().write(true).open(&self.pipe).unwrap();
        fs::remove_file(&self.pipe).unwrap();
        drop(writer);
    }
}

fn history(service: &Service, asset: &str) -> Vec<Value> {
    let mut history = service.get(&format!("/v1/assets/{asset}/wear/history?channel=1")).expect(200).json();
    let items = history["items"].as_array_mut().unwrap();
    items.iter_mut().for_each(|item| drop(item.as_object_mut().unwrap().remove("segment_id")));
    std::mem::take(items)
}

#[track_caller]
fn wait_for_library(service: &Service, asset: &str, state: &str) -> Value {
    let path = format!("/v1/assets/{asset}");
    service.wait_for(&path, |asset| asset["summary"]["library_state"] == state)["summary"].clone()
}

/// Waits until all records of an asset have a status or, if `is` is false, none has it.
#[track_caller]
fn wait_for_status(service: &Service, asset: &str, status: &str, is: bool) {
    service.wait_for(&format!("/v1/assets/{asset}/wear/history"), |history| {
        let mut items = history["items"].as_array().unwrap().iter();
        items.all(|item| (item["status"] == status) == is)
    });
}

#[test]
fn records_of_a_new_asset_are_stored_while_its_library_is_simulated() {
    let service = Service::start_with(|config| config.work.requests_at_once = 2);
    service.plain_asset("other");
    let asset = asset_with_pair("new", 21.0);
    let held = HeldSimulation::of(&library_path(&service, &asset));
    service.post_json("/v1/assets", &asset).expect(201);
    for n in 0..14 {
        let segment = service.upload("new", &record("1", n));
        assert_eq!(segment["wear"]["status"], "awaiting_library", "{segment}");
        let reason = segment["wear"]["reason"].as_str().unwrap();
        assert!(reason.contains("being simulated"), "{reason}");
        assert!(segment["indicators"]["rms"].is_number() && segment["features"].is_object(), "{segment}");
        service.upload("other", &record("1", n));
    }
    let late = service.upload("new", &record("2", 0));
    assert_eq!(late["wear"]["baseline"], json!({ "have": 1, "need": 8 }));
    let summary = &service.get("/v1/assets/new").expect(200).json()["summary"];
    assert_eq!(
        (&summary["library_state"], &summary["simulation"]["stage"], &summary["category"]),
        (&json!("building"), &json!("library"), &json!("check_function")),
        "{summary}"
    );
    held.let_go();
    let summary = wait_for_library(&service, "new", "ready");
    assert_eq!(summary["simulation"], Value::Null);
    wait_for_status(&service, "new", "awaiting_library", false);
    // The same as if the library had existed from the start.
    let mut after = asset.clone();
    after["id"] = json!("after");
    service.post_json("/v1/assets", &after).expect(201);
    for n in 0..14 {
        service.upload("after", &record("1", n));
    }
    let history = history(&service, "new");
    assert_eq!(history, self::history(&service, "after"));
    assert!(history.iter().any(|item| item["median_um"].is_number()), "{history:?}");
}

#[test]
fn a_description_is_answered_with_the_expected_time_of_its_simulation() {
    let mut service = Service::start();
    let asset = asset_with_pair("first", 40.0);
    let held = HeldSimulation::of(&library_path(&service, &asset));
    let answer = service.post_json("/v1/assets", &asset).expect(201).json();
    let assumed_s = answer["summary"]["library_estimated_s"].as_f64().unwrap();
    assert!(assumed_s > 0.0, "{answer}");
    let mut renamed = asset.clone();
    renamed["name"] = json!("feed pump");
    let answer = service.put_json("/v1/assets/first", &renamed).expect(200).json();
    assert_eq!(answer["summary"]["library_estimated_s"], assumed_s);
    held.let_go();
    let summary = wait_for_library(&service, "first", "ready");
    assert!(summary.get("library_estimated_s").is_none(), "{summary}");
    let answer = service.post_json("/v1/assets", &plain_asset("without-pair")).expect(201).json();
    assert!(answer["summary"].get("library_estimated_s").is_none(), "{answer}");

    // The next one has the measured speed of the first one; this one is not held.
    let began = Instant::now();
    let answer = service.post_json("/v1/assets", &asset_with_pair("second", 41.0)).expect(201).json();
    let _ = wait_for_library(&service, "second", "ready");
    let (third, took_s) = (asset_with_pair("third", 42.0), began.elapsed().as_secs_f64());
    assert!(answer["summary"]["library_estimated_s"].as_f64().is_some_and(|s| s > 0.0), "{answer}");
    let answer = service.post_json("/v1/assets", &third).expect(201).json();
    let expected_s = answer["summary"]["library_estimated_s"].as_f64().unwrap();
    assert!(expected_s != assumed_s && expected_s < took_s, "{expected_s} s, took {took_s} s");

    // A library of a deleted asset is still in the folder.
    service.delete("/v1/assets/first").expect(204);
    service.restart();
    let answer = service.post_json("/v1/assets", &asset).expect(201).json();
    assert!(answer["summary"]["library_estimated_s"].as_f64().is_none_or(|s| s == 0.0), "{answer}");
}

#[test]
fn an_asset_whose_library_fails_stores_records_and_reports_the_reason() {
    let service = Service::start();
    let mut asset = asset_with_pair("pump", 22.0);
    let path = library_path(&service, &asset);
    // A folder takes the file's place.
    fs::create_dir_all(&path).unwrap();
    service.post_json("/v1/assets", &asset).expect(201);
    service.upload("pump", &record("1", 0));
    let summary = wait_for_library(&service, "pump", "failed");
    let reason = summary["library_error"].as_str().unwrap();
    assert!(reason.contains("fwlib"), "{reason}");
    for n in 1..12 {
        let segment = service.upload("pump", &record("1", n));
        assert_eq!(segment["wear"]["status"], "library_failed", "{segment}");
        assert!(segment["wear"]["reason"].as_str().unwrap().contains(reason), "{segment}");
    }
    wait_for_status(&service, "pump", "library_failed", true);
    assert_eq!(
        service.get("/v1/assets/pump").expect(200).json()["summary"]["category"],
        "out_of_specification"
    );
    // The same description does not retry, another one does.
    fs::remove_dir(&path).unwrap();
    service.put_json("/v1/assets/pump", &asset).expect(200);
    let summary = &service.get("/v1/assets/pump").expect(200).json()["summary"];
    assert_eq!(summary["library_state"], "failed");
    asset["name"] = json!("feed pump");
    service.put_json("/v1/assets/pump", &asset).expect(200);
    wait_for_library(&service, "pump", "ready");
    service.wait_for("/v1/assets/pump/wear/history", |history| {
        let mut items = history["items"].as_array().unwrap().iter();
        items.any(|item| item["median_um"].is_number())
    });
}

#[test]
fn a_failed_pair_is_retried_with_another_description_but_not_after_a_restart() {
    let mut service = Service::start();
    let mut asset = asset_with_pair("pump", 26.0);
    let path = library_path(&service, &asset);
    let held = HeldSimulation::of(&path);
    service.post_json("/v1/assets", &asset).expect(201);
    service.wait_for("/v1/assets/pump", |asset| asset["summary"]["simulation"]["stage"] == "library");
    service.stop();
    // As if it had panicked.
    let failure = path.with_file_name("failures").join(path.file_stem().unwrap()).with_extension("json");
    fs::create_dir_all(failure.parent().unwrap()).unwrap();
    let kept = json!({ "version": env!("CARGO_PKG_VERSION"), "reason": "the simulation panicked: 0 teeth" });
    fs::write(&failure, kept.to_string()).unwrap();
    service.launch();
    let summary = wait_for_library(&service, "pump", "failed");
    assert_eq!(summary["library_error"], kept["reason"]);
    service.put_json("/v1/assets/pump", &asset).expect(200);
    let summary = &service.get("/v1/assets/pump").expect(200).json()["summary"];
    assert_eq!(summary["library_state"], "failed");
    assert!(!path.exists());
    asset["name"] = json!("feed pump");
    service.put_json("/v1/assets/pump", &asset).expect(200);
    held.let_go();
    wait_for_library(&service, "pump", "ready");
    assert!(!failure.exists());
}

#[test]
fn a_simulation_is_cancelled_with_the_last_asset_that_needs_it() {
    let service = Service::start();
    for (face_width_mm, is_deleted) in [(23.0, true), (24.0, false)] {
        let asset = asset_with_pair("gone", face_width_mm);
        let path = library_path(&service, &asset);
        let held = HeldSimulation::of(&path);
        service.post_json("/v1/assets", &asset).expect(201);
        service.post_json("/v1/assets", &asset_with_pair("next", face_width_mm + 10.0)).expect(201);
        service.wait_for("/v1/assets/next", |asset| asset["summary"]["simulation"]["stage"] == "waiting");
        if is_deleted {
            service.delete("/v1/assets/gone").expect(204);
        } else {
            service.put_json("/v1/assets/gone", &plain_asset("gone")).expect(200);
        }
        held.let_go();
        wait_for_library(&service, "next", "ready");
        assert!(!path.exists());
        service.delete("/v1/assets/next").expect(204);
    }
}

#[test]
fn a_history_continues_with_the_stored_library() {
    let mut service = Service::start();
    service.post_json("/v1/assets", &asset_with_pair("pump", 25.0)).expect(201);
    wait_for_library(&service, "pump", "ready");
    for n in 0..10 {
        service.upload("pump", &record("1", n));
    }
    service.restart();
    let segment = service.upload("pump", &record("1", 10));
    assert!(segment["wear"]["library_id"].is_string(), "{segment}");
    assert_eq!(service.get("/v1/recomputations").expect(200).json()["items"], json!([]));
}

/// The 1280 ensemble members of the first machine take most of a minute; the second one's library must not
/// wait for them.
#[test]
fn a_library_does_not_wait_for_another_assets_ensemble() {
    let service = Service::start_with(|config| config.work.ensemble = EnsembleSettings::default());
    let simulation = |asset: &str| {
        let summary = service.get(&format!("/v1/assets/{asset}")).expect(200).json()["summary"].clone();
        summary["simulation"].clone()
    };
    service.post_json("/v1/assets", &asset_with_pair("first", 27.0)).expect(201);
    service.wait_for("/v1/assets/first", |asset| asset["summary"]["simulation"]["stage"] == "members");
    service.post_json("/v1/assets", &asset_with_pair("second", 28.0)).expect(201);
    wait_for_library(&service, "second", "ready");
    let first = simulation("first");
    assert_eq!(first["stage"], "members", "{first}");
    // Progress and remaining time cover all operating points.
    let seen = service.wait_for("/v1/assets/first", |asset| {
        asset["summary"]["simulation"]["fraction"].as_f64().is_some_and(|fraction| fraction > 0.15)
    });
    assert!(seen["summary"]["simulation"]["remaining_s"].as_f64().is_some_and(|left| left > 0.0), "{seen}");
}
