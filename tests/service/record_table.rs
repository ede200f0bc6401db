//! Records selected by status or identifier, counted, downloaded, and listed by recording.

use serde_json::{Value, json};

use crate::alarms::{at_once, loud, watched};
use crate::running::{Service, mcap, record, samples, wav};

const SEGMENTS: &str = "/v1/assets/pump/segments";

fn ids(list: &Value) -> Vec<String> {
    let items = list["items"].as_array().unwrap().iter();
    items.map(|item| item["id"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn records_are_listed_and_counted_by_status_page_by_page() {
    let service = Service::start();
    service.plain_asset("pump");
    for n in 0..11 {
        service.upload("pump", &record("1", n));
        service.upload("pump", &record("2", n));
    }
    let get = |query: &str| service.get(&format!("{SEGMENTS}{query}")).expect(200).json();
    assert_eq!(get("/count")["records"], 22);
    let baseline = get("/count?status=collecting_baseline&channel=1");
    assert_eq!(
        (&baseline["records"], &baseline["first_start_time"], &baseline["last_start_time"]),
        (&json!(8), &json!("2026-01-01T00:00:00Z"), &json!("2026-01-01T00:07:00Z"))
    );
    assert_eq!(get("/count?status=no_library,estimated&from=2026-01-01T00:09:00Z")["records"], 4);
    assert_eq!(get("/count?channel=3")["records"], 0);

    let all = ids(&get("?status=collecting_baseline&order=desc"));
    assert_eq!(all.len(), 16);
    let (mut paged, mut cursor) = (Vec::new(), String::new());
    loop {
        let page = get(&format!("?status=collecting_baseline&order=desc&limit=5{cursor}"));
        paged.extend(ids(&page));
        let Some(next) = page["next_cursor"].as_str() else {
            break;
        };
        cursor = format!("&cursor={next}");
    }
    assert_eq!(paged, all);
    service
        .get(&format!("{SEGMENTS}?status=healthy"))
        .expect_problem(400, &["status", "healthy", "collecting_baseline"]);
    service.get("/v1/assets/none/segments/count").expect(404);
}

#[test]
fn records_are_excluded_included_and_deleted_by_name() {
    let service = Service::start();
    service.plain_asset("pump");
    service.plain_asset("other");
    let segments: Vec<Value> = (0..5).map(|n| service.upload("pump", &record("1", n))).collect();
    let foreign = service.upload("other", &record("1", 9));
    let id = |n: usize| segments[n]["id"].as_str().unwrap();
    let named = format!("ids={},{}", id(1), id(3));
    let post = |action: &str| service.post(&format!("{SEGMENTS}/{action}?{named}"), "application/json", b"");
    assert_eq!(post("exclude").expect(200).json(), json!({ "changed": 2 }));
    assert_eq!(post("exclude").expect(200).json(), json!({ "changed": 0 }));
    assert_eq!(post("include").expect(200).json(), json!({ "changed": 2 }));
    let foreign = format!("{SEGMENTS}?ids={},{}", id(0), foreign["id"].as_str().unwrap());
    service.delete(&foreign).expect_problem(404, &["pump", "segment"]);
    assert_eq!(service.get(&format!("{SEGMENTS}/count")).expect(200).json()["records"], 5, "all or none");
    let both = format!("{SEGMENTS}?{named}&from=2026-01-01T00:00:00Z");
    service.delete(&both).expect_problem(400, &["ids is given, expected no value together with channel"]);
    let many = vec![id(0); 201].join(",");
    service.delete(&format!("{SEGMENTS}?ids={many}")).expect_problem(400, &["201", "200"]);
    assert_eq!(service.delete(&format!("{SEGMENTS}?{named}")).expect(200).json(), json!({ "deleted": 2 }));
    assert_eq!(ids(&service.get(SEGMENTS).expect(200).json()), [id(0), id(2), id(4)].map(str::to_owned));
}

#[test]
fn the_raw_recording_is_downloaded_unchanged() {
    let service = Service::start();
    service.plain_asset("pump");
    let bytes = wav(&[samples(1), samples(2)]);
    let path = format!("{SEGMENTS}?unit=g&channel_names=a/1,b&start_time=2026-01-01T00:00:00Z");
    let sent = service.post(&path, "audio/wav", &bytes).expect(201).json();
    let id = sent["segments"][0]["id"].as_str().unwrap();
    let raw = service.get(&format!("/v1/segments/{id}/raw")).expect(200);
    assert_eq!(raw.bytes, bytes);
    assert_eq!(raw.header("content-type"), "audio/wav");
    assert_eq!(
        raw.header("content-disposition"),
        "attachment; filename=\"pump-a-1-2026-01-01T00-00-00Z.wav\""
    );
    service.get("/v1/segments/none/raw").expect(404);
}

#[test]
fn a_recording_lists_its_records() {
    let service = Service::start();
    service.plain_asset("pump");
    service.upload("pump", &record("1", 1));
    let recording = mcap(&[record("1", 0), record("1", 1), record("1", 2)]);
    let answer = service.post(SEGMENTS, "application/mcap", &recording).expect(201).json();
    let brought: Vec<&str> =
        answer["segments"].as_array().unwrap().iter().map(|id| id.as_str().unwrap()).collect();
    let all = ids(&service.get(SEGMENTS).expect(200).json());
    assert_eq!(answer["stored"], brought.len());
    assert!(brought.iter().all(|id| all.iter().any(|known| known == id)), "{answer}");
    let again = service.post(SEGMENTS, "application/mcap", &recording).expect(201).json();
    assert_eq!(again["segments"], json!([]), "what was there is none of it");
}

#[test]
fn a_trial_rule_is_evaluated_on_the_history() {
    let service = Service::start();
    service.post_json("/v1/assets", &watched("pump", &at_once())).expect(201);
    let loudness = [1.0, 1.0, 2.5, 4.0, 1.0, 2.5, 1.0, 4.0, 1.0, 2.5];
    let segments: Vec<Value> =
        (0..).zip(loudness).map(|(n, factor)| service.upload("pump", &loud(n, factor))).collect();
    let alarm = service.get("/v1/alarms?asset=pump").expect(200).json()["items"][0]["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let alarm = service.get(&format!("/v1/alarms/{alarm}")).expect(200).json();
    let raised: Vec<Value> =
        alarm["history"].as_array().unwrap().iter().map(|entry| entry["severity"].clone()).collect();
    let rule = watched("pump", &at_once())["alarms"][0].clone();
    let attempt = |rule: &Value| service.post_json("/v1/assets/pump/alarms/try", &json!({ "rule": rule }));
    let trial = attempt(&rule).expect(200).json();
    let tried: Vec<Value> =
        trial["changes"].as_array().unwrap().iter().map(|change| change["severity"].clone()).collect();
    assert_eq!(tried, raised, "{trial}");
    assert_eq!(
        (&trial["records"], &trial["readings"], &trial["warnings"], &trial["dangers"], &trial["severity"]),
        (&json!(10), &json!(10), &json!(3), &json!(2), &json!("warning")),
        "{trial}"
    );
    let high = json!({ "quantity": { "indicator": "rms" }, "warning": 50 });
    assert_eq!(attempt(&high).expect(200).json()["changes_count"], 0);
    assert_eq!(service.get("/v1/assets/pump").expect(200).json()["alarms"][0], rule, "nothing is stored");
    let excluded = segments[3]["id"].as_str().unwrap();
    service.post(&format!("/v1/segments/{excluded}/exclude"), "application/json", b"").expect(200);
    let without = attempt(&rule).expect(200).json();
    assert_eq!((&without["records"], &without["dangers"]), (&json!(9), &json!(1)), "{without}");

    attempt(&json!({ "quantity": { "indicator": "rms" } })).expect_problem(422, &["warning"]);
    let inverted = json!({ "quantity": { "indicator": "rms" }, "warning": 60, "danger": 50 });
    let problem =
        attempt(&inverted).expect_problem(422, &["rule.danger is 50, expected a level above warning"]);
    assert_eq!((&problem["field"], &problem["value"]), (&json!("rule.danger"), &json!("50")));
    let twice = json!({ "quantity": "novelty", "warning": 4, "settings":
        { "raise": 3, "raise_of": 2, "clear": 1, "clear_of": 1 } });
    assert_eq!(attempt(&twice).expect_problem(422, &[])["field"], "rule.settings.raise");
    attempt(&json!({ "quantity": { "indicator": "rns" }, "warning": 1 }))
        .expect_problem(422, &["rns", "rms"]);
    attempt(&json!({ "quantity": "stale_s", "warning": 60 })).expect_problem(422, &["stale_s", "clock"]);
}

#[test]
fn baseline_statistics_are_of_the_latest_baseline() {
    let service = Service::start();
    service.plain_asset("pump");
    let path = "/v1/assets/pump/indicators/baseline?names=rms,kurtosis";
    assert_eq!(service.get(path).expect(200).json()["items"], json!([]));
    for n in 0..12 {
        service.upload("pump", &loud(n, if n < 8 { 1.0 + 0.1 * (n % 2) as f32 } else { 9.0 }));
    }
    let known = service.get(path).expect(200).json();
    assert_eq!((&known["records"], &known["last_start_time"]), (&json!(8), &json!("2026-01-01T00:07:00Z")));
    let trend = service.get("/v1/assets/pump/indicators?names=rms").expect(200).json();
    let values: Vec<f64> =
        trend["items"].as_array().unwrap()[..8].iter().map(|row| row["rms"].as_f64().unwrap()).collect();
    let mean = values.iter().sum::<f64>() / 8.0;
    let deviation = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 7.0).sqrt();
    let rms = &known["items"][0];
    assert!((rms["mean"].as_f64().unwrap() - mean).abs() < 1e-9, "{known}");
    assert!((rms["standard_deviation"].as_f64().unwrap() - deviation).abs() < 1e-9, "{known}");
    assert_eq!(rms["unit"], "m/s2");
    service.get("/v1/assets/pump/indicators/baseline?names=rns").expect_problem(400, &["rns", "rms"]);
}
