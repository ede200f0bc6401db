//! Alarms end to end: raised by records, changed by operators, independent of the order of arrival.

use flankwatch::signal::Record;
use serde_json::{Value, json};

use crate::event_stream::EventStream;
use crate::running::{Service, mcap, minute, plain_asset, samples};

/// Describes an asset with an alarm on the RMS; a record of [`loud`] with factor 4 is above danger, one with
/// factor 1 below all levels.
pub(crate) fn watched(id: &str, settings: &Value) -> Value {
    let mut asset = plain_asset(id);
    asset["alarms"] = json!([
        { "quantity": { "indicator": "rms" }, "warning": 1.5, "danger": 2.5, "hysteresis": 0.1, "settings": settings },
        { "quantity": "novelty", "warning": 1000 },
    ]);
    asset
}

/// Returns the settings of a rule that responds to every record.
pub(crate) fn at_once() -> Value {
    json!({ "raise": 1, "raise_of": 1, "clear": 1, "clear_of": 1 })
}

/// Returns record `n`, one per minute, with its amplitude times a factor; its RMS is about 0.8 times the
/// factor.
pub(crate) fn loud(n: u32, factor: f32) -> Record {
    let samples: Vec<f32> = samples(0).into_iter().map(|sample| factor * sample).collect();
    Record::new("1", minute(n.into()), 4000.0, "m/s2", samples).unwrap()
}

fn only_alarm(service: &Service, asset: &str) -> Value {
    let list = service.get(&format!("/v1/alarms?asset={asset}")).expect(200).json();
    assert_eq!(list["items"].as_array().unwrap().len(), 1, "{list}");
    list["items"][0].clone()
}

pub(crate) fn whole(service: &Service, asset: &str) -> Value {
    let id = only_alarm(service, asset)["id"].as_str().unwrap().to_owned();
    service.get(&format!("/v1/alarms/{id}")).expect(200).json()
}

/// Waits until the only alarm of an asset satisfies a condition.
pub(crate) fn wait_for_alarm(service: &Service, asset: &str, is_wanted: impl Fn(&Value) -> bool) -> Value {
    let list = service.wait_for(&format!("/v1/alarms?asset={asset}"), |list| {
        list["items"].as_array().is_some_and(|items| items.iter().any(&is_wanted))
    });
    list["items"][0].clone()
}

/// Returns the alarm's history: state, severity, time, action and operator of each entry.
pub(crate) fn history_entries(alarm: &Value) -> Vec<Value> {
    let entries = alarm["history"].as_array().unwrap().iter();
    let history_entries = entries.filter(|entry| entry["withdrawn_at"].is_null());
    history_entries
        .map(|entry| json!([entry["state"], entry["severity"], entry["time"], entry["action"], entry["by"]]))
        .collect()
}

pub(crate) fn act(service: &Service, alarm: &Value, action: &str, body: &Value) -> crate::running::Answer {
    let id = alarm["id"].as_str().unwrap();
    service.post_json(&format!("/v1/alarms/{id}/{action}"), body)
}

