//! Indicators and wear over time.

use std::io::Cursor;

use flankwatch::recording::{McapOptions, McapWriter};
use flankwatch::signal::Record;
use jiff::Timestamp;
use serde_json::{Value, json};

use crate::alarms::loud;
use crate::running::{Service, asset_with_pair, minute, plain_asset, record};

/// Returns all values of all records, which show any dependence on the order.
fn history(service: &Service, asset: &str) -> Value {
    let mut history = service.get(&format!("/v1/assets/{asset}/wear/history")).expect(200).json();
    for item in history["items"].as_array_mut().unwrap() {
        item.as_object_mut().unwrap().remove("segment_id");
    }
    history
}

#[test]
fn late_records_give_the_same_history_as_records_in_order() {
    let service = Service::start();
    for id in ["in-order", "shuffled", "backwards"] {
        service.post_json("/v1/assets", &asset_with_pair(id, 20.0)).expect(201);
    }
    service.wait_for("/v1/assets/in-order", |asset| asset["summary"]["library_state"] == "ready");
    for n in 0..14 {
        service.upload("in-order", &record("1", n));
    }
    for n in [3, 0, 1, 2, 9, 13, 8, 7, 12, 4, 6, 5, 11, 10] {
        service.upload("shuffled", &record("1", n));
    }
    for n in (0..14).rev() {
        service.upload("backwards", &record("1", n));
    }
    let expected = history(&service, "in-order");
    assert_eq!(expected["items"].as_array().unwrap().len(), 14);
    assert_eq!(history(&service, "shuffled"), expected);
    assert_eq!(history(&service, "backwards"), expected);
    let latest = |asset: &str| {
        let mut wear = service.get(&format!("/v1/assets/{asset}/wear")).expect(200).json();
        for key in ["asset_id", "segment_id"] {
            wear.as_object_mut().unwrap().remove(key);
        }
        wear
    };
    assert_eq!(latest("shuffled"), latest("in-order"));
    assert_eq!(latest("backwards"), latest("in-order"));
}

#[test]
fn a_changed_baseline_recomputes_the_history() {
    let service = Service::start();
    for id in ["changed", "from-the-start"] {
        service.post_json("/v1/assets", &asset_with_pair(id, 20.0)).expect(201);
    }
    service.wait_for("/v1/assets/changed", |asset| asset["summary"]["library_state"] == "ready");
    for n in 0..14 {
        service.upload("changed", &record("1", n));
    }
    let mut description = asset_with_pair("from-the-start", 20.0);
    description["baseline"]["records"] = json!(11);
    service.put_json("/v1/assets/from-the-start", &description).expect(200);
    for n in 0..14 {
        service.upload("from-the-start", &record("1", n));
    }
    let expected = history(&service, "from-the-start");
    assert_ne!(history(&service, "changed"), expected);
    description["id"] = json!("changed");
    service.put_json("/v1/assets/changed", &description).expect(200);
    service.wait_for("/v1/assets/changed/wear", |wear| wear["baseline"]["need"] == 11);
    assert_eq!(history(&service, "changed"), expected);
}

#[test]
fn the_sparkline_of_an_asset_follows_its_history() {
    let service = Service::start();
    service.post_json("/v1/assets", &asset_with_pair("pump", 20.0)).expect(201);
    service.wait_for("/v1/assets/pump", |asset| asset["summary"]["library_state"] == "ready");
    let look = |picks: &[usize]| {
        let history = history(&service, "pump");
        let curve = service.get("/v1/assets/pump").expect(200).json()["summary"]["recent_wear_um"].clone();
        let medians = picks.iter().map(|&n| history["items"][n]["median_um"].clone());
        let medians: Vec<Value> = medians.filter(|median| !median.is_null()).collect();
        (curve.as_array().unwrap().clone(), medians)
    };
    assert!(look(&[]).0.is_empty());
    for n in 0..14 {
        service.upload("pump", &record("1", n));
    }
    let (curve, medians) = look(&(0..14).collect::<Vec<_>>());
    assert!(medians.len() > 3, "{medians:?}");
    assert_eq!(curve, medians);
    for n in 14..90 {
        service.upload("pump", &record("1", n));
    }
    // The first record at or after each of 40 moments from the first to the last of 90, one a minute.
    let picks: Vec<usize> = (0..40).map(|k| usize::div_ceil(k * 89, 39)).collect();
    let (curve, medians) = look(&picks);
    assert!(medians.len() > 25, "{medians:?}");
    assert_eq!(curve, medians);
}

