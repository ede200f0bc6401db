//! What was taken by mistake is taken back, and what cannot be right is refused.

use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::signal::Record;
use serde_json::{Value, json};

use crate::command::flankwatch;
use crate::durability::{quarantined, raw_objects};
use crate::running::{Service, minute, plain_asset, record, samples};

/// The numbers of every record of an asset in the order of time, once they are as those of another one.
#[track_caller]
fn wait_for_the_numbers_of(service: &Service, asset: &str, expected: &str) {
    for path in ["wear/history", "indicators"] {
        let told = |asset: &str| {
            let mut answer = service.get(&format!("/v1/assets/{asset}/{path}")).expect(200).json();
            for item in answer["items"].as_array_mut().unwrap() {
                item.as_object_mut().unwrap().remove("segment_id");
            }
            answer["items"].clone()
        };
        let began = std::time::Instant::now();
        while told(asset) != told(expected) {
            assert!(began.elapsed().as_secs() < 60, "{} is not {}", told(asset), told(expected));
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    }
}

#[test]
fn deleted_records_leave_a_history_as_if_they_had_never_come() {
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
    // Sent again they are taken again.
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
fn a_channel_whose_records_are_all_deleted_begins_anew() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..3 {
        service.upload("pump", &record("1", n));
        service.upload("pump", &record("2", n));
    }
    let url = service.url("");
    let delete = |words: &[&str]| flankwatch(&[&["delete", "--url", &url], words].concat());
    delete(&["--asset", "pump"]).expect_refusal(&["--from"]);
    let said = delete(&["--asset", "pump", "--channel", "2", "--to", "2027-01-01T00:00:00Z"]).expect_success();
    assert_eq!(said.out(), "3 records deleted\n");
    assert_eq!(
        service.get("/v1/assets/pump").expect(200).json()["summary"]["channels"],
        json!(["1"])
    );
    let segment = service.upload("pump", &record("2", 7));
    delete(&["--segment", segment["id"].as_str().unwrap()]).expect_success();
    delete(&["--segment", segment["id"].as_str().unwrap()]).expect_refusal(&["404"]);
    service.upload("pump", &record("2", 8));
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["summary"]["segments"], 4);
}

#[test]
fn deleted_records_go_from_all_assets_of_their_sensor() {
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
        assert_eq!(
            service.get(&format!("/v1/assets/{asset}")).expect(200).json()["summary"]["segments"],
            1
        );
    }
}

#[test]
fn a_time_far_ahead_is_refused() {
    let service = Service::start_with(|config| config.work.start_time_ahead = std::time::Duration::from_secs(24 * 3600));
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
    // Of a recording the other records are taken.
    let recording = crate::running::mcap(&[record("1", 0), record("1", 5000)]);
    let answer = service
        .post("/v1/assets/pump/segments", "application/mcap", &recording)
        .expect(201)
        .json();
    assert_eq!((&answer["stored"], &answer["refused_count"]), (&json!(1), &json!(1)), "{answer}");
}

fn upload_in(service: &Service, asset: &str, n: u32, unit: &str, scale: f32) -> crate::running::Answer {
    let scaled = samples(n).iter().map(|sample| sample * scale).collect();
    let record = Record::new("1", minute(n.into()), 4000.0, unit, scaled).unwrap();
    service.post(
        &format!("/v1/assets/{asset}/segments"),
        "application/x-protobuf",
        &encode_block(&record, BlockEncoding::Protobuf),
    )
}

#[test]
fn a_channel_keeps_its_unit() {
    let mut service = Service::start();
    for asset in ["pump", "other"] {
        let mut spec = plain_asset(asset);
        spec["sensor"] = json!({});
        service.post_json("/v1/assets", &spec).expect(201);
    }
    let rms = |segment: &Value| segment["indicators"]["rms"].as_f64().unwrap();
    let first = upload_in(&service, "pump", 1, "m/s2", 1.0).expect(201).json();
    let same = upload_in(&service, "other", 1, "mm/s2", 1000.0).expect(201).json();
    assert_eq!((&first["unit"], &same["unit"]), (&json!("m/s2"), &json!("mm/s2")));
    let in_g = upload_in(&service, "pump", 2, "g", 1.0 / 9.806_65).expect(201).json();
    let expected = upload_in(&service, "pump", 2, "m/s2", 1.0).expect(201).json();
    assert_eq!(in_g["unit"], "m/s2");
    assert!((rms(&in_g) / rms(&expected) - 1.0).abs() < 1e-6, "{in_g}");
    upload_in(&service, "pump", 3, "V", 1.0).expect_problem(422, &["unit", "V", "m/s2"]);
    upload_in(&service, "pump", 3, "m/s2\u{7}", 1.0).expect_problem(422, &["unit"]);
    // Read again from bytes that are in g, and after the next start; a WAV says no unit itself.
    let wav = crate::running::wav(&[samples(4).iter().map(|sample| sample / 9.806_65).collect()]);
    let path = "/v1/assets/pump/segments?channel=1&unit=g&start_time=2026-01-01T01:00:00Z";
    let of_wav = service.post(path, "audio/wav", &wav).expect(201).json();
    assert_eq!(of_wav["unit"], "m/s2");
    service.restart();
    for segment in [&in_g, &of_wav] {
        let path = format!("/v1/segments/{}/spectrum", segment["id"].as_str().unwrap());
        assert_eq!(service.get(&path).expect(200).json()["unit"], "m/s2");
        let path = format!("/v1/segments/{}/waveform", segment["id"].as_str().unwrap());
        let waveform = service.get(&path).expect(200).json();
        let values = waveform["value"].as_array().unwrap().iter();
        let most = values.map(|value| value.as_f64().unwrap().abs()).fold(0.0, f64::max);
        assert!((1.0..3.0).contains(&most), "{most}");
    }
}

#[test]
fn names_and_units_of_a_description_have_bounds() {
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