#[test]
fn an_alarm_is_raised_acknowledged_shelved_and_cleared() {
    let service = Service::start();
    service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
    let mut events = EventStream::open(&service, "?asset=pump", None);
    service.upload("pump", &loud(0, 1.0));
    assert_eq!(service.get("/v1/alarms").expect(200).json()["items"], json!([]));
    let quiet = service.get("/v1/assets/pump").expect(200).json();
    let rules = quiet["summary"]["alarm_rules"].as_array().unwrap();
    assert_eq!(
        (rules.len(), &rules[0]["danger"], &rules[1]["settings"]["raise_of"]),
        (2, &json!(2.5), &json!(5))
    );
    service.upload("pump", &loud(1, 4.0));
    let alarm = only_alarm(&service, "pump");
    assert_eq!(
        (&alarm["state"], &alarm["severity"], &alarm["raised_at"], &alarm["quantity"]),
        (&json!("unacknowledged"), &json!("danger"), &json!(minute(1)), &json!({ "indicator": "rms" })),
        "{alarm}"
    );
    let seen = std::iter::repeat_with(|| events.next()).find(|event| event.kind == "alarm").unwrap();
    assert_eq!(
        (&seen.data["alarm"]["id"], &seen.data["change"]["state"]),
        (&alarm["id"], &json!("unacknowledged"))
    );
    let summary = |key: &str| service.get("/v1/assets/pump").expect(200).json()["summary"][key].clone();
    assert_eq!(summary("category"), "failure");
    assert_eq!(summary("alarms"), json!({ "danger": 1, "warning": 0, "unacknowledged": 1, "shelved": 0 }));
    let list = service.get("/v1/assets").expect(200).json();
    assert_eq!(list["items"][0]["summary"]["category"], "failure");

    act(&service, &alarm, "acknowledge", &json!({ "by": "" })).expect_problem(422, &["by"]);
    act(&service, &alarm, "acknowledge", &json!({ "by": "Ada", "who": "x" })).expect_problem(422, &["who"]);
    let acknowledged =
        act(&service, &alarm, "acknowledge", &json!({ "by": "Ada", "comment": "seen" })).expect(200).json();
    assert_eq!(acknowledged["state"], "acknowledged");
    assert_eq!(acknowledged["history"][1]["by"], "Ada");
    act(&service, &alarm, "acknowledge", &json!({ "by": "Ada" })).expect_problem(409, &["acknowledged"]);
    act(&service, &alarm, "unshelve", &json!({ "by": "Ada" })).expect_problem(409, &["shelved"]);
    act(&service, &alarm, "comment", &json!({ "by": "Ada" })).expect_problem(422, &["comment"]);
    act(&service, &alarm, "shelve", &json!({ "by": "Ada", "until": "2025-01-01T00:00:00Z" }))
        .expect_problem(422, &["until"]);
    act(&service, &json!({ "id": "none" }), "acknowledge", &json!({ "by": "Ada" }))
        .expect_problem(404, &["none"]);

    let until = minute(60);
    let shelved = act(&service, &alarm, "shelve", &json!({ "by": "Bob", "until": until })).expect(200).json();
    assert_eq!((&shelved["state"], &shelved["severity"]), (&json!("shelved"), &json!("danger")));
    assert_eq!(summary("alarms")["shelved"], 1);
    assert_ne!(summary("category"), "failure");
    let metrics = String::from_utf8(service.get("/metrics/machines").expect(200).bytes).unwrap();
    for line in [
        "flankwatch_alarm_severity{asset=\"pump\",channel=\"1\",quantity=\"indicator:rms\"} 2",
        "flankwatch_alarm_shelved{asset=\"pump\",channel=\"1\",quantity=\"indicator:rms\"} 1",
        "flankwatch_alarm_unacknowledged{asset=\"pump\",channel=\"1\",quantity=\"indicator:rms\"} 0",
    ] {
        assert!(metrics.contains(line), "{line} in {metrics}");
    }
    assert_eq!(service.get("/v1/alarms?state=shelved").expect(200).json()["items"][0]["id"], alarm["id"]);
    service.clock.advance(3601);
    // The event is sent without a new record.
    let address = format!("/v1/alarms/{}", alarm["id"].as_str().unwrap());
    let shown = service.wait_for(&address, |alarm| {
        let last = alarm["history"].as_array().unwrap().last().unwrap().clone();
        last["action"] == "shelving_over"
    });
    let over = shown["history"].as_array().unwrap().last().unwrap();
    assert_eq!((&over["state"], &over["by"]), (&json!("acknowledged"), &Value::Null));
    let back = only_alarm(&service, "pump");
    assert_eq!((&back["state"], &back["shelved_until"]), (&json!("acknowledged"), &Value::Null));

    // The alarm eases, then clears.
    service.upload("pump", &loud(2, 2.2));
    service.upload("pump", &loud(3, 1.0));
    assert_eq!(only_alarm(&service, "pump")["state"], "normal");
    service.upload("pump", &loud(4, 4.0));
    service.upload("pump", &loud(5, 1.0));
    let returned = only_alarm(&service, "pump");
    assert_eq!(
        (&returned["state"], &returned["severity"]),
        (&json!("returned_unacknowledged"), &Value::Null)
    );
    assert_eq!(service.get("/v1/alarms?state=normal,shelved").expect(200).json()["items"], json!([]));
    service.get("/v1/alarms?state=loud").expect_problem(400, &["state", "loud"]);
    service.get("/v1/alarms?severity=bad").expect_problem(400, &["severity"]);
    service.get("/v1/alarms?asset=none").expect_problem(404, &["none"]);
    let shown = only_alarm(&service, "pump");
    let mut mine = service.get("/v1/alarms").expect(200);
    let mark = mine.header("etag").to_owned();
    mine = service.send("GET", "/v1/alarms", &[("if-none-match", &mark)], b"");
    assert_eq!(mine.status, 304);
    assert_eq!(exported(&service), history_entries(&whole(&service, "pump")).len());
    assert_eq!(shown["value"].as_f64().map(|value| value < 1.4), Some(true));
}

