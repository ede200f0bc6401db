//! Previews of a gear pair, before the asset exists.

use std::time::Instant;

use flankwatch::gear::{FlankWear, MeshCycle, PairSpec};
use serde_json::{Value, json};

use crate::running::Service;

/// Far above the 100 ms target of a slider step, for busy machines.
const MAX_MS: u128 = 2000;

fn pair() -> PairSpec {
    PairSpec::from_toml(include_str!("../../fixtures/pairs/steel-module-1.toml")).unwrap()
}

fn mesh(pair: &PairSpec) -> Value {
    json!({ "teeth": pair.geometry.teeth, "shaft_speed_hz": pair.operation.shaft_speed_hz, "pair": pair })
}

#[test]
fn a_preview_matches_the_model_and_is_fast() {
    let service = Service::start();
    let mut pair = pair();
    pair.operation.torque_nm = 4.0;
    let mut worst = 0;
    let mut answer = Value::Null;
    for wear_um in [0.0, 5.0, 10.0, 20.0, 30.0] {
        let began = Instant::now();
        let request = json!({ "gear": mesh(&pair), "wear_um": wear_um, "torque_nm": 5.0 });
        answer = service.post_json("/v1/preview", &request).expect(200).json();
        let elapsed = began.elapsed().as_millis();
        println!("{wear_um} µm: {elapsed} ms");
        worst = worst.max(if wear_um == 0.0 { 0 } else { elapsed });
    }
    assert!(worst < MAX_MS, "{worst} ms");
    assert_eq!(answer["refusals"], json!([]));
    assert_eq!(answer["model"]["mesh_hz"], 500.0);

    pair.operation.torque_nm = 5.0;
    let resolved = pair.resolve().unwrap();
    let wear = FlankWear::from_shape(&resolved, 30e-3).unwrap();
    let mean = |state: &Value| {
        let values: Vec<f64> =
            state["stiffness_n_per_m"].as_array().unwrap().iter().filter_map(Value::as_f64).collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    for (state, wear) in [("unworn", FlankWear::none()), ("worn", wear)] {
        let cycle = MeshCycle::compute(&resolved, &wear, 200).unwrap();
        let ratio = mean(&answer["model"][state]) / cycle.mean_stiffness_n_per_m();
        assert!((ratio - 1.0).abs() < 0.01, "{state}: {ratio}");
    }
    let depths: Vec<f64> = answer["model"]["flanks"][1]["depth_um"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(Value::as_f64)
        .collect();
    assert!((depths.iter().copied().fold(0.0, f64::max) - 30.0).abs() < 1e-3);
    let harmonics = answer["model"]["harmonics"].as_array().unwrap();
    assert_eq!(harmonics.len(), 10);
    assert!(harmonics.iter().any(|line| line["change_db"].as_f64().unwrap().abs() > 1.0), "{harmonics:?}");
}

#[test]
fn an_impossible_pair_is_rejected_with_all_its_faults() {
    let service = Service::start();
    let mut pair = pair();
    pair.geometry.teeth = [11, 40];
    pair.geometry.bore_radius_mm = Some([4.5, 5.0]);
    let mut gear = mesh(&pair);
    gear["shaft_speed_hz"] = json!(0.0);
    let answer = service.post_json("/v1/preview", &json!({ "gear": gear })).expect(200).json();
    let fields: Vec<&str> = answer["refusals"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|refusal| refusal["field"].as_str())
        .collect();
    for field in ["gear.shaft_speed_hz", "gear.pair.geometry.bore_radius_mm", "gear.pair.geometry.addendum"] {
        assert!(fields.contains(&field), "{field} in {fields:?}");
    }
    assert!(answer["model"].is_null());
    assert_eq!(answer["geometry"]["gears"][0]["teeth"], 11);
    let measures = answer["geometry"]["measures"].as_array().unwrap();
    let bad = |quantity: &str| {
        measures.iter().any(|measure| measure["quantity"] == quantity && measure["verdict"] == "impossible")
    };
    assert!(bad("undercut_margin") && bad("root_to_bore"), "{measures:?}");
    // The same pair is refused as an asset, for one of them.
    let refused = service.post_json("/v1/assets", &json!({ "id": "a", "gear": mesh(&pair) }));
    let problem = refused.expect_problem(422, &["expected"]);
    assert!(fields.contains(&problem["field"].as_str().unwrap()), "{problem}");
}

#[test]
fn wear_and_torque_out_of_range_are_rejected_by_field() {
    let service = Service::start();
    for (field, request) in [
        ("wear_um", json!({ "gear": mesh(&pair()), "wear_um": 1e6 })),
        ("torque_nm", json!({ "gear": mesh(&pair()), "torque_nm": 1e6 })),
        ("shaft_speed_hz", json!({ "gear": mesh(&pair()), "shaft_speed_hz": -1.0 })),
        ("gear.pair.geometry.teeth", {
            let mut gear = mesh(&pair());
            gear["teeth"] = json!([20, 41]);
            json!({ "gear": gear })
        }),
    ] {
        let answer = service.post_json("/v1/preview", &request).expect(200).json();
        assert_eq!(answer["refusals"][0]["field"], field, "{}", answer["refusals"]);
        assert!(answer["model"].is_null() && answer["geometry"].is_object());
    }
    service.post_json("/v1/preview", &json!({ "wear_um": 1.0 })).expect_problem(422, &["gear"]);
}

#[test]
fn presets_can_be_previewed_and_wear_after_archard_too() {
    let service = Service::start();
    let presets = service.get("/v1/pair-presets").expect(200).json();
    let items = presets["items"].as_array().unwrap();
    assert!(items.len() >= 3);
    for item in items {
        let mut pair: PairSpec = serde_json::from_value(item["pair"].clone()).unwrap();
        let wear_um = 0.5 * pair.usual_wear_um();
        let began = Instant::now();
        let preview = |pair: &PairSpec| {
            service
                .post_json("/v1/preview", &json!({ "gear": mesh(pair), "wear_um": wear_um }))
                .expect(200)
                .json()
        };
        assert!(preview(&pair)["model"].is_object(), "{}", item["name"]);
        println!("{}: first answer after {} ms", item["name"], began.elapsed().as_millis());
        if item["name"] == "steel-module-1" {
            pair.wear.shape = flankwatch::gear::WearShape::Archard;
            let began = Instant::now();
            let answer = preview(&pair);
            println!("after Archard: first answer after {} ms", began.elapsed().as_millis());
            assert!(answer["model"].is_object(), "{answer}");
        }
    }
}
