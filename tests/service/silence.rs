//! Alarms of machines that stop sending records.

use serde_json::{Value, json};

use crate::alarms::{act, loud, wait_for_alarm, whole};
use crate::running::{Service, plain_asset};

/// Describes an asset with a silence rule: a warning after a minute, danger after an hour.
fn silent_after_a_minute(id: &str) -> Value {
    let mut asset = plain_asset(id);
    asset["alarms"] = json!([{ "quantity": "stale_s", "warning": 60, "danger": 3600 }]);
    asset
}

#[test]
fn a_silence_alarm_worsens_survives_a_restart_and_clears_with_a_record() {
    let mut service = Service::start();
    service.post_json("/v1/assets", &silent_after_a_minute("pump")).expect(201);
    service.post_json("/v1/assets", &silent_after_a_minute("fan")).expect(201);
    service.upload("pump", &loud(0, 1.0));
    service.clock.advance(61);
    let raised = wait_for_alarm(&service, "pump", |alarm| alarm["severity"] == "warning");
    assert_eq!((&raised["state"], &raised["quantity"]), (&json!("unacknowledged"), &json!("stale_s")));
    assert_eq!(raised["value"], 61.0);
    // A channel that never had a record is not waited for.
    assert_eq!(service.get("/v1/alarms?asset=fan").expect(200).json()["items"], json!([]));
    act(&service, &raised, "acknowledge", &json!({ "by": "Ada" })).expect(200);
    service.clock.advance(3600);
    wait_for_alarm(&service, "pump", |alarm| {
        alarm["severity"] == "danger" && alarm["state"] == "unacknowledged"
    });

    service.restart();
    let kept = whole(&service, "pump");
    assert_eq!((&kept["severity"], &kept["state"]), (&json!("danger"), &json!("unacknowledged")));
    // By the clock a record is received now, whatever its own time.
    service.upload("pump", &loud(1, 1.0));
    let over = whole(&service, "pump");
    assert_eq!((&over["severity"], &over["state"]), (&Value::Null, &json!("returned_unacknowledged")));
    let severities: Vec<&Value> =
        over["history"].as_array().unwrap().iter().map(|entry| &entry["severity"]).collect();
    assert_eq!(severities, [&json!("warning"), &json!("warning"), &json!("danger"), &Value::Null]);
    assert_eq!(over["history"][0]["action"], json!({ "stale": { "severity": "warning", "silent_s": 61 } }));

    // A record that is late by its own time ends it too.
    service.clock.advance(61);
    wait_for_alarm(&service, "pump", |alarm| alarm["severity"] == "warning");
    service.upload("pump", &loud(0, 1.1));
    wait_for_alarm(&service, "pump", |alarm| alarm["severity"].is_null());
}