/// Returns the number of alarm messages in the export, and checks that none is empty.
fn exported(service: &Service) -> usize {
    let bytes = service.get("/v1/assets/pump/export?spectra=0").expect(200).bytes;
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let alarms: Vec<_> = messages.filter(|message| message.channel.topic == "/pump/1/alarm").collect();
    for message in &alarms {
        let text = String::from_utf8_lossy(&message.data);
        assert!(text.contains("indicator:rms"), "{text}");
        assert_eq!(message.channel.schema.as_ref().unwrap().name, "flankwatch.v1.AlarmState");
    }
    alarms.len()
}

#[test]
fn alarms_are_paged_by_latest_change() {
    let service = Service::start();
    for (n, id) in ["a", "b", "c"].into_iter().enumerate() {
        service.post_json("/v1/assets", &watched(id, &at_once())).expect(201);
        service.upload(id, &loud(n as u32, 4.0));
    }
    let first = service.get("/v1/alarms?limit=2").expect(200).json();
    let assets = |page: &Value| -> Vec<String> {
        let items = page["items"].as_array().unwrap();
        items.iter().map(|item| item["asset_id"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(assets(&first), ["c", "b"]);
    let cursor = first["next_cursor"].as_str().unwrap();
    let second = service.get(&format!("/v1/alarms?limit=2&cursor={cursor}")).expect(200).json();
    assert_eq!((assets(&second), &second["next_cursor"]), (vec!["a".to_owned()], &Value::Null));
    service.get("/v1/alarms?cursor=x").expect_problem(400, &["cursor"]);
    service.delete("/v1/assets/b").expect(204);
    assert_eq!(assets(&service.get("/v1/alarms").expect(200).json()), ["c", "a"]);
}

/// Factors at which a 2-of-3 rule raises, worsens, eases and clears.
fn life() -> Vec<Record> {
    let factors =
        [1.0, 1.0, 2.2, 1.0, 2.2, 4.0, 2.2, 4.0, 4.0, 2.2, 2.2, 1.0, 2.2, 1.0, 1.0, 1.0, 4.0, 4.0, 1.0, 1.0];
    (0..).zip(factors).map(|(n, factor)| loud(n, factor)).collect()
}

#[test]
fn alarms_are_the_same_after_late_records_restarts_and_recomputations() {
    let mut service = Service::start();
    let settings = json!({ "raise": 2, "raise_of": 3, "clear": 2, "clear_of": 3 });
    for asset in ["in-order", "late"] {
        service.post_json("/v1/assets", &watched(asset, &settings)).expect(201);
    }
    let life = life();
    let acknowledge = |service: &Service, asset: &str| {
        let alarm = only_alarm(service, asset);
        act(service, &alarm, "acknowledge", &json!({ "by": "Ada" })).expect(200);
    };
    for (n, record) in life.iter().enumerate() {
        service.upload("in-order", record);
        if n == 9 {
            acknowledge(&service, "in-order");
        }
    }
    // Records in reverse order up to the acknowledgement, then the rest with one record of each half last.
    for n in [9, 8, 7, 6, 5, 4, 3, 1, 0] {
        service.upload("late", &life[n]);
    }
    acknowledge(&service, "late");
    for n in [12, 11, 10, 13, 15, 16, 19, 18, 17] {
        service.upload("late", &life[n]);
    }
    service
        .post("/v1/assets/late/segments", "application/mcap", &mcap(&[life[2].clone(), life[14].clone()]))
        .expect(201);
    let expected = history_entries(&whole(&service, "in-order"));
    assert!(expected.len() > 6, "{expected:?}");
    assert_eq!(history_entries(&whole(&service, "late")), expected);
    service.restart();
    assert_eq!(history_entries(&whole(&service, "late")), expected);
    for asset in ["in-order", "late"] {
        let mut description = watched(asset, &settings);
        description["baseline"]["records"] = json!(9);
        service.put_json(&format!("/v1/assets/{asset}"), &description).expect(200);
        service.wait_for(&format!("/v1/recomputations?asset={asset}"), |list| {
            list["items"][0]["state"] == "finished"
        });
        assert_eq!(history_entries(&whole(&service, asset)), expected, "{asset}");
    }
    // An action after everything, and one more record.
    for asset in ["in-order", "late"] {
        acknowledge(&service, asset);
        service.upload(asset, &loud(20, 4.0));
        service.upload(asset, &loud(21, 4.0));
    }
    assert_eq!(history_entries(&whole(&service, "late")), history_entries(&whole(&service, "in-order")));
    assert_eq!(only_alarm(&service, "late")["state"], "unacknowledged");
}

#[test]
fn changes_are_announced_exactly_once() {
    let service = Service::start();
    let settings = json!({ "raise": 2, "raise_of": 2, "clear": 1, "clear_of": 1 });
    service.post_json("/v1/assets", &watched("pump", &settings)).expect(201);
    let mut events = EventStream::open(&service, "?asset=pump", None);
    service.upload("pump", &loud(1, 4.0));
    service.upload("pump", &loud(3, 4.0));
    let alarm = whole(&service, "pump");
    assert_eq!((&alarm["state"], alarm["history"].as_array().unwrap().len()), (&json!("unacknowledged"), 1));
    // A late record between them that is quiet: no two in a row were loud.
    service.upload("pump", &loud(2, 1.0));
    let alarm = whole(&service, "pump");
    assert_eq!((&alarm["state"], &alarm["severity"]), (&json!("normal"), &Value::Null));
    assert_eq!(
        (&alarm["history"][0]["state"], &alarm["history"][0]["time"]),
        (&json!("unacknowledged"), &json!(minute(3)))
    );
    assert!(alarm["history"][0]["withdrawn_at"].is_string(), "{alarm}");
    // The alarm is raised, then late records arrive that don't change it.
    service.upload("pump", &loud(10, 4.0));
    service.upload("pump", &loud(11, 4.0));
    service.upload("pump", &loud(5, 1.0));
    service.upload("pump", &loud(6, 1.0));
    service.upload("pump", &loud(12, 1.0));
    let states: Vec<Value> = std::iter::repeat_with(|| events.next())
        .filter(|event| event.kind == "alarm")
        .take(4)
        .map(|event| event.data["alarm"]["state"].clone())
        .collect();
    assert_eq!(states, ["unacknowledged", "normal", "unacknowledged", "returned_unacknowledged"]);
}

#[test]
fn a_removed_rule_leaves_its_history() {
    let service = Service::start();
    service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
    service.upload("pump", &loud(0, 4.0));
    let mut description = watched("pump", &at_once());
    description["alarms"] = json!([]);
    service.put_json("/v1/assets/pump", &description).expect(200);
    service.wait_for("/v1/alarms?asset=pump", |list| list["items"][0]["rule"].is_null());
    let alarm = whole(&service, "pump");
    assert_eq!((&alarm["state"], &alarm["severity"]), (&json!("normal"), &Value::Null));
    assert_eq!(alarm["history"].as_array().unwrap().len(), 1);
    // Added again, the rule has the alarm that follows from the records.
    service.put_json("/v1/assets/pump", &watched("pump", &at_once())).expect(200);
    service.wait_for("/v1/alarms?asset=pump", |list| list["items"][0]["state"] == "unacknowledged");
    assert_eq!(whole(&service, "pump")["history"].as_array().unwrap().len(), 1);
}

#[test]
fn an_mcap_of_a_whole_life_raises_alarms_in_one_batch() {
    let service = Service::start();
    let settings = json!({ "raise": 2, "raise_of": 3, "clear": 2, "clear_of": 3 });
    for asset in ["batch", "single"] {
        service.post_json("/v1/assets", &watched(asset, &settings)).expect(201);
    }
    service.post("/v1/assets/batch/segments", "application/mcap", &mcap(&life())).expect(201);
    for record in life() {
        service.upload("single", &record);
    }
    assert_eq!(history_entries(&whole(&service, "batch")), history_entries(&whole(&service, "single")));
}

#[test]
fn levels_below_are_raised_and_cleared_by_records() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["alarms"] = json!([{ "quantity": { "indicator": "rms" }, "warning_below": 0.5, "danger_below": 0.1, "settings": at_once() }]);
    service.post_json("/v1/assets", &asset).expect(201);
    service.upload("pump", &loud(0, 1.0));
    service.upload("pump", &loud(1, 0.01));
    assert_eq!(only_alarm(&service, "pump")["severity"], "danger");
    service.upload("pump", &loud(2, 1.0));
    let over = only_alarm(&service, "pump");
    assert_eq!((&over["severity"], &over["rule"]["warning_below"]), (&Value::Null, &json!(0.5)));
}

#[test]
fn a_rate_of_change_raises_an_alarm() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    let quantity = json!({ "rate_per_day": { "indicator": "rms" } });
    asset["alarms"] =
        json!([{ "quantity": quantity, "warning": 100, "over_s": 1800, "settings": at_once() }]);
    service.post_json("/v1/assets", &asset).expect(201);
    (0..40).for_each(|n| drop(service.upload("pump", &loud(n, 1.0))));
    assert_eq!(service.get("/v1/alarms?asset=pump").expect(200).json()["items"], json!([]));
    // The RMS doubles in half an hour: by 0.8 in 1/48 of a day.
    (40..75).for_each(|n| drop(service.upload("pump", &loud(n, 1.0 + (n - 39) as f32 / 10.0))));
    let raised = only_alarm(&service, "pump");
    assert_eq!((&raised["severity"], &raised["quantity"]), (&json!("warning"), &quantity));
    assert!(raised["value"].as_f64().unwrap() > 100.0, "{raised}");
}

#[test]
fn a_sensor_fault_raises_an_alarm_that_names_it() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["alarms"] = json!([{ "quantity": "sensor_fault", "warning": 0.5, "settings": at_once() }]);
    service.post_json("/v1/assets", &asset).expect(201);
    for n in 0..12 {
        let record = Record::new("1", minute(n.into()), 4000.0, "m/s2", samples(n)).unwrap();
        service.upload("pump", &record);
    }
    assert_eq!(service.get("/v1/alarms?asset=pump").expect(200).json()["items"], json!([]));
    let silent = samples(13).into_iter().map(|sample| 1e-5 * sample).collect();
    service.upload("pump", &Record::new("1", minute(13), 4000.0, "m/s2", silent).unwrap());
    let raised = only_alarm(&service, "pump");
    assert_eq!((&raised["severity"], &raised["value"]), (&json!("warning"), &json!(1.0)));
    let wear = service.get("/v1/assets/pump/wear").expect(200).json();
    assert_eq!((&wear["status"], &wear["novelty"]["sensor_fault"]), (&json!("sensor_fault"), &json!("dead")));
}