#[test]
fn the_library_of_an_asset_is_shown() {
    let service = Service::start();
    let asset = service.post_json("/v1/assets", &asset_with_pair("pump", 20.0)).expect(201).json();
    let id = asset["summary"]["library_id"].as_str().unwrap().to_string();
    service.wait_for("/v1/assets/pump", |asset| asset["summary"]["library_state"] == "ready");
    let list = service.get("/v1/libraries").expect(200).json();
    assert_eq!(list["items"][0]["id"], id);
    assert_eq!(list["items"][0]["pair_name"], "test pair");
    let library = service.get(&format!("/v1/libraries/{id}")).expect(200).json();
    assert_eq!(library["pair"]["geometry"]["teeth"], json!([31, 62]));
    let states = library["states"].as_u64().unwrap();
    let state = service.get(&format!("/v1/libraries/{id}/states/{}", states - 1)).expect(200).json();
    assert_eq!(state["library_id"], id);
    let points = state["phi1_rad"].as_array().unwrap().len();
    for key in ["stiffness_n_per_m", "uste_rad", "pairs_in_contact"] {
        assert_eq!(state[key].as_array().unwrap().len(), points, "{key}");
    }
    service.get(&format!("/v1/libraries/{id}/states/{states}")).expect_problem(404, &["no state"]);
}

#[test]
fn an_asset_without_records_has_empty_trends() {
    let service = Service::start();
    service.plain_asset("pump");
    let wear = service.get("/v1/assets/pump/wear").expect(200).json();
    assert_eq!(wear["status"], "collecting_baseline");
    assert_eq!(wear["baseline"], json!({ "have": 0, "need": 8 }));
    assert_eq!(wear["segment_id"], json!(null));
    let empty = json!({ "channel": null, "items": [], "reduced": false });
    assert_eq!(service.get("/v1/assets/pump/wear/history").expect(200).json(), empty);
    assert_eq!(service.get("/v1/assets/pump/indicators").expect(200).json()["items"], json!([]));
}

#[test]
fn a_trend_is_in_time_order_and_limited_in_length() {
    let service = Service::start();
    service.plain_asset("pump");
    let mut rms = Vec::new();
    for n in [7, 3, 12, 1, 5, 9, 2, 11, 4, 10, 8, 6, 15, 13, 14, 16] {
        let segment = service.upload("pump", &record("1", n));
        rms.push((n, segment["indicators"]["rms"].clone()));
        // Asked for in between, so that it grows in memory too.
        service.get("/v1/assets/pump/indicators?names=rms").expect(200);
    }
    rms.sort_by_key(|(n, _)| *n);
    let trend = service.get("/v1/assets/pump/indicators?names=rms,kurtosis").expect(200).json();
    assert_eq!(trend["channel"], "1");
    assert_eq!(trend["units"]["rms"], "m/s2");
    assert_eq!(trend["units"]["kurtosis"], "1");
    assert_eq!(trend["reduced"], false);
    let items = trend["items"].as_array().unwrap();
    let found: Vec<&Value> = items.iter().map(|item| &item["rms"]).collect();
    let expected: Vec<&Value> = rms.iter().map(|(_, value)| value).collect();
    assert_eq!(found, expected);
    assert!(items.iter().all(|item| item.as_object().unwrap().len() == 4), "{items:?}");
    let refused = service.get("/v1/assets/pump/indicators?names=rms,nonsense").expect(400).json();
    assert_eq!(refused["field"], "names");
    let reduced = service.get("/v1/assets/pump/indicators?names=rms&max_points=10").expect(200).json();
    let kept = reduced["items"].as_array().unwrap();
    assert_eq!(reduced["reduced"], true);
    assert!(
        kept.len() <= 10
            && kept.iter().all(|item| items.iter().any(|of| of["start_time"] == item["start_time"]))
    );
    let of = |items: &[Value]| {
        let values = items.iter().map(|item| item["rms"].as_f64().unwrap());
        (values.clone().fold(f64::MAX, f64::min), values.fold(0.0, f64::max))
    };
    assert_eq!(of(kept), of(items));
    let part = "/v1/assets/pump/indicators?names=rms&from=2026-01-01T00:03:00Z&to=2026-01-01T00:06:00Z";
    assert_eq!(service.get(part).expect(200).json()["items"].as_array().unwrap().len(), 3);
}

