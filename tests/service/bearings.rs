//! A machine without a gear mesh: bearings, velocity zones and novelty, without wear.

use std::f64::consts::TAU;

use flankwatch::signal::{OperatingPoint, Record};
use serde_json::{Value, json};

use crate::command::flankwatch;
use crate::running::{Service, mcap, minute};

const RATE_HZ: f64 = 8192.0;
const SHAFT_HZ: f64 = 24.6;

/// Outer-race ball passes per revolution, with 9 balls of 7.94 mm on 39.04 mm.
const BPFO: f64 = 3.585;

/// Returns imbalance and noise with outer-race impacts that ring at 2 kHz, with 1 % jitter in time.
fn turning(n: u32, impact: f64) -> Record {
    let mut state = 7 + 977 * n;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24) - 0.5
    };
    let count = 16_384;
    let mut samples: Vec<f64> = (0..count)
        .map(|k| {
            let turn = TAU * SHAFT_HZ * f64::from(k) / RATE_HZ;
            0.8 * turn.sin() + 0.3 * (2.0 * turn).sin() + (0..4).map(|_| random()).sum::<f64>()
        })
        .collect();
    let interval = RATE_HZ / (BPFO * SHAFT_HZ);
    let mut at = 0.4 * interval;
    while at.ceil() < f64::from(count) {
        let first = at.ceil() as usize;
        for (after, sample) in samples[first..].iter_mut().take(80).enumerate() {
            let t = ((first + after) as f64 - at) / RATE_HZ;
            *sample += impact * (-t / 1e-3).exp() * (TAU * 2000.0 * t).sin();
        }
        at += interval * (1.0 + 0.02 * random());
    }
    let samples = samples.into_iter().map(|x| x as f32).collect();
    Record::new("1", minute(n.into()), RATE_HZ, "m/s2", samples).unwrap()
}

fn with_speed(record: Record) -> Record {
    let point = OperatingPoint { shaft_speed_hz: Some(SHAFT_HZ), ..OperatingPoint::default() };
    record.with_operating_point(point).unwrap()
}

fn fan() -> Value {
    json!({
        "id": "fan",
        "shaft": { "speed_hz": 24.5, "speed_tolerance": 0.03 },
        "bearings": [{
            "name": "drive_end", "rolling_elements": 9, "roller_diameter_mm": 7.94, "pitch_diameter_mm": 39.04,
        }],
        "velocity_zones": { "machine_class": "group_2_rigid" },
        "baseline": { "records": 8 },
    })
}

#[test]
fn a_machine_without_a_mesh_is_assessed_by_novelty_bearings_and_velocity() {
    let service = Service::start();
    let made = service.post_json("/v1/assets", &fan()).expect(201).json();
    assert_eq!((made.get("gear"), &made["summary"]["library_state"]), (None, &json!("none")));
    let bpfo = made["summary"]["bearing_orders"]["drive_end"]["bpfo"].as_f64().unwrap();
    assert!((bpfo - BPFO).abs() < 1e-3, "{bpfo}");
    assert_eq!(made["summary"]["velocity_limits_mm_per_s"], json!([1.4, 2.8, 4.5]));
    for n in 1..=8 {
        let segment = service.upload("fan", &turning(n, 0.0));
        assert_eq!(segment["wear"]["status"], "collecting_baseline", "{segment}");
    }
    let calm = service.upload("fan", &turning(9, 0.0));
    assert_eq!(calm["wear"]["status"], "no_mesh", "{}", calm["wear"]["reason"]);
    // The shaft's lines give its speed, without assumed teeth.
    assert_eq!(calm["shaft_speed"]["source"], "shaft_lines");
    assert!((calm["shaft_speed"]["shaft_speed_hz"].as_f64().unwrap() - SHAFT_HZ).abs() < 0.05);
    assert_eq!(calm["shaft_speed"].get("mesh_frequency_hz"), None);
    let names =
        calm["indicators"].as_object().unwrap().keys().chain(calm["absent"].as_object().unwrap().keys());
    assert!(names.clone().all(|name| !name.starts_with("mesh_") && name != "fm4" && name != "omx"));
    assert_eq!(names.filter(|name| name.starts_with("bearing_drive_end_")).count(), 8);

    let failing: Vec<Value> = (10..=14).map(|n| service.upload("fan", &turning(n, 8.0))).collect();
    let last = &failing[4];
    let ratio = |segment: &Value, line: &str| {
        segment["indicators"][format!("bearing_drive_end_{line}_to_background")].as_f64().unwrap()
    };
    assert!(ratio(&calm, "bpfo") < 3.0 && ratio(last, "bpfo") > 5.0, "{}", ratio(last, "bpfo"));
    // Timing that is not steady smears the strong line into skirts.
    assert!(["bpfi", "bsf"].iter().all(|line| ratio(last, line) < 0.1 * ratio(last, "bpfo")));
    assert_eq!(last["wear"]["status"], "outside_library");
    let reason = last["wear"]["reason"].as_str().unwrap();
    assert!(reason.contains("the outer race of bearing drive_end") && !reason.contains("mesh"), "{reason}");
    let source = &last["wear"]["novelty"]["envelope_line"]["source"];
    assert_eq!((&source["bearing"], &source["line"]), (&json!("drive_end"), &json!("bpfo")), "{source}");

    let alarms = service.get("/v1/alarms?asset=fan").expect(200).json();
    let raised: Vec<&Value> =
        alarms["items"].as_array().unwrap().iter().map(|alarm| &alarm["quantity"]).collect();
    assert!(raised.contains(&&json!({ "indicator": "bearing_drive_end_bpfo_to_background" })), "{raised:?}");

    let id = last["id"].as_str().unwrap();
    let shown = service.get(&format!("/v1/segments/{id}")).expect(200).json();
    assert!(["A", "B", "C", "D"].contains(&shown["velocity_zone"].as_str().unwrap()), "{shown}");
    let trend = service.get("/v1/assets/fan/indicators?names=velocity_rms").expect(200).json();
    assert_eq!(trend["units"]["velocity_rms"], "mm/s");
    assert_eq!(trend["items"][13]["velocity_zone"], shown["velocity_zone"]);
    service.get("/v1/assets/fan/indicators?names=fm4").expect_problem(400, &["fm4"]);
    let envelope = service.get(&format!("/v1/segments/{id}/envelope")).expect(200).json();
    assert_eq!(
        (&envelope["band_source"], &envelope["band_hz"]),
        (&json!("impacts"), &json!([512.0, 3686.4]))
    );
    for page in ["spectrum", "cepstrum", "waveform"] {
        service.get(&format!("/v1/segments/{id}/{page}")).expect(200);
    }
    for page in ["orders", "turn"] {
        service.get(&format!("/v1/segments/{id}/{page}")).expect_problem(422, &["this record has no"]);
    }
    service.get(&format!("/v1/segments/{id}/turn?gear=2")).expect_problem(400, &["gear", "no mesh"]);
    for axis in ["hz", "orders"] {
        let waterfall = service.get(&format!("/v1/assets/fan/waterfall?axis={axis}")).expect(200).json();
        assert_eq!(waterfall["mesh_position"], Value::Null);
    }
    let report = service.get("/v1/assets/fan/report").expect(200);
    assert!(String::from_utf8_lossy(&report.bytes).contains("drive_end"));
    service.get("/v1/assets/fan/wear").expect(200);
}

