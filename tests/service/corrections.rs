//! Deleted and excluded records, chosen baselines, and rejected values.

use flankwatch::asset::{AssetId, SegmentId};
use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::store::RecordRange;
use serde_json::{Value, json};

use crate::command::flankwatch;
use crate::durability::{quarantined, raw_objects};
use crate::running::{Service, plain_asset, record};

/// Waits until an asset has the same values as another one, record by record.
#[track_caller]
fn wait_for_the_numbers_of(service: &Service, asset: &str, expected: &str) {
    for path in ["wear/history", "indicators"] {
        let state_of = |asset: &str| {
            let mut answer = service.get(&format!("/v1/assets/{asset}/{path}")).expect(200).json();
            for item in answer["items"].as_array_mut().unwrap() {
                item.as_object_mut().unwrap().remove("segment_id");
            }
            answer["items"].clone()
        };
        let began = std::time::Instant::now();
        while state_of(asset) != state_of(expected) {
            assert!(began.elapsed().as_secs() < 60, "{} is not {}", state_of(asset), state_of(expected));
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    }
}

#[test]
fn deleted_records_leave_no_trace_in_the_history() {
    let mut service = Service::start();
    for asset in ["pump", "never-had-them"] {
        service.plain_asset(asset);
    }
    let mut segments = Vec::new();
    for n in 0..14 {
        segments.push(service.upload("pump", &record("1", n)));
        if n != 3 && !(6..9).contains(&n) {
            service.upload("never-had-them", &record("1", n));
        }
    }
    let id = |n: usize| segments[n]["id"].as_str().unwrap();
    service.delete("/v1/assets/pump/segments").expect_problem(400, &["from"]);
    service.delete("/v1/assets/none/segments?from=2026-01-01T00:00:00Z").expect(404);
    service.delete(&format!("/v1/segments/{}", id(3))).expect(204);
    service.delete(&format!("/v1/segments/{}", id(3))).expect(404);
    let range = "/v1/assets/pump/segments?channel=1&from=2026-01-01T00:06:00Z&to=2026-01-01T00:09:00Z";
    assert_eq!(service.delete(range).expect(200).json(), json!({ "deleted": 3 }));
    assert_eq!(service.delete(range).expect(200).json(), json!({ "deleted": 0 }));
    wait_for_the_numbers_of(&service, "pump", "never-had-them");
    let summary = &service.get("/v1/assets/pump").expect(200).json()["summary"];
    assert_eq!(summary["segments"], 10);
    if std::env::var("FLANKWATCH_TEST_DATABASE").is_err() {
        // Both assets have the other objects.
        assert_eq!((raw_objects(service.folder()).len(), quarantined(service.folder()).len()), (10, 4));
    }
    service.restart();
    wait_for_the_numbers_of(&service, "pump", "never-had-them");
    // Sent again, they are stored again.
    for n in [3, 6, 7, 8] {
        service.upload("pump", &record("1", n));
        service.upload("never-had-them", &record("1", n));
    }
    wait_for_the_numbers_of(&service, "pump", "never-had-them");
    assert_eq!(
        service.get(&format!("/v1/segments/{}/waveform", id(3))).expect(200).json()["segment_id"],
        id(3)
    );
}

#[test]
fn a_channel_without_records_starts_anew() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..3 {
        service.upload("pump", &record("1", n));
        service.upload("pump", &record("2", n));
    }
    let url = service.url("");
    let delete = |words: &[&str]| flankwatch(&[&["delete", "--url", &url], words].concat());
    delete(&["--asset", "pump"]).expect_failure(&["--from"]);
    let output =
        delete(&["--asset", "pump", "--channel", "2", "--to", "2027-01-01T00:00:00Z"]).expect_success();
    assert_eq!(output.out(), "3 records deleted\n");
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["channels"], json!(["1"]));
    let segment = service.upload("pump", &record("2", 7));
    delete(&["--segment", segment["id"].as_str().unwrap()]).expect_success();
    delete(&["--segment", segment["id"].as_str().unwrap()]).expect_failure(&["404"]);
    service.upload("pump", &record("2", 8));
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 4);
}

