//! Examples of request bodies in the API's description. A test sends each one.

use serde_json::{Value, json};

/// The path, the method, the media type and the body of each example.
pub(crate) fn all() -> Vec<(&'static str, &'static str, &'static str, Value)> {
    const JSON: &str = "application/json";
    let asset = |id: &str| {
        json!({
            "id": id,
            "name": "Press line 3, gearbox A",
            "location": { "site": "mill", "machine": "press 3", "gearbox": "A", "mesh": "first stage" },
            "gear": { "teeth": [31, 62], "shaft_speed_hz": 10.0 },
            "sensor": { "unit": "m/s2" },
            "limits": { "warning_um": 100, "danger_um": 200 },
            "alarms": [{
                "quantity": { "indicator": "rms" }, "warning": 2.0, "danger": 4.0, "hysteresis": 0.2,
                "settings": { "raise": 3, "raise_of": 5, "clear": 5, "clear_of": 5 }
            }],
            "operating_bins": [{ "name": "full load", "shaft_speed_hz": [9.5, 10.5], "torque_nm": [80, 120] }],
        })
    };
    let toml = |id: &str| {
        let text = "name = \"Press line 4\"\n\n[gear]\nteeth = [31, 62]\nshaft_speed_hz = 10.0\n\n[limits]\nwarning_um = 100\n";
        json!(format!("id = \"{id}\"\n{text}"))
    };
    // A tenth of a second of a mesh line at 310 Hz.
    let sample = |n: u32| (f64::from(n) * 310.0 / 4000.0 * std::f64::consts::TAU).sin();
    let samples: Vec<f64> = (0..400).map(|n| (sample(n) * 1000.0).round() / 1000.0).collect();
    let block = json!({
        "start_time": "2026-03-01T08:00:00Z", "sample_rate_hz": 4000, "unit": "m/s2", "channel": "a1", "samples": samples,
    });
    let remark = json!({ "by": "Ada", "comment": "seen, oil sample taken" });
    vec![
        ("/v1/assets", "post", JSON, asset("press-3")),
        ("/v1/assets", "post", "application/toml", toml("press-4")),
        ("/v1/assets/{asset}", "put", JSON, asset("gearbox-1")),
        ("/v1/assets/{asset}", "put", "application/toml", toml("gearbox-1")),
        ("/v1/assets/{asset}/segments", "post", JSON, block),
        (
            "/v1/assets/{asset}/maintenance",
            "post",
            JSON,
            json!({ "time": "2026-03-01T08:00:00Z", "kind": "gear_replaced", "by": "Ada", "comment": "new pair, same drawing" }),
        ),
        (
            "/v1/assets/{asset}/alarms/try",
            "post",
            JSON,
            json!({ "rule": { "quantity": { "indicator": "rms" }, "warning": 2.0, "danger": 4.0 } }),
        ),
        ("/v1/tokens", "post", JSON, json!({ "name": "front desk", "scope": "admin" })),
        ("/v1/alarms/{alarm}/acknowledge", "post", JSON, remark.clone()),
        ("/v1/alarms/{alarm}/comment", "post", JSON, remark.clone()),
        (
            "/v1/alarms/{alarm}/shelve",
            "post",
            JSON,
            json!({ "by": "Ada", "until": "2200-01-01T00:00:00Z", "comment": "until the stop" }),
        ),
        ("/v1/alarms/{alarm}/unshelve", "post", JSON, json!({ "by": "Ada" })),
        (
            "/v1/preview",
            "post",
            JSON,
            json!({
                "gear": {
                    "teeth": [20, 40],
                    "shaft_speed_hz": 25.0,
                    "pair": {
                        "geometry": { "teeth": [20, 40], "module_mm": 1.0, "face_width_mm": 8.0, "bore_radius_mm": [3.0, 5.0] },
                        "operation": { "torque_nm": 5.0, "shaft_speed_hz": 25.0 },
                    },
                },
                "wear_um": 20.0,
            }),
        ),
        ("/v1/replays", "post", JSON, json!({ "asset": "gearbox-1", "file": "run.mcap", "pace": "max" })),
    ]
}
