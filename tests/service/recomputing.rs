//! Histories recomputed in the background: after a change, and after very late records.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::running::{Service, mcap, plain_asset, record};

/// Waits until the asset's last recomputation is finished.
fn recomputed(service: &Service, asset: &str) -> Value {
    let list = service.wait_for(&format!("/v1/recomputations?asset={asset}"), |list| {
        let items = list["items"].as_array().unwrap();
        !items.is_empty()
            && items.iter().all(|item| !item["finished_at"].is_null() || item["state"] == "failed")
    });
    list["items"][0].clone()
}

/// Returns all values of all records in time order.
fn history(service: &Service, asset: &str) -> [Value; 2] {
    ["wear/history", "indicators"].map(|path| {
        let mut answer = service.get(&format!("/v1/assets/{asset}/{path}")).expect(200).json();
        for item in answer["items"].as_array_mut().unwrap() {
            item.as_object_mut().unwrap().remove("segment_id");
        }
        answer["items"].take()
    })
}

#[test]
fn a_new_band_is_computed_for_old_records_from_their_raw_bytes() {
    let mut service = Service::start();
    service.plain_asset("pump");
    let mut segments = Vec::new();
    for n in 0..12 {
        segments.push(service.upload("pump", &record("1", n)));
    }
    // One has no raw bytes any more.
    let name = segments[5]["raw"]["sha256"].as_str().unwrap();
    std::fs::remove_file(service.folder().join("raw").join(&name[..2]).join(name)).unwrap();
    let mut description = plain_asset("pump");
    description["bands"] = json!([{ "name": "mesh", "band_hz": [200, 400] }]);
    service.put_json("/v1/assets/pump", &description).expect(200);
    let done = recomputed(&service, "pump");
    assert_eq!(
        (&done["state"], &done["analysed"], &done["without_raw"], &done["folded"]),
        (&json!("finished"), &json!(11), &json!(1), &json!(12)),
        "{done}"
    );
    // As if the band had been there from the start.
    description["id"] = json!("fresh");
    service.post_json("/v1/assets", &description).expect(201);
    for n in 0..12 {
        service.upload("fresh", &record("1", n));
    }
    let ([wear, found], [fresh_wear, fresh]) = (history(&service, "pump"), history(&service, "fresh"));
    assert_eq!(wear, fresh_wear);
    for (n, (found, fresh)) in found.as_array().unwrap().iter().zip(fresh.as_array().unwrap()).enumerate() {
        if n == 5 {
            assert_eq!((&found["band_mesh"], &found["rms"]), (&Value::Null, &fresh["rms"]));
        } else {
            assert!(found["band_mesh"].is_number());
            assert_eq!(found, fresh);
        }
    }
    // A restart repeats nothing, and new records are processed.
    service.restart();
    for asset in ["pump", "fresh"] {
        service.upload(asset, &record("1", 12));
    }
    assert_eq!(service.get("/v1/recomputations").expect(200).json()["items"], json!([]));
    assert_eq!(history(&service, "pump")[0], history(&service, "fresh")[0]);
}

#[test]
fn old_results_are_served_until_the_new_ones_are_complete() {
    let service = Service::start();
    service.plain_asset("pump");
    let records: Vec<_> = (0..150).map(|n| record("1", n)).collect();
    service.post("/v1/assets/pump/segments", "application/mcap", &mcap(&records)).expect(201);
    let old = history(&service, "pump");
    let mut description = plain_asset("pump");
    description["gear"]["shaft_speed_hz"] = json!(10.1);
    service.put_json("/v1/assets/pump", &description).expect(200);
    let mut seen = Vec::new();
    let began = Instant::now();
    loop {
        let list = service.get("/v1/recomputations?asset=pump").expect(200).json();
        let is_over = list["items"][0]["state"] == "finished";
        for now in history(&service, "pump") {
            assert_eq!(now.as_array().unwrap().len(), 150);
            if seen.last() != Some(&now) {
                seen.push(now);
            }
        }
        if is_over {
            break;
        }
        assert!(began.elapsed() < Duration::from_secs(100), "{list}");
    }
    // A nearly equal description gives nearly equal values; this checks that all exist.
    assert!(seen.contains(&old[0]));
    service.upload("pump", &record("1", 150));
    assert_eq!(history(&service, "pump")[0].as_array().unwrap().len(), 151);
}