/// More records than four blocks of columns have.
fn long_recording() -> Vec<u8> {
    let mut writer = McapWriter::new(Cursor::new(Vec::new()), McapOptions::default()).unwrap();
    for n in 0..1100 {
        let samples = (0..64).map(|k| ((k * k + n) % 17) as f32).collect();
        let record = Record::new("1", minute(n), 4000.0, "m/s2", samples).unwrap();
        writer.write("/pump/1/waveform", &record).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn a_history_in_columns_equals_that_in_rows() {
    let mut service = Service::start();
    service.post_json("/v1/assets", &plain_asset("pump")).expect(201);
    let types = [("content-type", "application/mcap")];
    service.send("POST", "/v1/assets/pump/segments", &types, &long_recording()).expect(201);
    let both = |service: &Service| {
        ["indicators", "wear/history"]
            .map(|what| service.get(&format!("/v1/assets/pump/{what}?max_points=200000")).expect(200).json())
    };
    let of_rows = both(&service);
    assert_eq!(of_rows.each_ref().map(|trend| trend["items"].as_array().unwrap().len()), [1100; 2]);
    let blocks = |service: &Service| {
        let store = service.service().store.clone();
        service.run(async {
            store.store_trend_blocks().await.unwrap();
            store.trend_blocks("pump").await.unwrap()
        })
    };
    assert_eq!(blocks(&service), 4);
    service.restart();
    assert_eq!(both(&service), of_rows);
    // A record before all others changes every block.
    service.upload("pump", &Record::new("1", minute(-1), 4000.0, "m/s2", vec![1.0; 64]).unwrap());
    let with_late = both(&service);
    assert_ne!(with_late[0]["items"][0], of_rows[0]["items"][0]);
    service.restart();
    assert_eq!(both(&service), with_late);
    assert_eq!(blocks(&service), 4);
    service.restart();
    assert_eq!(both(&service), with_late);
}

#[test]
fn trends_are_filtered_by_operating_bin() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["operating_bins"] = json!([
        { "name": "idle", "torque_nm": [0, 10] },
        { "name": "full load", "shaft_speed_hz": [9, 11], "torque_nm": [10, 100] },
    ]);
    service.post_json("/v1/assets", &asset).expect(201);
    for (n, torque) in [Some(5.0), Some(50.0), None, Some(10.0)].into_iter().enumerate() {
        let block = flankwatch::recording::encode_block(
            &loud(n as u32, 1.0),
            flankwatch::recording::BlockEncoding::Json,
        );
        let torque = torque.map_or_else(String::new, |torque| format!("&torque_nm={torque}"));
        let path = format!("/v1/assets/pump/segments?shaft_speed_hz=10{torque}");
        service.post(&path, "application/json", &block).expect(201);
    }
    let minutes = |path: &str| -> Vec<Timestamp> {
        let items = service.get(path).expect(200).json()["items"].as_array().unwrap().clone();
        items.iter().map(|item| item["start_time"].as_str().unwrap().parse().unwrap()).collect()
    };
    assert_eq!(
        minutes("/v1/assets/pump/indicators?names=rms&operating_bin=full%20load"),
        [minute(1), minute(3)]
    );
    assert_eq!(minutes("/v1/assets/pump/wear/history?operating_bin=idle"), [minute(0)]);
    let all = service.get("/v1/assets/pump/wear/history").expect(200).json();
    let bins: Vec<&Value> =
        all["items"].as_array().unwrap().iter().map(|item| &item["operating_bin"]).collect();
    assert_eq!(bins, [&json!("idle"), &json!("full load"), &Value::Null, &json!("full load")]);
    service
        .get("/v1/assets/pump/indicators?operating_bin=half")
        .expect_problem(400, &["operating_bin", "half"]);
    let segments = "/v1/assets/pump/segments?operating_bin=full%20load";
    assert_eq!(minutes(segments), [minute(1), minute(3)]);
    assert_eq!(minutes(&format!("{segments}&order=desc")), [minute(3), minute(1)]);
    let page = service.get(&format!("{segments}&limit=1")).expect(200).json();
    let next = page["next_cursor"].as_str().unwrap();
    assert_eq!(minutes(&format!("{segments}&limit=1&cursor={next}")), [minute(3)]);
    asset["operating_bins"][1]["torque_nm"] = json!([5, 100]);
    service.put_json("/v1/assets/pump", &asset).expect_problem(422, &["overlap"]);
}
