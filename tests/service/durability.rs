//! What was answered is there after a restart, and nothing else.

use serde_json::Value;

use crate::running::{Service, record};

fn everything(service: &Service) -> Vec<Value> {
    let mut all = vec![
        service.get("/v1/assets").expect(200).json(),
        service.get("/v1/assets/pump/wear").expect(200).json(),
        service.get("/v1/assets/pump/wear/history").expect(200).json(),
        service.get("/v1/assets/pump/indicators").expect(200).json(),
    ];
    let list = service.get("/v1/assets/pump/segments").expect(200).json();
    for item in list["items"].as_array().unwrap() {
        let path = format!("/v1/segments/{}", item["id"].as_str().unwrap());
        all.push(service.get(&path).expect(200).json());
        all.push(service.get(&format!("{path}/waveform")).expect(200).json());
    }
    all.push(list);
    all
}

#[test]
fn a_restart_loses_nothing_and_the_fold_goes_on() {
    let mut service = Service::start();
    service.plain_asset("pump");
    service.plain_asset("never-stopped");
    for n in 0..10 {
        service.upload("pump", &record("1", n));
        service.upload("never-stopped", &record("1", n));
    }
    let before = everything(&service);
    service.restart();
    assert_eq!(everything(&service), before);
    for n in 10..14 {
        service.upload("pump", &record("1", n));
        service.upload("never-stopped", &record("1", n));
        service.restart();
    }
    let history = |asset: &str| {
        let mut history = service.get(&format!("/v1/assets/{asset}/wear/history")).expect(200).json();
        for item in history["items"].as_array_mut().unwrap() {
            item.as_object_mut().unwrap().remove("segment_id");
        }
        history
    };
    assert_eq!(history("pump"), history("never-stopped"));
}

#[test]
fn a_damaged_raw_object_is_said_to_be_and_never_shown() {
    let service = Service::start();
    service.plain_asset("pump");
    let segment = service.upload("pump", &record("1", 1));
    let name = segment["raw"]["sha256"].as_str().unwrap();
    let path = service.folder().join("raw").join(&name[..2]).join(name);
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let id = segment["id"].as_str().unwrap();
    service
        .get(&format!("/v1/segments/{id}/waveform"))
        .expect_problem(500, &["damaged", name]);
    service.get(&format!("/v1/segments/{id}")).expect(200);
}