#[test]
fn deleted_records_are_removed_from_all_assets_of_their_sensor() {
    let service = Service::start();
    service.plain_asset("first");
    let mut second = plain_asset("second");
    second["gear"] = json!({ "teeth": [17, 50], "shaft_speed_hz": 5.0, "shaft_ratio": [31, 62] });
    second["sensor"]["of"] = json!("first");
    service.post_json("/v1/assets", &second).expect(201);
    for n in 0..3 {
        service.upload("first", &record("1", n));
    }
    let from = "segments?from=2026-01-01T00:01:00Z";
    service.delete(&format!("/v1/assets/second/{from}")).expect_problem(409, &["first"]);
    assert_eq!(service.delete(&format!("/v1/assets/first/{from}")).expect(200).json()["deleted"], 2);
    for asset in ["first", "second"] {
        assert_eq!(service.get(&format!("/v1/assets/{asset}")).expect(200).json()["summary"]["segments"], 1);
    }
}

#[test]
fn a_start_time_far_ahead_is_rejected() {
    let service = Service::start_with(|config| {
        config.work.start_time_ahead = std::time::Duration::from_secs(24 * 3600)
    });
    service.plain_asset("pump");
    let send = |n: u32| {
        service.post(
            "/v1/assets/pump/segments",
            "application/json",
            &encode_block(&record("1", n), BlockEncoding::Json),
        )
    };
    send(24 * 60).expect(201);
    send(24 * 60 + 1).expect_problem(422, &["start_time", "2026-01-02T00:01:00Z", "start_time_ahead_s"]);
    // The other records of the recording are stored.
    let recording = crate::running::mcap(&[record("1", 0), record("1", 5000)]);
    let answer = service.post("/v1/assets/pump/segments", "application/mcap", &recording).expect(201).json();
    assert_eq!((&answer["stored"], &answer["refused_count"]), (&json!(1), &json!(1)), "{answer}");
}

#[test]
fn names_and_units_of_a_description_are_validated() {
    let service = Service::start();
    for (pointer, value, word) in [
        ("/name", "x".repeat(201), "name"),
        ("/name", "a\nb".to_owned(), "name"),
        ("/sensor/unit", "m\u{0}".to_owned(), "sensor.unit"),
        ("/sensor/channel", "y".repeat(201), "sensor.channel"),
    ] {
        let mut spec = plain_asset("pump");
        spec["name"] = json!("");
        spec["sensor"]["channel"] = json!("1");
        *spec.pointer_mut(pointer).unwrap() = json!(value);
        service.post_json("/v1/assets", &spec).expect_problem(422, &[word]);
    }
}

/// Returns the values of an asset's records that are not excluded.
fn counted(service: &Service, asset: &str) -> Vec<Value> {
    let history = service.get(&format!("/v1/assets/{asset}/wear/history")).expect(200).json();
    let trend = service.get(&format!("/v1/assets/{asset}/indicators")).expect(200).json();
    let all = history["items"].as_array().unwrap().iter().zip(trend["items"].as_array().unwrap());
    let numbers = all.filter(|(wear, _)| wear["status"] != "excluded").map(|(wear, indicators)| {
        let mut both = [wear.clone(), indicators.clone()];
        both.iter_mut().for_each(|one| drop(one.as_object_mut().unwrap().remove("segment_id")));
        json!(both)
    });
    numbers.collect()
}

