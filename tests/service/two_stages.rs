//! Gearboxes with several meshes measured by one sensor: each mesh is an asset, and a record of the sensor is
//! analysed for all of them.

use flankwatch::gear::PairSpec;
use flankwatch::library::GridSettings;
use flankwatch::signal::{OperatingPoint, Record};
use flankwatch::simulation::{Run, RunPlan, TransmissionPath};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::running::{Service, mcap, minute, plain_asset, record};

/// A second mesh of 17 teeth, on the output shaft of the first one (31 to 62 teeth).
fn second(of: &str) -> Value {
    let mut asset = plain_asset("second");
    asset["gear"] = json!({ "teeth": [17, 50], "shaft_speed_hz": 5.0, "shaft_ratio": [31, 62] });
    asset["sensor"]["of"] = json!(of);
    asset
}

fn segments(service: &Service, asset: &str) -> Vec<Value> {
    let list = service.get(&format!("/v1/assets/{asset}/segments?limit=1000")).expect(200).json();
    list["items"].as_array().unwrap().clone()
}

/// Returns the results of each record in time order, without what differs between assets.
fn found(service: &Service, asset: &str) -> Vec<Value> {
    let without = |mut segment: Value| {
        // A record of an MCAP file has other bytes than the same one sent by itself, and is marked where the
        // file's numbers have a gap.
        for name in ["id", "asset_id", "received_at", "raw", "quality"] {
            segment.as_object_mut().unwrap().remove(name);
        }
        segment
    };
    segments(service, asset).into_iter().map(without).collect()
}

fn at_speed(record: Record, shaft_speed_hz: f64) -> Record {
    let point = OperatingPoint {
        shaft_speed_hz: Some(shaft_speed_hz),
        torque_nm: Some(40.0),
        ..OperatingPoint::default()
    };
    record.with_operating_point(point).unwrap()
}

#[test]
fn records_of_a_sensor_are_analysed_for_every_mesh() {
    let mut service = Service::start();
    service.plain_asset("first");
    // Some records before the second mesh is described, some after; one is late, one is sent twice.
    for n in 0..6 {
        service.upload("first", &at_speed(record("in", n), 10.0));
    }
    service.post_json("/v1/assets", &second("first")).expect(201);
    let records: Vec<Record> = [9, 8, 8, 10].map(|n| at_speed(record("in", n), 10.0)).into();
    for record in &records[..3] {
        service.upload("first", record);
    }
    let batch = mcap(&[records[3].clone(), at_speed(record("in", 7), 10.0)]);
    service.post("/v1/assets/first/segments", "application/mcap", &batch).expect(201);
    let path = "/v1/assets/second";
    service.wait_for(path, |asset| asset["summary"]["segments"] == 10);
    let derived = segments(&service, "second");
    let times: Vec<&Value> = derived.iter().map(|segment| &segment["start_time"]).collect();
    let sent = segments(&service, "first");
    assert_eq!(times, sent.iter().map(|segment| &segment["start_time"]).collect::<Vec<_>>());
    for (derived, sent) in derived.iter().zip(&sent) {
        // The raw bytes are the same object; the speed is that of its own shaft.
        assert_eq!(derived["raw"], sent["raw"]);
        assert_eq!(
            (&derived["shaft_speed"]["shaft_speed_hz"], &sent["shaft_speed"]["shaft_speed_hz"]),
            (&json!(5.0), &json!(10.0))
        );
    }
    service.wait_for("/v1/recomputations", |list| {
        let items = list["items"].as_array().unwrap();
        items.iter().all(|item| item["state"] == "finished")
    });
    // The same as if both had existed from the start.
    let (first, second_mesh) = (found(&service, "first"), found(&service, "second"));
    let fresh = Service::start();
    fresh.plain_asset("first");
    fresh.post_json("/v1/assets", &second("first")).expect(201);
    for n in (0..11).filter(|n| *n != 6) {
        fresh.upload("first", &at_speed(record("in", n), 10.0));
    }
    assert_eq!(found(&fresh, "first"), first);
    assert_eq!(found(&fresh, "second"), second_mesh);
    // Work that a killed process left undone is completed at the next start.
    service.restart();
    assert_eq!(found(&service, "second"), second_mesh);
}

