//! Replacement of gears and sensors.

use serde_json::{Value, json};

use crate::alarms::{at_once, history_entries, loud, watched, whole};
use crate::event_stream::EventStream;
use crate::running::{Service, minute};

/// Returns the statuses of an asset's wear history, with the records' times.
fn statuses(service: &Service, asset: &str) -> Vec<(Value, Value)> {
    let history = service.get(&format!("/v1/assets/{asset}/wear/history")).expect(200).json();
    let items = history["items"].as_array().unwrap().iter();
    items.map(|item| (item["start_time"].clone(), item["reason"].clone())).collect()
}

#[test]
fn a_maintenance_event_restarts_the_baseline_at_any_time() {
    let mut service = Service::start();
    for asset in ["before", "after", "never"] {
        service.post_json("/v1/assets", &watched(asset, &at_once())).expect(201);
    }
    let done = json!({ "time": minute(12), "kind": "gear_replaced", "by": "Ada", "comment": "new pair" });
    let add_event = |service: &Service, asset: &str| {
        let answer = service.post_json(&format!("/v1/assets/{asset}/maintenance"), &done).expect(201);
        assert!(answer.header("location").starts_with(&format!("/v1/assets/{asset}/maintenance/")));
        answer.json()
    };
    add_event(&service, "before");
    let mut events = EventStream::open(&service, "?asset=after", None);
    for n in 0..24 {
        for asset in ["before", "after", "never"] {
            service.upload(asset, &loud(n, if n == 11 { 4.0 } else { 1.0 }));
        }
    }
    assert_ne!(statuses(&service, "after"), statuses(&service, "before"));
    let event = add_event(&service, "after");
    assert_eq!(add_event(&service, "after"), event);
    let received =
        std::iter::repeat_with(|| events.next()).find(|event| event.kind == "maintenance").unwrap();
    assert_eq!((&received.data["change"], &received.data["event"]["id"]), (&json!("added"), &event["id"]));
    let waited = |service: &Service| {
        service.wait_for("/v1/recomputations?asset=after", |list| list["items"][0]["state"] == "finished");
    };
    waited(&service);
    let history = statuses(&service, "before");
    assert!(history[12].1.as_str().unwrap().contains("1 of 8"), "{history:?}");
    assert_eq!(statuses(&service, "after"), history);
    // The new gear ends the alarm of the old one, before its first record.
    let alarm = history_entries(&whole(&service, "before"));
    assert_eq!(alarm[1][2], json!(minute(12)), "{alarm:?}");
    assert_eq!(whole(&service, "before")["history"][1]["maintenance"], "gear_replaced");
    assert_eq!(history_entries(&whole(&service, "after")), alarm);
    service.restart();
    service.upload("before", &loud(24, 1.0));
    service.upload("after", &loud(24, 1.0));
    assert_eq!(statuses(&service, "after"), statuses(&service, "before"));
    let list = service.get("/v1/assets/after/maintenance").expect(200).json();
    assert_eq!(list["items"], json!([event]));
    let id = event["id"].as_str().unwrap();
    service.delete(&format!("/v1/assets/after/maintenance/{id}")).expect(204);
    service.delete(&format!("/v1/assets/after/maintenance/{id}")).expect_problem(404, &[id]);
    service.upload("never", &loud(24, 1.0));
    service.wait_for("/v1/assets/after/wear/history", |_| {
        statuses(&service, "after") == statuses(&service, "never")
    });
    for (body, word) in [
        (json!({ "kind": "oiled", "by": "Ada" }), "oiled"),
        (json!({ "kind": "gear_replaced" }), "by"),
        (json!({ "kind": "gear_replaced", "by": "Ada", "time": "-009999-01-02T01:59:59Z" }), "-009999"),
    ] {
        service.post_json("/v1/assets/after/maintenance", &body).expect_problem(422, &[word]);
    }
    service.get("/v1/assets/none/maintenance").expect_problem(404, &["none"]);
    service.post_json("/v1/assets/none/maintenance", &done).expect_problem(404, &["none"]);
}

#[test]
fn a_refused_event_names_the_field_at_fault() {
    let service = Service::start();
    service.plain_asset("pump");
    let inspected = |inspection: Value| json!({ "kind": "inspected", "by": "Ada", "inspection": inspection });
    let replaced = |field: &str, value: Value| json!({ "kind": "gear_replaced", "by": "Ada", field: value });
    for (event, field, value) in [
        (inspected(json!({ "depth_um": -1 })), "inspection.depth_um", "-1"),
        (inspected(json!({ "depth_um": 1, "error_um": 0 })), "inspection.error_um", "0"),
        (inspected(json!({ "depth_um": 1, "gear": 3 })), "inspection.gear", "3"),
        (inspected(json!(null)), "inspection", "missing"),
        (replaced("inspection", json!({ "depth_um": 1 })), "inspection", "given"),
        (replaced("until", json!(minute(1))), "until", "2026-01-01T00:01:00Z"),
        (json!({ "kind": "baseline_chosen", "by": "Ada" }), "until", "missing"),
        (json!({ "kind": "gear_replaced", "by": "" }), "by", "\"\""),
    ] {
        let problem =
            service.post_json("/v1/assets/pump/maintenance", &event).expect_problem(422, &[field, value]);
        assert_eq!((&problem["field"], &problem["value"]), (&json!(field), &json!(value)), "{event}");
        assert!(problem["expected"].is_string(), "{problem}");
    }
}
