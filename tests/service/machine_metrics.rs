//! The metrics of machines follow every change of a channel's latest record.

use serde_json::json;

use crate::running::{Service, record};

/// Returns asset, channel and value of one metric's lines that contain a text.
fn shown(service: &Service, name: &str, part: &str) -> Vec<(String, String, f64)> {
    let page = String::from_utf8(service.get("/metrics/machines").expect(200).bytes).unwrap();
    let lines = page.lines().filter(|line| line.starts_with(&format!("{name}{{")) && line.contains(part));
    let label = |line: &str, name: &str| {
        let (_, rest) = line.split_once(&format!("{name}=\"")).unwrap();
        rest.split('"').next().unwrap().to_owned()
    };
    let value = |line: &str| line.rsplit(' ').next().unwrap().parse().unwrap();
    lines.map(|line| (label(line, "asset"), label(line, "channel"), value(line))).collect()
}

/// Returns what is shown of an asset by its own pages.
fn by_segment(service: &Service, asset: &str, channel: &str) -> (String, String, f64) {
    let latest = service.get(&format!("/v1/assets/{asset}/segments?channel={channel}&order=desc&limit=1"));
    let value = latest.expect(200).json()["items"][0]["indicators"]["rms"].as_f64().unwrap();
    (asset.to_owned(), channel.to_owned(), value)
}

#[test]
fn metrics_show_the_latest_record_of_each_channel() {
    let mut service = Service::start();
    assert_eq!(shown(&service, "flankwatch_indicator", ""), []);
    for (asset, channel, n) in [("pump", "b", 1), ("fan", "a", 2), ("pump", "a", 3)] {
        if channel != "a" || asset != "pump" {
            service.plain_asset(asset);
        }
        service.upload(asset, &record(channel, n));
    }
    let rms = |service: &Service| shown(service, "flankwatch_indicator", "indicator=\"rms\"");
    let all = |service: &Service| {
        [("fan", "a"), ("pump", "a"), ("pump", "b")].map(|(asset, name)| by_segment(service, asset, name))
    };
    assert_eq!(rms(&service), all(&service));
    let times = shown(&service, "flankwatch_last_record_timestamp_seconds", "");
    assert_eq!(times[0], ("fan".to_owned(), "a".to_owned(), 1_767_225_720.0));

    // A later record, and an earlier one.
    service.upload("pump", &record("b", 5));
    service.upload("fan", &record("a", 0));
    assert_eq!(rms(&service), all(&service));
    let times = shown(&service, "flankwatch_last_record_timestamp_seconds", "");
    assert_eq!([times[0].2, times[2].2], [1_767_225_720.0, 1_767_225_900.0]);

    // The latest record goes, and a new band changes the analyses of the others.
    let latest = service.get("/v1/assets/pump/segments?channel=b&order=desc&limit=1").expect(200).json();
    service.delete(&format!("/v1/segments/{}", latest["items"][0]["id"].as_str().unwrap())).expect(204);
    assert_eq!(rms(&service), all(&service));
    assert_eq!(shown(&service, "flankwatch_last_record_timestamp_seconds", "pump")[1].2, 1_767_225_660.0);
    let mut fan = service.get("/v1/assets/fan").expect(200).json();
    fan["bands"] = json!([{ "name": "low", "band_hz": [10, 100] }]);
    for computed in ["summary", "created_at", "updated_at", "revision"] {
        fan.as_object_mut().unwrap().remove(computed);
    }
    service.put_json("/v1/assets/fan", &fan).expect(200);
    service.wait_for("/v1/assets/fan/segments?limit=1", |list| {
        !list["items"][0]["indicators"]["band_low"].is_null()
    });
    let band = shown(&service, "flankwatch_indicator", "band_low");
    assert_eq!(band.len(), 1, "{band:?}");

    service.delete("/v1/assets/fan").expect(204);
    assert_eq!(rms(&service), all_but_fan(&service));
    service.restart();
    assert_eq!(rms(&service), all_but_fan(&service));
}

#[test]
fn an_unknown_indicator_is_refused() {
    let service = Service::start();
    let machines = |indicators: &str| service.get(&format!("/metrics/machines?indicators={indicators}"));
    machines("rmss").expect_problem(400, &["indicators", "rmss", "rms"]);
    machines("rms,band_low").expect_problem(400, &["band_low"]);
    let asset = json!({ "id": "fan", "shaft": {}, "bands": [{ "name": "low", "band_hz": [10, 100] }] });
    service.post_json("/v1/assets", &asset).expect(201);
    for known in ["rms,band_low", "fm4", ""] {
        machines(known).expect(200);
    }
}

fn all_but_fan(service: &Service) -> [(String, String, f64); 2] {
    ["a", "b"].map(|channel| by_segment(service, "pump", channel))
}