#[test]
fn invalid_sensor_sharing_is_rejected_and_shared_recordings_are_kept() {
    let service = Service::start();
    service.plain_asset("first");
    service.post_json("/v1/assets", &second("nowhere")).expect_problem(422, &["sensor.of", "nowhere"]);
    service.post_json("/v1/assets", &second("second")).expect_problem(422, &["sensor.of"]);
    service.post_json("/v1/assets", &second("first")).expect(201);
    // "second" in base64
    let upload = [("tus-resumable", "1.0.0"), ("upload-length", "1"), ("upload-metadata", "asset c2Vjb25k")];
    service.send("POST", "/v1/uploads", &upload, b"").expect_problem(409, &["second", "first"]);
    let mut third = second("second");
    third["id"] = json!("third");
    service.post_json("/v1/assets", &third).expect_problem(422, &["sensor.of", "second"]);
    let mut first = plain_asset("first");
    third["sensor"] = json!({});
    third["gear"]["shaft_ratio"] = json!([0, 3]);
    service.post_json("/v1/assets", &third).expect_problem(422, &["gear.shaft_ratio"]);
    third["gear"]["shaft_ratio"] = json!([2, 3]);
    service.post_json("/v1/assets", &third).expect(201);
    first["sensor"]["of"] = json!("third");
    service
        .put_json("/v1/assets/first", &first)
        .expect_problem(422, &["sensor.of", "share the sensor of this one"]);

    let body =
        flankwatch::recording::encode_block(&record("in", 0), flankwatch::recording::BlockEncoding::Json);
    service
        .post("/v1/assets/second/segments", "application/json", &body)
        .expect_problem(409, &["second", "first"]);
    service
        .post("/v1/assets/second/segments", "application/mcap", &mcap(&[record("in", 0)]))
        .expect_problem(409, &["first"]);
    let sent = service.upload("first", &record("in", 0));
    let mut moved = second("third");
    service.put_json("/v1/assets/second", &moved).expect_problem(422, &["sensor.of", "the previous value"]);
    moved["sensor"] = json!({});
    service.put_json("/v1/assets/second", &moved).expect_problem(422, &["not given"]);

    service.delete("/v1/assets/first").expect_problem(409, &["second"]);
    let name = sent["raw"]["sha256"].as_str().unwrap();
    let raw = service.folder().join("raw").join(&name[..2]).join(name);
    service.delete("/v1/assets/second").expect(204);
    assert!(raw.is_file(), "the first mesh has it still");
    service.delete("/v1/assets/first").expect(204);
    assert!(!raw.exists());
}