#[test]
fn a_misspelt_indicator_is_rejected_with_the_nearest_names() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["alarms"] = json!([{ "quantity": { "indicator": "kurtsosis" }, "warning": 4 }]);
    let refused = service
        .post_json("/v1/assets", &asset)
        .expect_problem(422, &["kurtsosis", "the nearest are kurtosis"]);
    assert_eq!(refused["field"], "alarms.quantity.indicator");
    service.plain_asset("pump");
    for _ in 0..2 {
        // With and without records.
        let trend = service.get("/v1/assets/pump/indicators?names=rms,nonsense");
        assert_eq!(trend.expect_problem(400, &["nonsense", "the nearest are"])["field"], "names");
        service.get("/v1/assets/pump/indicators?names=rms,na4").expect(200);
        service.upload("pump", &loud(0, 1.0));
    }
}

/// Returns record `n` of four channels that measure a pump without a mesh, with a tone of some amplitude.
fn upload_four(service: &Service, n: u32, tone: f32) {
    for channel in ["a", "b", "c", "d"] {
        let samples = samples(n % 8).into_iter().enumerate();
        let samples = samples.map(|(k, sample)| sample + tone * (2.1 * k as f32).sin()).collect();
        let record = Record::new(channel, minute(n.into()), 4000.0, "m/s2", samples).unwrap();
        service.upload("pump", &record);
    }
}

