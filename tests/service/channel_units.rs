//! The unit of a channel: that of its description or first record, to which later records are converted.

use std::collections::BTreeSet;

use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::signal::Record;
use serde_json::{Value, json};

use crate::running::{Service, minute, plain_asset, samples};

fn upload_in(service: &Service, asset: &str, n: u32, unit: &str, scale: f32) -> crate::running::Answer {
    let scaled = samples(n).iter().map(|sample| sample * scale).collect();
    let record = Record::new("1", minute(n.into()), 4000.0, unit, scaled).unwrap();
    service.post(
        &format!("/v1/assets/{asset}/segments"),
        "application/x-protobuf",
        &encode_block(&record, BlockEncoding::Protobuf),
    )
}

#[test]
fn a_channel_keeps_its_unit() {
    let mut service = Service::start();
    for asset in ["pump", "other"] {
        let mut spec = plain_asset(asset);
        spec["sensor"] = json!({});
        service.post_json("/v1/assets", &spec).expect(201);
    }
    let rms = |segment: &Value| segment["indicators"]["rms"].as_f64().unwrap();
    let first = upload_in(&service, "pump", 1, "m/s2", 1.0).expect(201).json();
    let same = upload_in(&service, "other", 1, "mm/s2", 1000.0).expect(201).json();
    assert_eq!((&first["unit"], &same["unit"]), (&json!("m/s2"), &json!("mm/s2")));
    let in_g = upload_in(&service, "pump", 2, "g", 1.0 / 9.806_65).expect(201).json();
    let expected = upload_in(&service, "pump", 2, "m/s2", 1.0).expect(201).json();
    assert_eq!(in_g["unit"], "m/s2");
    assert!((rms(&in_g) / rms(&expected) - 1.0).abs() < 1e-6, "{in_g}");
    upload_in(&service, "pump", 3, "V", 1.0).expect_problem(422, &["unit", "V", "m/s2"]);
    upload_in(&service, "pump", 3, "m/s2\u{7}", 1.0).expect_problem(422, &["unit"]);
    // Read again from bytes that are in g, and after the next start; a WAV says no unit itself.
    let wav = crate::running::wav(&[samples(4).iter().map(|sample| sample / 9.806_65).collect()]);
    let path = "/v1/assets/pump/segments?channel=1&unit=g&start_time=2026-01-01T01:00:00Z";
    let of_wav = service.post(path, "audio/wav", &wav).expect(201).json();
    assert_eq!(of_wav["unit"], "m/s2");
    service.restart();
    for segment in [&in_g, &of_wav] {
        let path = format!("/v1/segments/{}/spectrum", segment["id"].as_str().unwrap());
        assert_eq!(service.get(&path).expect(200).json()["unit"], "m/s2");
        let path = format!("/v1/segments/{}/waveform", segment["id"].as_str().unwrap());
        let waveform = service.get(&path).expect(200).json();
        let values = waveform["value"].as_array().unwrap().iter();
        let most = values.map(|value| value.as_f64().unwrap().abs()).fold(0.0, f64::max);
        assert!((1.0..3.0).contains(&most), "{most}");
    }
}

#[test]
fn records_that_arrive_together_agree_on_the_unit_of_a_new_channel() {
    let service = Service::start();
    let scales = [("m/s2", 1.0), ("g", 1.0 / 9.806_65), ("mm/s2", 1000.0), ("V", 1.0)];
    for round in 0..8 {
        let asset = format!("pump-{round}");
        let mut spec = plain_asset(&asset);
        spec["sensor"] = json!({});
        service.post_json("/v1/assets", &spec).expect(201);
        let answers: Vec<_> = std::thread::scope(|scope| {
            let send = |(n, (unit, scale))| {
                let (service, asset) = (&service, &asset);
                scope.spawn(move || upload_in(service, asset, n, unit, scale))
            };
            let sent: Vec<_> = (0..).zip(scales).map(send).collect();
            sent.into_iter().map(|sender| sender.join().unwrap()).collect()
        });
        let stored: Vec<Value> =
            answers.iter().filter(|answer| answer.status == 201).map(crate::running::Answer::json).collect();
        let units: BTreeSet<&str> = stored.iter().map(|segment| segment["unit"].as_str().unwrap()).collect();
        assert_eq!(units.len(), 1, "{units:?}");
        // Only volts cannot be converted: either they or all others are refused.
        let expected = if units.contains("V") { 1 } else { 3 };
        assert_eq!(stored.len(), expected, "{units:?}");
        assert!(answers.iter().all(|answer| matches!(answer.status, 201 | 422)));
    }
}