/// Simulates two pairs at speeds coupled by their teeth, each with its own transmission path to one sensor.
#[test]
fn the_wear_of_both_stages_is_tracked_with_one_sensor() {
    const RECORDS: u32 = 60;
    let service = Service::start_with(|config| {
        config.grid = GridSettings { states: 60, seconds: 1.0, ..GridSettings::default() };
    });
    let pairs = pairs();
    let plan = |pair: &PairSpec, max_wear_um: f64, wear_exponent: f64| RunPlan {
        pair: pair.clone(),
        records: RECORDS,
        seconds: 3.0,
        sample_rate_hz: 20_000.0,
        max_wear_um,
        wear_exponent,
        start_time: minute(0),
        interval_s: 3600.0,
        snr_db: 30.0,
        speed_variation: 0.02,
        torque_variation: 0.0,
        // One seed for both: their shafts turn together.
        seed: 5,
        channel: "in".to_owned(),
    };
    let runs = [plan(&pairs[0], 200.0, 1.5), plan(&pairs[1], 150.0, 3.0)].map(|plan| Run::new(plan).unwrap());
    let further = TransmissionPath::random(&mut ChaCha8Rng::seed_from_u64(77), 20_000.0);
    for (id, pair, ratio) in [("input", &pairs[0], None), ("output", &pairs[1], Some([24, 26]))] {
        let mut asset = json!({
            "id": id,
            "gear": {
                "teeth": pair.geometry.teeth, "shaft_speed_hz": pair.operation.shaft_speed_hz, "pair": pair,
            },
            "limits": { "danger_um": 100.0 },
            "baseline": { "records": 16 },
        });
        if let Some(ratio) = ratio {
            asset["gear"]["shaft_ratio"] = json!(ratio);
            asset["sensor"] = json!({ "of": "input" });
        }
        service.post_json("/v1/assets", &asset).expect(201);
    }
    for id in ["input", "output"] {
        service.wait_for(&format!("/v1/assets/{id}"), |asset| asset["summary"]["library_state"] == "ready");
    }
    let records: Vec<Record> = (0..RECORDS)
        .map(|n| {
            let [one, two] = [0, 1].map(|stage: usize| runs[stage].record(n).unwrap().record);
            let other = further.apply(&two.samples().iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
            let sum = one.samples().iter().zip(other).map(|(x, y)| x + y as f32).collect();
            Record::new("in", one.start_time(), 20_000.0, "m/s2", sum)
                .and_then(|record| record.with_operating_point(one.operating_point()))
                .unwrap()
        })
        .collect();
    for batch in records.chunks(10) {
        service.post("/v1/assets/input/segments", "application/mcap", &mcap(batch)).expect(201);
    }
    for (stage, id) in ["input", "output"].into_iter().enumerate() {
        let history = service.get(&format!("/v1/assets/{id}/wear/history")).expect(200).json();
        let rows = history["items"].as_array().unwrap();
        assert_eq!(rows.len(), RECORDS as usize);
        let (mut within, mut estimated, mut last) = (0, 0, (0.0, 0.0));
        for (n, row) in (0..).zip(rows) {
            let truth = runs[stage].wear_um(n);
            let number = |name: &str| row[name].as_f64();
            let Some((median, (low, high))) =
                number("median_um").zip(number("low_um").zip(number("high_um")))
            else {
                continue;
            };
            estimated += 1;
            last = (median, truth);
            within += u32::from((low..=high).contains(&truth));
        }
        // After the baseline nearly every record has an estimate near the truth, with a correct coverage.
        assert!(estimated >= 40, "{id}: {estimated} of {RECORDS}: {history}");
        assert!(last.0 > 0.5 * last.1, "{id}: {} µm at {} µm", last.0, last.1);
        assert!(within * 10 >= estimated * 8, "{id}: {within} of {estimated}");
        let alarms = service.get(&format!("/v1/alarms?asset={id}")).expect(200).json();
        let raised = alarms["items"].as_array().unwrap().iter().find(|alarm| alarm["quantity"] == "wear_um");
        let raised =
            raised.unwrap_or_else(|| panic!("{id}: no alarm; median and truth {last:?} µm: {alarms}"));
        assert_eq!(raised["severity"], "danger", "{id}: {alarms}");
        shows_the_wear(&service, id, rows.last().unwrap());
    }
    looks_back_from_an_inspection(&service, &runs[0]);
}

/// Checks that the metrics of an asset have the median and the interval of a wear estimate.
fn shows_the_wear(service: &Service, id: &str, row: &Value) {
    let metrics = String::from_utf8(service.get("/metrics/machines").expect(200).bytes).unwrap();
    for (name, label, value) in [
        ("flankwatch_wear_depth_um", r#"quantile="0.5""#, "median_um"),
        ("flankwatch_wear_depth_interval_um", r#"bound="low""#, "low_um"),
        ("flankwatch_wear_depth_interval_um", r#"bound="high""#, "high_um"),
    ] {
        let line = format!("{name}{{asset=\"{id}\",channel=\"in\",{label}}} ");
        let shown = metrics.lines().find_map(|shown| shown.strip_prefix(&line)).map(str::parse::<f64>);
        assert_eq!(shown, row[value].as_f64().map(Ok), "{line}: {metrics}");
    }
}

/// Checks how an inspection of the first stage changes the estimates of earlier records.
fn looks_back_from_an_inspection(service: &Service, run: &Run) {
    let path = "/v1/assets/input/wear/hindsight";
    let none = service.get(path).expect(200).json();
    assert_eq!((&none["channel"], &none["items"]), (&json!("in"), &json!([])));
    let history = service.get("/v1/assets/input/wear/history").expect(200).json();
    let (at, depth_um) = (history["items"][50]["start_time"].as_str().unwrap(), run.wear_um(50));
    let inspection = json!({ "depth_um": depth_um, "error_um": 5.0 });
    let event = json!({ "kind": "inspected", "time": at, "by": "Ada", "inspection": inspection });
    service.post_json("/v1/assets/input/maintenance", &event).expect(201);
    let looked_back = service.get(path).expect(200).json();
    let items = looked_back["items"].as_array().unwrap();
    assert!(items.len() >= 30 && items.last().unwrap()["start_time"].as_str() < Some(at), "{looked_back}");
    let width = |rows: &[Value]| {
        let of = |row: &Value| row["high_um"].as_f64().unwrap() - row["low_um"].as_f64().unwrap();
        rows.iter().map(of).sum::<f64>() / rows.len() as f64
    };
    let estimated: Vec<Value> = history["items"].as_array().unwrap()[16..50]
        .iter()
        .filter(|row| row["median_um"].is_f64())
        .cloned()
        .collect();
    // With the described pair alone, there is no ensemble to weight.
    assert!(
        (width(items) / width(&estimated) - 1.0).abs() < 1e-3,
        "{} µm wide, {} as told",
        width(items),
        width(&estimated)
    );
}

/// Returns the paper's pair, and a pair driven by its output shaft.
fn pairs() -> [PairSpec; 2] {
    let first = PairSpec::from_toml(include_str!("../../fixtures/pairs/shen2022.toml")).unwrap();
    let mut second = first.clone();
    second.geometry.teeth = [19, 31];
    second.geometry.centre_distance_mm = Some(150.0);
    second.operation.shaft_speed_hz = first.operation.shaft_speed_hz * 24.0 / 26.0;
    second.operation.torque_nm = first.operation.torque_nm * 26.0 / 24.0;
    second.operation.output_torque_nm = None;
    [first, second]
}