#[track_caller]
fn wait_for_counted(service: &Service, asset: &str, expected: &str) {
    let began = std::time::Instant::now();
    while counted(service, asset) != counted(service, expected) {
        assert!(began.elapsed().as_secs() < 60, "{asset} is not {expected}");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
}

#[test]
fn excluded_records_stay_stored_outside_the_history() {
    let mut service = Service::start();
    for asset in ["pump", "without", "whole"] {
        service.plain_asset(asset);
    }
    let mut segments = Vec::new();
    for n in 0..14 {
        segments.push(service.upload("pump", &record("1", n)));
        service.upload("whole", &record("1", n));
        if n != 3 && !(6..9).contains(&n) && n != 13 {
            service.upload("without", &record("1", n));
        }
    }
    let path = |n: usize| format!("/v1/segments/{}", segments[n]["id"].as_str().unwrap());
    assert_eq!(segments[3]["excluded"], false);
    service.post_json("/v1/assets/pump/segments/exclude", &json!({})).expect_problem(400, &["from"]);
    for n in [3, 13] {
        let answer =
            service.post(&format!("{}/exclude", path(n)), "application/json", b"").expect(200).json();
        assert_eq!(answer, json!({ "changed": 1 }));
    }
    let url = service.url("");
    let range = ["--asset", "pump", "--from", "2026-01-01T00:06:00Z", "--to", "2026-01-01T00:09:00Z"];
    let change = |command: &str| flankwatch(&[&[command, "--url", &url], &range[..]].concat());
    assert_eq!(change("exclude").expect_success().out(), "3 records excluded\n");
    assert_eq!(change("exclude").expect_success().out(), "0 records excluded\n");
    wait_for_counted(&service, "pump", "without");
    assert_eq!(counted(&service, "pump").len(), 9);
    let excluded = service.get(&path(7)).expect(200).json();
    assert_eq!((&excluded["excluded"], &excluded["wear"]["status"]), (&json!(true), &json!("excluded")));
    assert_eq!(excluded["indicators"]["rms"], segments[7]["indicators"]["rms"]);
    let list = service.get("/v1/assets/pump/segments").expect(200).json();
    let marked = list["items"].as_array().unwrap().iter().filter(|segment| segment["excluded"] == true);
    assert_eq!(marked.count(), 5);
    // The latest included record determines the asset's summary.
    assert_eq!(service.get("/v1/assets/pump/wear").expect(200).json()["segment_id"], segments[12]["id"]);
    // Sent again it stays excluded, records that come later are folded on, and so after a restart.
    assert_eq!(
        service
            .post(
                "/v1/assets/pump/segments",
                "application/json",
                &encode_block(&record("1", 7), BlockEncoding::Json)
            )
            .json()["excluded"],
        true
    );
    service.restart();
    for asset in ["pump", "without"] {
        service.upload(asset, &record("1", 20));
        service.upload(asset, &record("1", 10_000));
    }
    wait_for_counted(&service, "pump", "without");
    // The metadata beside the raw recordings has it too.
    if std::env::var("FLANKWATCH_TEST_DATABASE").is_err() {
        service.stop();
        flankwatch(&["rebuild", "--anew", "--data-dir", service.folder().to_str().unwrap()]).expect_success();
        service.launch();
        wait_for_counted(&service, "pump", "without");
    }
    let url = service.url("");
    let all = ["include", "--url", &url, "--asset", "pump", "--to", "2027-01-01T00:00:00Z"];
    assert_eq!(flankwatch(&all).expect_success().out(), "5 records included\n");
    service.upload("whole", &record("1", 20));
    service.upload("whole", &record("1", 10_000));
    wait_for_the_numbers_of(&service, "pump", "whole");
}

#[test]
fn excluded_records_are_excluded_for_all_assets_of_their_sensor() {
    let service = Service::start();
    service.plain_asset("first");
    let through = |id: &str| {
        let mut asset = plain_asset(id);
        asset["gear"] = json!({ "teeth": [17, 50], "shaft_speed_hz": 5.0, "shaft_ratio": [31, 62] });
        asset["sensor"]["of"] = json!("first");
        asset
    };
    service.post_json("/v1/assets", &through("second")).expect(201);
    for n in 0..4 {
        service.upload("first", &record("1", n));
    }
    let from = "segments/exclude?from=2026-01-01T00:02:00Z";
    service
        .post(&format!("/v1/assets/second/{from}"), "application/json", b"")
        .expect_problem(409, &["first"]);
    let answer =
        service.post(&format!("/v1/assets/first/{from}"), "application/json", b"").expect(200).json();
    assert_eq!(answer["changed"], 2);
    // Also for one that is described later.
    service.post_json("/v1/assets", &through("third")).expect(201);
    for asset in ["first", "second", "third"] {
        service.wait_for(&format!("/v1/assets/{asset}/wear/history"), |history| {
            let statuses: Vec<&Value> =
                history["items"].as_array().unwrap().iter().map(|item| &item["status"]).collect();
            statuses.len() == 4
                && statuses.iter().enumerate().all(|(n, status)| (**status == "excluded") == (n >= 2))
        });
    }
}

#[test]
fn the_baseline_can_be_chosen_by_time_range() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..20 {
        service.upload("pump", &record("1", n));
    }
    let add_event = |event: Value| service.post_json("/v1/assets/pump/maintenance", &event);
    let (from, until) = ("2026-01-01T00:04:00Z", "2026-01-01T00:14:00Z");
    let chosen =
        |until: &str| json!({ "kind": "baseline_chosen", "time": from, "until": until, "by": "Ada" });
    add_event(json!({ "kind": "baseline_chosen", "time": from, "by": "Ada" }))
        .expect_problem(422, &["until is missing"]);
    add_event(chosen(from)).expect_problem(422, &["until", from]);
    add_event(json!({ "kind": "gear_replaced", "time": from, "until": until, "by": "Ada" }))
        .expect_problem(422, &["until", "baseline_chosen"]);
    let event = add_event(chosen(until)).expect(201).json();
    let history = service.wait_for("/v1/assets/pump/wear/history", |history| {
        history["items"][12]["status"] == "collecting_baseline"
    });
    for (n, item) in history["items"].as_array().unwrap().iter().enumerate() {
        let is_chosen = item["reason"].as_str().unwrap().contains("the chosen baseline");
        assert_eq!(is_chosen, (4..14).contains(&n), "{n}: {item}");
        assert_eq!(item["status"] == "collecting_baseline", n < 14, "{n}: {item}");
    }
    let take_back = |event: &Value| {
        let path = format!("/v1/assets/pump/maintenance/{}", event["id"].as_str().unwrap());
        service.delete(&path).expect(204);
        service.wait_for("/v1/assets/pump/wear/history", |history| {
            history["items"][12]["status"] != "collecting_baseline"
        });
    };
    take_back(&event);
    let url = service.url("");
    let choose = |until: &str| {
        flankwatch(&[
            "baseline", "--url", &url, "--asset", "pump", "--from", from, "--to", until, "--by", "Ada",
        ])
    };
    choose(from).expect_failure(&["--to", from]);
    assert!(choose(until).expect_success().out().contains("records from 2026-01-01T00:04:00Z"));
    service.wait_for("/v1/assets/pump/wear/history", |history| {
        history["items"][12]["status"] == "collecting_baseline"
    });
    let events = service.get("/v1/assets/pump/maintenance").expect(200).json();
    assert_eq!(events["items"].as_array().unwrap().len(), 1, "{events}");
    take_back(&events["items"][0]);
}