#[test]
fn a_record_older_than_hundreds_of_others_is_folded_in_the_background() {
    let service = Service::start();
    for asset in ["late", "in-order"] {
        service.plain_asset(asset);
    }
    let records: Vec<_> = (0..700).map(|n| record("1", n)).collect();
    let without: Vec<_> =
        records.iter().filter(|record| record.start_time() != records[3].start_time()).cloned().collect();
    for (asset, records) in [("late", &without), ("in-order", &records)] {
        let path = format!("/v1/assets/{asset}/segments");
        service.post(&path, "application/mcap", &mcap(records)).expect(201);
    }
    assert_ne!(history(&service, "late"), history(&service, "in-order"));
    let answer = service.upload("late", &records[3]);
    assert_eq!(answer["wear"]["baseline"]["have"], 4);
    recomputed(&service, "late");
    assert_eq!(history(&service, "late"), history(&service, "in-order"));
    // The states kept on the way serve the next ones.
    for asset in ["late", "in-order"] {
        service.upload(asset, &record("1", 701));
        service.upload(asset, &record("1", 700));
    }
    assert_eq!(history(&service, "late"), history(&service, "in-order"));
}

#[test]
fn a_record_far_from_the_nearest_state_is_stored_before_its_history_is_folded() {
    let service = Service::start();
    for asset in ["late", "in-order"] {
        service.plain_asset(asset);
    }
    let records: Vec<_> = (0..1600).map(|n| record("1", n)).collect();
    // The state before record 1000 is that at the start: the next one is after 1024 records.
    let late = &records[1000];
    for asset in ["late", "in-order"] {
        let sent =
            records.iter().filter(|record| asset == "in-order" || record.start_time() != late.start_time());
        for part in sent.cloned().collect::<Vec<_>>().chunks(400) {
            service
                .post(&format!("/v1/assets/{asset}/segments"), "application/mcap", &mcap(part))
                .expect(201);
        }
    }
    assert_eq!(service.upload("late", late)["wear"]["status"], "recomputing");
    recomputed(&service, "late");
    assert_eq!(history(&service, "late"), history(&service, "in-order"));
}

/// Puts a folder in the place of a raw recording, which then cannot be read; returns what puts it back.
fn make_unreadable(service: &Service, segment: &Value) -> Option<impl FnOnce() + use<>> {
    let name = segment["raw"]["sha256"].as_str().unwrap();
    let path = service.folder().join("raw").join(&name[..2]).join(name);
    let aside = service.folder().join("aside");
    // In a bucket there is no such file.
    std::fs::rename(&path, &aside).ok()?;
    std::fs::create_dir(&path).unwrap();
    Some(move || {
        std::fs::remove_dir(&path).unwrap();
        std::fs::rename(&aside, &path).unwrap();
    })
}

#[test]
fn a_recomputation_waits_until_raw_recordings_can_be_read_and_holds_up_no_other() {
    let mut service = Service::start();
    for asset in ["pump", "fan"] {
        service.plain_asset(asset);
    }
    let segments: Vec<Value> = (0..12).map(|n| service.upload("pump", &record("1", n))).collect();
    for n in 100..112 {
        service.upload("fan", &record("1", n));
    }
    let old = history(&service, "pump");
    let Some(make_readable) = make_unreadable(&service, &segments[5]) else { return };
    let began = Instant::now();
    for asset in ["pump", "fan"] {
        let mut description = plain_asset(asset);
        description["bands"] = json!([{ "name": "mesh", "band_hz": [200, 400] }]);
        service.put_json(&format!("/v1/assets/{asset}"), &description).expect(200);
    }
    assert_eq!(recomputed(&service, "fan")["state"], "finished");
    assert!(began.elapsed() < Duration::from_secs(30), "it waited for the other asset");
    let failed = recomputed(&service, "pump");
    assert_eq!(failed["state"], "failed", "{failed}");
    assert_eq!(history(&service, "pump"), old);
    make_readable();
    service.restart();
    let done = recomputed(&service, "pump");
    assert_eq!((&done["state"], &done["without_raw"]), (&json!("finished"), &json!(0)), "{done}");
    let [_, indicators] = history(&service, "pump");
    assert!(indicators.as_array().unwrap().iter().all(|item| item["band_mesh"].is_number()));
}

#[test]
fn an_asset_on_a_shared_sensor_lacks_no_record_that_could_not_be_read_for_a_moment() {
    let mut service = Service::start();
    service.plain_asset("pump");
    let segments: Vec<Value> = (0..12).map(|n| service.upload("pump", &record("1", n))).collect();
    let Some(make_readable) = make_unreadable(&service, &segments[5]) else { return };
    let mut second = plain_asset("second");
    second["gear"] = json!({ "teeth": [17, 50], "shaft_speed_hz": 5.0, "shaft_ratio": [31, 62] });
    second["sensor"]["of"] = json!("pump");
    service.post_json("/v1/assets", &second).expect(201);
    std::thread::sleep(Duration::from_secs(1));
    let parts = service.service();
    let late = service.run(parts.store.late_members(10)).unwrap();
    drop(parts);
    assert_eq!(late.iter().map(|id| id.as_str()).collect::<Vec<_>>(), ["second"]);
    make_readable();
    service.restart();
    service.wait_for("/v1/assets/second", |asset| asset["summary"]["segments"] == 12);
}
