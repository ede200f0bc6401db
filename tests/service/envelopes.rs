//! Envelope spectra: the band is given, around a mesh harmonic, or found by the kurtogram, and the response
//! says which.

use flankwatch::signal::Record;
use serde_json::{Value, json};

use crate::command::flankwatch;
use crate::running::{Service, minute, plain_asset};

/// Returns two seconds of a 1200 Hz resonance excited 23 times a second, with a mesh and noise that mask all
/// but the resonance.
fn struck() -> Record {
    let mut state = 7u32;
    let samples = (0..8000).map(|k| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
        let t = f64::from(k) / 4000.0;
        let since = t % (1.0 / 23.0);
        let ringing = (-since / 4e-3).exp() * (std::f64::consts::TAU * 1200.0 * since).sin();
        ((std::f64::consts::TAU * 310.0 * t).sin() + 2.0 * ringing + 1.5 * noise) as f32
    });
    Record::new("1", minute(1), 4000.0, "m/s2", samples.collect()).unwrap()
}

fn is_the_resonance(band: &Value) -> bool {
    let [low, high] = [0, 1].map(|end| band["band_hz"][end].as_f64().unwrap());
    low < 1200.0 && 1200.0 < high && high - low < 1100.0 && band["spectral_kurtosis"].as_f64().unwrap() > 0.5
}

#[test]
fn the_band_is_from_the_asset_or_the_query() {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["envelope_band"] = json!("kurtogram");
    assert_eq!(service.post_json("/v1/assets", &asset).expect(201).json()["envelope_band"], "kurtogram");
    let id = service.upload("pump", &struck())["id"].as_str().unwrap().to_owned();
    let envelope = |query: &str| service.get(&format!("/v1/segments/{id}/envelope{query}"));
    for query in ["", "?band=kurtogram"] {
        let found = envelope(query).expect(200).json();
        assert_eq!(found["band_source"], "kurtogram");
        assert!(is_the_resonance(&found), "{}", found["band_hz"]);
    }
    let by_mesh = envelope("?band=mesh_harmonic").expect(200).json();
    assert_eq!(
        (&by_mesh["band_source"], &by_mesh["spectral_kurtosis"]),
        (&json!("strongest_mesh_harmonic"), &Value::Null)
    );
    let given = envelope("?band_low_hz=1000&band_high_hz=1400").expect(200).json();
    assert_eq!((&given["band_source"], &given["band_hz"]), (&json!("query"), &json!([1000.0, 1400.0])));
    envelope("?band=kurtogram&band_low_hz=1000").expect_problem(400, &["band", "no value together"]);

    asset["envelope_band_hz"] = json!([900.0, 1500.0]);
    service.put_json("/v1/assets/pump", &asset).expect_problem(422, &["envelope_band"]);
    asset.as_object_mut().unwrap().remove("envelope_band");
    service.put_json("/v1/assets/pump", &asset).expect(200);
    assert_eq!(envelope("").expect(200).json()["band_source"], "asset");
}

#[test]
fn the_command_line_prints_the_envelope_of_the_requested_band() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(at("struck.wav"), crate::running::wav(&[struck().samples().to_vec()])).unwrap();
    let analyze = |band: &str| -> Value {
        let words = [
            "analyze",
            &at("struck.wav"),
            "--format",
            "json",
            "--envelope",
            band,
            "--report",
            &at("report.html"),
        ];
        let records: Value = serde_json::from_str(&flankwatch(&words).expect_success().out()).unwrap();
        records[0]["envelope"].clone()
    };
    let found = analyze("kurtogram");
    assert!(found["band_source"] == "kurtogram" && is_the_resonance(&found), "{found}");
    let line = found["lines"][0]["frequency_hz"].as_f64().unwrap();
    assert!((line - 23.0).abs() < 1.0, "{found}");
    let given = analyze("1000,1400");
    assert_eq!((&given["band_source"], &given["band_hz"]), (&json!("query"), &json!([1000.0, 1400.0])));
    assert_eq!(analyze("mesh")["band_source"], "whole", "no speed is known");
    assert!(analyze("1000,9000")["absent"].as_str().unwrap().contains("half the sampling rate"));
    flankwatch(&["analyze", &at("struck.wav"), "--envelope", "loud"])
        .expect_failure(&["--envelope", "kurtogram"]);
}