#[test]
fn channels_together_raise_an_alarm_that_none_raises_alone() {
    let service = Service::start();
    let rule = |quantity: &str| json!({ "quantity": quantity, "warning": 2.75, "hysteresis": 1, "settings": at_once() });
    let pump = json!({
        "id": "pump", "shaft": {}, "sensor": { "unit": "m/s2" }, "baseline": { "records": 8 },
        "alarms": [rule("novelty"), rule("joint_novelty")],
    });
    service.post_json("/v1/assets", &pump).expect(201);
    (0..10).for_each(|n| upload_four(&service, n, 0.0));
    upload_four(&service, 10, 1.5);
    let together = service.get("/v1/assets/pump/wear").expect(200).json();
    let score = together["novelty"]["score"].as_f64().unwrap();
    let mut alone = together["channels"].as_array().unwrap().iter().map(|one| one["novelty_score"].as_f64());
    assert!(score > 2.75 && alone.all(|alone| alone.is_some_and(|alone| alone < 2.75)), "{together}");
    let raised = wait_for_alarm(&service, "pump", |alarm| alarm["severity"] == "warning");
    assert_eq!((&raised["quantity"], &raised["channel"]), (&json!("joint_novelty"), &json!("a")));
    assert_eq!(raised["value"], together["novelty"]["score"]);
    assert_eq!(
        act(&service, &raised, "acknowledge", &json!({ "by": "Ada" })).json()["state"],
        "acknowledged"
    );

    // Only records since the maintenance count.
    let done = json!({ "kind": "regime_changed", "by": "Ada", "time": minute(11) });
    service.post_json("/v1/assets/pump/maintenance", &done).expect(201);
    upload_four(&service, 11, 0.0);
    wait_for_alarm(&service, "pump", |alarm| alarm["severity"].is_null());
    (12..20).for_each(|n| upload_four(&service, n, 0.0));
    upload_four(&service, 20, 1.5);
    wait_for_alarm(&service, "pump", |alarm| alarm["severity"] == "warning");
    upload_four(&service, 21, 0.0);
    wait_for_alarm(&service, "pump", |alarm| alarm["severity"].is_null());
    let history_entries: Vec<Value> = whole(&service, "pump")["history"]
        .as_array()
        .unwrap()
        .iter()
        .map(|entry| json!([entry["severity"], entry["action"]["joint"]["severity"], entry["maintenance"]]))
        .collect();
    let is_told = [
        json!(["warning", "warning", null]),
        json!(["warning", null, null]),
        json!([null, null, "regime_changed"]),
        json!(["warning", "warning", null]),
        json!([null, null, null]),
    ];
    assert_eq!(history_entries, is_told);

    // A single channel has no joint novelty.
    upload_four(&service, 22, 1.5);
    wait_for_alarm(&service, "pump", |alarm| alarm["severity"] == "warning");
    let mut alone = pump.clone();
    alone["sensor"]["channel"] = json!("a");
    service.put_json("/v1/assets/pump", &alone).expect(200);
    wait_for_alarm(&service, "pump", |alarm| alarm["severity"].is_null());
    service
        .post_json("/v1/assets/pump/alarms/try", &json!({ "rule": rule("joint_novelty"), "channel": "a" }))
        .expect_problem(422, &["joint_novelty", "cannot be tried"]);
}