/// Makes writes into a folder of metadata files fail until the returned function is called.
fn block(service: &Service, folder: &str) -> impl FnOnce() + use<> {
    let path = service.folder().join("raw").join(folder);
    let aside = path.with_extension("aside");
    let was_there = std::fs::rename(&path, &aside).is_ok();
    std::fs::write(&path, b"").unwrap();
    move || {
        std::fs::remove_file(&path).unwrap();
        if was_there {
            std::fs::rename(&aside, &path).unwrap();
        }
    }
}

#[test]
fn a_removal_whose_note_cannot_be_written_is_completed_by_a_repeat() {
    let service = Service::start();
    service.plain_asset("pump");
    let segments: Vec<Value> = (0..3).map(|n| service.upload("pump", &record("1", n))).collect();
    let range = "/v1/assets/pump/segments?to=2026-01-01T00:01:30Z";
    let unblock = block(&service, "removed");
    let answer = service.delete(range);
    assert!(answer.status >= 500, "{}", answer.status);
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 3);
    unblock();
    assert_eq!(service.delete(range).expect(200).json(), json!({ "deleted": 2 }));
    let tombstones = service.service().store.objects().tombstones().unwrap();
    let mut removed: Vec<String> =
        tombstones.into_iter().flat_map(|tombstone| tombstone.segments).map(|segment| segment.0).collect();
    removed.sort_unstable();
    let mut expected: Vec<&str> =
        segments[..2].iter().map(|segment| segment["id"].as_str().unwrap()).collect();
    expected.sort_unstable();
    assert_eq!(removed, expected);
}

#[test]
fn an_exclusion_whose_note_cannot_be_written_is_noted_by_a_repeat() {
    let service = Service::start();
    service.plain_asset("pump");
    let id = service.upload("pump", &record("1", 0))["id"].as_str().unwrap().to_owned();
    let asset = AssetId::new("pump").unwrap();
    let range = [RecordRange::default()];
    let exclude = || service.run(service.service().exclusions.set_each(&asset, &range, true)).unwrap();
    let unblock = block(&service, "assets");
    assert_eq!(exclude(), 1);
    unblock();
    assert_eq!(exclude(), 0);
    let metadata = service.service().store.objects().asset_metadata(&asset).unwrap().unwrap();
    assert_eq!(metadata.excluded, [SegmentId(id)]);
}