/// A changed description recomputes the records from the recordings.
#[test]
fn a_bearing_added_later_is_found_in_earlier_records() {
    let service = Service::start();
    let mut machine = fan();
    machine.as_object_mut().unwrap().remove("bearings");
    machine["shaft"] = json!({});
    service.post_json("/v1/assets", &machine).expect(201);
    let id = service.upload("fan", &with_speed(turning(1, 8.0)))["id"].as_str().unwrap().to_owned();
    let path = format!("/v1/segments/{id}");
    let shown = service.get(&path).expect(200).json();
    assert_eq!(shown["indicators"].get("bearing_drive_end_bpfo"), None);
    assert_eq!(shown["shaft_speed"]["source"], "record");
    service.put_json("/v1/assets/fan", &fan()).expect(200);
    service.wait_for(&path, |shown| {
        shown["indicators"]["bearing_drive_end_bpfo"].as_f64().is_some_and(|amplitude| amplitude > 0.1)
    });
}

#[test]
fn a_description_without_a_mesh_is_validated() {
    let service = Service::start();
    let refused = |path: &str, value: Value, words: &[&str]| {
        let mut machine = fan();
        *machine.pointer_mut(path).unwrap() = value;
        service.post_json("/v1/assets", &machine).expect_problem(422, words);
    };
    refused("/shaft", Value::Null, &["gear", "missing", "shaft"]);
    refused("/shaft/speed_hz", json!(0), &["shaft.speed_hz", "above 0"]);
    refused("/bearings/0/roller_diameter_mm", json!(50), &["bearings.roller_diameter_mm", "39.04"]);
    refused("/velocity_zones", json!({ "limits_mm_per_s": [3, 2, 1] }), &["velocity_zones.limits_mm_per_s"]);
    let mut machine = fan();
    machine["limits"] = json!({ "danger_um": 100 });
    service.post_json("/v1/assets", &machine).expect_problem(422, &["limits.danger_um", "gear"]);
}

#[test]
fn the_command_line_analyses_a_machine_without_a_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(
        at("fan.toml"),
        "id = \"fan\"\nbaseline = { records = 8 }\n[shaft]\nspeed_hz = 24.6\n\
         speed_is_exact = true\n[[bearings]]\nname = \"de\"\nrolling_elements = 9\nroller_diameter_mm = 7.94\n\
         pitch_diameter_mm = 39.04\n",
    )
    .unwrap();
    let records: Vec<Record> = (1..=18).map(|n| turning(n, if n < 10 { 0.0 } else { 8.0 })).collect();
    std::fs::write(at("run.mcap"), mcap(&records)).unwrap();
    let words = ["analyze", &at("run.mcap"), "--asset", &at("fan.toml")];
    let table = flankwatch(&words).expect_success().out();
    assert!(table.contains("no_mesh") && table.contains("outside_library: impulsive_energy"), "{table}");
    let last = table.lines().last().unwrap();
    assert!(last.contains("abnormal since record 10: most likely impulses have grown"), "{last}");
    assert!(last.contains("the outer race of bearing de"), "{last}");
    let ratio = ["--columns", "bearing_de_bpfo_to_background,velocity_rms"];
    flankwatch(&[&words[..], &ratio[..]].concat()).expect_success();
}
