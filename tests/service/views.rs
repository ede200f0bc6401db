//! Views of records and histories: part of a waveform, orders, one revolution, cepstrum, waterfall, and the
//! match with the library.

use serde_json::{Value, json};

use flankwatch::gear::PairSpec;
use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::simulation::{Run, RunPlan};

use crate::alarms::loud;
use crate::running::{Service, minute, plain_asset};

const PAIR: &str = include_str!("../../fixtures/pairs/shen2022.toml");
const RATE_HZ: f64 = 12_800.0;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// Returns the index of the maximum.
fn highest(values: &[f64]) -> usize {
    (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap()
}

/// Creates an asset with 12 records of a run to failure, 8 of them its baseline; `pair` adds a gear pair, and
/// so a library. Returns the last record's identifier.
fn fed(service: &Service, with_library: bool) -> String {
    let pair = PairSpec::from_toml(PAIR).unwrap();
    let mut asset = json!({
        "id": "gearbox",
        "gear": { "teeth": pair.geometry.teeth, "shaft_speed_hz": pair.operation.shaft_speed_hz },
        "baseline": { "records": 8 },
    });
    if with_library {
        asset["gear"]["pair"] = serde_json::to_value(&pair).unwrap();
    }
    service.post_json("/v1/assets", &asset).expect(201);
    service.wait_for("/v1/assets/gearbox", |asset| asset["summary"]["library_state"] != "building");
    let run = Run::new(RunPlan {
        pair,
        records: 12,
        seconds: 1.0,
        sample_rate_hz: RATE_HZ,
        max_wear_um: 25.0,
        wear_exponent: 1.5,
        start_time: minute(0),
        interval_s: 60.0,
        snr_db: 20.0,
        speed_variation: 0.005,
        torque_variation: 0.0,
        seed: 3,
        channel: "x".to_owned(),
    })
    .unwrap();
    let mut last = String::new();
    for index in 0..12 {
        let body = encode_block(&run.record(index).unwrap().record, BlockEncoding::Protobuf);
        let answer =
            service.post("/v1/assets/gearbox/segments", "application/x-protobuf", &body).expect(201).json();
        last = answer["id"].as_str().unwrap().to_string();
    }
    last
}

/// The lines of the envelope are those of its spectrum, beside the baseline's in the same band.
fn lines_of_the_envelope(service: &Service, id: &str, shaft_hz: f64) {
    let envelope = service.get(&format!("/v1/segments/{id}/envelope?max_points=200000")).expect(200).json();
    let (hertz, amplitude) = (numbers(&envelope["frequency_hz"]), numbers(&envelope["amplitude"]));
    let strongest = highest(&amplitude);
    let lines = |query: &str| service.get(&format!("/v1/segments/{id}/lines?spectrum=envelope&{query}"));
    let of_asset = lines(&format!("at={}", hertz[strongest])).expect(200).json();
    assert_eq!(of_asset["items"][0]["amplitude"], amplitude[strongest]);
    assert_eq!(of_asset["band_hz"], envelope["band_hz"]);
    assert_eq!((&of_asset["baseline_records"], &of_asset["spectrum"]), (&json!(8), &json!("envelope")));
    let [low, high] = [0, 1].map(|end| envelope["band_hz"][end].as_f64().unwrap());
    let band = format!("band_low_hz={low}&band_high_hz={high}");
    let over_orders =
        lines(&format!("axis=orders&at={}&{band}", hertz[strongest] / shaft_hz)).expect(200).json();
    let (order, hz) = (&over_orders["items"][0], &of_asset["items"][0]);
    assert_eq!(order["amplitude"], hz["amplitude"]);
    let change = |line: &Value| line["change_db"].as_f64().unwrap();
    assert!((change(order) - change(hz)).abs() < 0.5, "{over_orders}, over hertz {of_asset}");
    let expected = 20.0 * (amplitude[strongest] / hz["baseline_amplitude"].as_f64().unwrap()).log10();
    assert!((change(hz) - expected).abs() < 1e-9, "{of_asset}");
    lines("at=1&band_low_hz=500").expect_problem(400, &["band_low_hz, band_high_hz"]);
    lines(&format!("at=1&band_low_hz=500&band_high_hz={RATE_HZ}"))
        .expect_problem(400, &["band_low_hz, band_high_hz"]);
    service
        .get(&format!("/v1/segments/{id}/lines?at=1&{band}"))
        .expect_problem(400, &["band_low_hz, band_high_hz"]);
}

#[test]
fn a_record_is_shown_over_time_angle_and_quefrency() {
    let service = Service::start();
    let id = fed(&service, false);
    let speed_hz =
        service.get(&format!("/v1/segments/{id}")).expect(200).json()["shaft_speed"]["shaft_speed_hz"]
            .as_f64()
            .unwrap();

    let part = service
        .get(&format!("/v1/segments/{id}/waveform?from_s=0.25&to_s=0.26&max_points=1000"))
        .expect(200)
        .json();
    let time_s = numbers(&part["time_s"]);
    assert_eq!(part["reduced"], false);
    assert!(time_s[0] <= 0.25 && *time_s.last().unwrap() >= 0.26, "{time_s:?}");
    assert_eq!(time_s.len(), (0.01 * RATE_HZ) as usize + 1);
    service
        .get(&format!("/v1/segments/{id}/waveform?from_s=2&to_s=1"))
        .expect_problem(400, &["from_s", "to_s"]);

    let velocity = service
        .get(&format!("/v1/segments/{id}/waveform?quantity=velocity&max_points=200000"))
        .expect(200)
        .json();
    let samples = numbers(&velocity["value"]);
    let rms = (samples.iter().map(|v| v * v).sum::<f64>() / samples.len() as f64).sqrt();
    let lines = service.get(&format!("/v1/segments/{id}/spectrum?max_points=200000")).expect(200).json();
    let of_lines = numbers(&lines["frequency_hz"]).into_iter().zip(numbers(&lines["amplitude"]));
    let square = |(hz, peak): (f64, f64)| (1e3 * peak / (std::f64::consts::TAU * hz)).powi(2) / 2.0 / 1.5;
    let expected = of_lines.filter(|(hz, _)| *hz >= 10.0).map(square).sum::<f64>().sqrt();
    assert!((rms / expected - 1.0).abs() < 0.1, "{rms} mm/s by samples, {expected} by lines");
    assert_eq!(velocity["unit"], "mm/s");
    service
        .get(&format!("/v1/segments/{id}/waveform?quantity=velocity&cut_hz=0"))
        .expect_problem(400, &["cut_hz"]);

    let mesh = &lines["mesh_harmonics"][0];
    let (mesh_hz, shaft_hz) =
        (mesh["frequency_hz"].as_f64().unwrap(), lines["shaft_speed_hz"].as_f64().unwrap());
    let at = format!("{mesh_hz},{},1e6", mesh_hz + shaft_hz);
    let compared = service.get(&format!("/v1/segments/{id}/lines?at={at}")).expect(200).json();
    assert_eq!((compared["baseline_records"].as_u64(), compared["unit"].as_str()), (Some(8), Some("m/s2")));
    let of = |n: usize, key: &str| compared["items"][n][key].as_f64();
    // The mesh line has its baseline value in the spectrum, from the analyser's own reading of the line.
    let known =
        20.0 * (mesh["amplitude"].as_f64().unwrap() / mesh["baseline_amplitude"].as_f64().unwrap()).log10();
    assert!((of(0, "change_db").unwrap() - known).abs() < 0.5, "{compared}, by the spectrum {known} dB");
    assert!(of(1, "change_db").is_some() && of(1, "amplitude") < of(0, "amplitude"), "{compared}");
    assert_eq!((of(2, "amplitude"), of(2, "change_db")), (None, None), "beyond the spectrum");
    let over_orders = service.get(&format!("/v1/segments/{id}/lines?axis=orders&at=24")).expect(200).json();
    let change = over_orders["items"][0]["change_db"].as_f64().unwrap();
    assert!((change - known).abs() < 1.0, "{change} dB over orders, {known} over hertz");
    service.get(&format!("/v1/segments/{id}/lines?at=1,two")).expect_problem(400, &["at"]);
    lines_of_the_envelope(&service, &id, shaft_hz);

    let orders =
        service.get(&format!("/v1/segments/{id}/orders?from_order=10&to_order=30")).expect(200).json();
    let (order, amplitude) = (numbers(&orders["order"]), numbers(&orders["amplitude"]));
    let around_mesh: Vec<f64> = order
        .iter()
        .zip(&amplitude)
        .map(|(order, a)| if (order - 24.0).abs() < 3.0 { *a } else { 0.0 })
        .collect();
    assert!((order[highest(&around_mesh)] - 24.0).abs() < 0.1, "the mesh line is order 24");
    assert!(order[0] >= 10.0 && order.last().unwrap() <= &30.0 && orders["unit"] == "m/s2");
    assert_eq!(orders["mesh_amplitudes"][0], amplitude[highest(&around_mesh)]);

    let turn = service.get(&format!("/v1/segments/{id}/turn")).expect(200).json();
    let turns = turn["turns"].as_f64().unwrap();
    // Whole turns; where the phase is followed from the mesh, a turn at either end is left out.
    assert!((speed_hz - 3.0..=speed_hz).contains(&turns), "{turns} turns in a second at {speed_hz} Hz");
    assert_eq!(numbers(&turn["angle_deg"]).len(), numbers(&turn["average"]).len());

    assert_eq!(turn["gear"], 1);

    // The driven gear makes 24 revolutions for 26 of the driving gear, and both show the mesh harmonics.
    let driven = service.get(&format!("/v1/segments/{id}/turn?gear=2")).expect(200).json();
    assert_eq!(driven["gear"], 2);
    let expected = turns * 24.0 / 26.0;
    let driven_turns = driven["turns"].as_f64().unwrap();
    assert!((driven_turns - expected).abs() <= 1.0, "{driven_turns} turns, {expected} by the teeth");
    let of_mesh = |turn: &Value, teeth: usize| {
        let average = numbers(&turn["average"]);
        let at = |n: usize| std::f64::consts::TAU * (n * teeth) as f64 / average.len() as f64;
        let part = |wave: fn(f64) -> f64| {
            average.iter().enumerate().map(|(n, x)| x * wave(at(n))).sum::<f64>() / average.len() as f64
        };
        2.0 * part(f64::cos).hypot(part(f64::sin))
    };
    let (by_driving, by_driven) = (of_mesh(&turn, 24), of_mesh(&driven, 26));
    assert!((by_driven / by_driving - 1.0).abs() < 0.05, "{by_driven} {by_driving}");
    service.get(&format!("/v1/segments/{id}/turn?gear=3")).expect_problem(400, &["gear", "driven"]);

    let cepstrum =
        service.get(&format!("/v1/segments/{id}/cepstrum?max_s=0.1&max_points=500")).expect(200).json();
    let quefrency_s = numbers(&cepstrum["quefrency_s"]);
    assert!(quefrency_s.len() <= 500 && quefrency_s[0] > 0.0 && *quefrency_s.last().unwrap() <= 0.1 + 1e-9);
    for (query, field) in [("orders?to_order=0", "to_order"), ("cepstrum?max_s=-1", "max_s")] {
        service.get(&format!("/v1/segments/{id}/{query}")).expect_problem(400, &[field]);
    }
    service.get(&format!("/v1/segments/{id}/match")).expect_problem(404, &["cannot be matched"]);
}

#[test]
fn a_waterfall_has_the_mesh_line_in_one_column() {
    let service = Service::start();
    service.plain_asset("idle");
    assert_eq!(service.get("/v1/assets/idle/waterfall").expect(200).json()["items"], json!([]));
    fed(&service, false);
    let path = "/v1/assets/gearbox/waterfall?axis=orders&cells=300&max=30&max_records=5";
    let waterfall = service.get(path).expect(200).json();
    let items = waterfall["items"].as_array().unwrap();
    assert_eq!((items.len(), &waterfall["reduced"]), (5, &json!(true)));
    let position = numbers(&waterfall["position"]);
    for item in items {
        let levels = numbers(&item["level_db"]);
        let near: Vec<f64> =
            (0..300).map(|n| if (position[n] - 24.0).abs() < 2.0 { levels[n] } else { -300.0 }).collect();
        assert!((position[highest(&near)] - 24.0).abs() < 0.16, "{}", position[highest(&near)]);
    }
    assert_eq!(service.get(path).expect(200).json(), waterfall, "a look again is the same");
    service.get("/v1/assets/gearbox/waterfall?max_records=601").expect_problem(400, &["max_records", "600"]);
}

#[test]
fn a_waterfall_over_orders_follows_a_changed_shaft_speed() {
    let service = Service::start();
    let mut spec = plain_asset("pump");
    service.post_json("/v1/assets", &spec).expect(201);
    service.upload("pump", &loud(0, 1.0));
    let path = "/v1/assets/pump/waterfall?axis=orders&cells=100&max=100";
    let mesh_order = || {
        let waterfall = service.get(path).expect(200).json();
        numbers(&waterfall["position"])[highest(&numbers(&waterfall["items"][0]["level_db"]))]
    };
    assert!((mesh_order() - 31.0).abs() < 1.0, "{}", mesh_order());
    // The same mesh frequency with other teeth.
    spec["gear"] = json!({ "teeth": [20, 40], "shaft_speed_hz": 15.5 });
    service.put_json("/v1/assets/pump", &spec).expect(200);
    service.wait_for("/v1/assets/pump/segments", |list| {
        let speed_hz = list["items"][0]["shaft_speed"]["shaft_speed_hz"].as_f64();
        speed_hz.is_some_and(|speed_hz| (speed_hz - 15.5).abs() < 0.1)
    });
    assert!((mesh_order() - 20.0).abs() < 1.0, "{}", mesh_order());
}

#[test]
fn a_report_is_one_page_without_scripts() {
    let service = Service::start();
    service.plain_asset("idle");
    assert!(
        String::from_utf8_lossy(&service.get("/v1/assets/idle/report").expect(200).bytes)
            .contains("0 records")
    );
    fed(&service, false);
    let answer = service.get("/v1/assets/gearbox/report").expect(200);
    assert_eq!(answer.header("content-type"), "text/html; charset=utf-8");
    let html = String::from_utf8_lossy(&answer.bytes);
    assert!(
        html.contains("12 records") && html.matches("<svg class=\"narrow\" viewBox=\"0 0 360").count() >= 4,
        "{html}"
    );
    assert!(!html.contains("<script"));
}

#[test]
fn a_report_has_the_senders_comment_and_the_selected_parts() {
    let service = Service::start();
    fed(&service, false);
    let page = |query: &str| {
        let answer = service.get(&format!("/v1/assets/gearbox/report{query}")).expect(200);
        String::from_utf8(answer.bytes).unwrap()
    };
    let all = page("");
    for heading in ["RMS", "Kurtosis", "Spectrum", "Records"] {
        assert!(all.contains(&format!("<h2>{heading}</h2>")), "{heading}");
    }
    assert!(!all.contains("<h2>Recommendation</h2>") && !all.contains("class=\"signature\""));
    let chosen = page(
        "?prepared_for=Mill%203&prepared_by=A.%20Engineer&recommendation=Change%20the%20oil.%0D%0A%0D%0A%3Cb%3E\
         &indicators=kurtosis&spectrum=false&records=false&events=false&wear=true",
    );
    for words in [
        "<p>Prepared for Mill 3.</p>",
        "<h2>Recommendation</h2><p>Change the oil.</p><p>&lt;b&gt;</p>",
        "</span>A. Engineer</p>",
        "<h2>Kurtosis</h2>",
        "name=\"indicators\" value=\"kurtosis\"",
    ] {
        assert!(chosen.contains(words), "{words}");
    }
    for heading in ["RMS", "Spectrum", "Records"] {
        assert!(!chosen.contains(&format!("<h2>{heading}</h2>")), "{heading}");
    }
    let report = "/v1/assets/gearbox/report";
    service.get(&format!("{report}?indicators=rsm")).expect_problem(400, &["indicators", "rsm", "kurtosis"]);
    service.get(&format!("{report}?spectrum=perhaps")).expect_problem(400, &["spectrum"]);
    let long = "a".repeat(4001);
    service
        .get(&format!("{report}?recommendation={long}"))
        .expect_problem(400, &["recommendation", "4001 characters long"]);
}

/// The number of baseline records of a record, and its mesh line relative to the baseline: by `lines` and by
/// `spectrum`.
fn mesh_to_baseline(service: &Service, id: &str) -> (u64, [f64; 2]) {
    let lines = service.get(&format!("/v1/segments/{id}/lines?at=310")).expect(200).json();
    let spectrum = service.get(&format!("/v1/segments/{id}/spectrum")).expect(200).json();
    let ratio =
        |line: &Value| line["amplitude"].as_f64().unwrap() / line["baseline_amplitude"].as_f64().unwrap();
    let ratios = [&lines["items"][0], &spectrum["mesh_harmonics"][0]].map(ratio);
    (lines["baseline_records"].as_u64().unwrap(), ratios)
}

#[test]
fn a_record_is_compared_with_the_records_collected_for_the_baseline() {
    let service = Service::start();
    service.plain_asset("pump");
    let factor = |n| if n == 2 || n >= 9 { 4.0 } else { 1.0 };
    let records: Vec<Value> = (0..12).map(|n| service.upload("pump", &loud(n, factor(n)))).collect();
    let id = |n: usize| records[n]["id"].as_str().unwrap();
    service.post(&format!("/v1/segments/{}/exclude", id(2)), "application/json", b"").expect(200);
    service.wait_for("/v1/assets/pump/wear/history", |history| {
        history["items"][8]["status"] == "collecting_baseline"
    });
    let (records, ratios) = mesh_to_baseline(&service, id(11));
    assert_eq!(records, 8);
    assert!(ratios.iter().all(|ratio| (ratio - 4.0).abs() < 1e-3), "{ratios:?}");
}

#[test]
fn a_chosen_baseline_has_all_chosen_records_and_no_others() {
    let service = Service::start();
    // Fewer and more records are chosen than the baseline would have.
    for (asset, need) in [("few", 20), ("many", 8)] {
        let mut spec = plain_asset(asset);
        spec["baseline"]["records"] = json!(need);
        service.post_json("/v1/assets", &spec).expect(201);
        let factor = |n| if n < 10 { 1.0 } else { 4.0 };
        let records: Vec<Value> = (0..24).map(|n| service.upload(asset, &loud(n, factor(n)))).collect();
        let event = json!({ "kind": "baseline_chosen", "time": minute(0), "until": minute(10), "by": "Ada" });
        service.post_json(&format!("/v1/assets/{asset}/maintenance"), &event).expect(201);
        service.wait_for(&format!("/v1/assets/{asset}/wear/history"), |history| {
            let items = history["items"].as_array().unwrap();
            let baseline = items.iter().filter(|item| item["status"] == "collecting_baseline");
            baseline.count() == 10 && items[9]["reason"].as_str().unwrap().contains("the chosen baseline")
        });
        let (records, ratios) = mesh_to_baseline(&service, records[23]["id"].as_str().unwrap());
        assert_eq!(records, 10, "{asset}");
        assert!(ratios.iter().all(|ratio| (ratio - 4.0).abs() < 1e-3), "{asset}: {ratios:?}");
    }
}

#[test]
fn a_match_has_the_same_features_as_the_library() {
    let service = Service::start();
    let id = fed(&service, true);
    let found =
        service.wait_for(&format!("/v1/segments/{id}"), |segment| segment["wear"]["library_id"].is_string());
    let library = found["wear"]["library_id"].as_str().unwrap();
    let matched = service.get(&format!("/v1/segments/{id}/match")).expect(200).json();
    assert_eq!((&matched["library_id"], matched["baseline_records"].as_u64()), (&json!(library), Some(8)));
    let features = matched["features"].as_array().unwrap();
    let mesh = features.iter().find(|row| row["name"] == "ln_mesh_1").unwrap();
    // The library's change from its own states at the depth nearest to the median.
    let states = service.get(&format!("/v1/libraries/{library}/states")).expect(200).json();
    let rows = states["items"].as_array().unwrap();
    let wear_um = matched["wear_um"].as_f64().unwrap();
    let nearest = rows
        .iter()
        .min_by(|a, b| {
            let distance = |row: &Value| (row["wear_um"].as_f64().unwrap() - wear_um).abs();
            distance(a).total_cmp(&distance(b))
        })
        .unwrap();
    let expected_db =
        20.0 * (nearest["mesh_1"].as_f64().unwrap() / rows[0]["mesh_1"].as_f64().unwrap()).log10();
    assert!((mesh["expected_db"].as_f64().unwrap() - expected_db).abs() < 1.0, "{mesh} {expected_db}");
    assert!(rows[0]["stiffness_mean_n_per_m"].as_f64() > nearest["stiffness_mean_n_per_m"].as_f64());

    let flank = service.get(&format!("/v1/libraries/{library}/flank?wear_um=100")).expect(200).json();
    for gear in flank["gears"].as_array().unwrap() {
        let depth_um = numbers(&gear["depth_um"]);
        assert!((depth_um[highest(&depth_um)] - 100.0).abs() < 1e-6);
    }
    service
        .get(&format!("/v1/libraries/{library}/flank?wear_um=9999"))
        .expect_problem(400, &["wear_um", "9999"]);
}
