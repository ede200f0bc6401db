//! Which parts of live streams become records: those of a steady machine.

use serde_json::{Value, json};

use crate::running::{Service, plain_asset};
use crate::stream_socket::StreamSocket;

const RATE_HZ: u64 = 1000;
/// 2026-01-01 in nanoseconds.
const BEGIN_NS: i64 = 1_767_225_600_000_000_000;

/// Noise that is the same whenever it is asked for, `factor` times as loud from an index on.
fn frames(first: u64, count: u64, loud_from: u64) -> Vec<u8> {
    let value = |k: u64| {
        let noise = (k.wrapping_mul(2_654_435_761) >> 7) % 2001;
        let factor = if k >= loud_from { 20.0 } else { 1.0 };
        (noise as f32 / 1000.0 - 1.0) * factor
    };
    (first..first + count).map(value).flat_map(f32::to_le_bytes).collect()
}

fn service(stream: &Value, more: &Value) -> Service {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["stream"] = stream.clone();
    for (name, value) in more.as_object().unwrap() {
        asset[name] = value.clone();
    }
    service.post_json("/v1/assets", &asset).expect(201);
    service
}

fn open(service: &Service) -> StreamSocket {
    let path = format!("/v1/assets/pump/stream?sample=f32&sample_rate_hz={RATE_HZ}&first_index=0");
    StreamSocket::open(&service.url(&path), &[]).unwrap()
}

fn send(socket: &mut StreamSocket, first: u64, until: u64, loud_from: u64) {
    let time_ns = BEGIN_NS + (first * 1_000_000_000 / RATE_HZ) as i64;
    socket.send(first, time_ns, &frames(first, until - first, loud_from));
    socket.wait_for(until);
}

/// First samples and lengths of the records, once there are so many and none waits.
fn records(service: &Service, number: usize) -> Vec<(u64, u64)> {
    service.wait_for("/v1/assets/pump/stream", |status| {
        status["records_waiting"] == 0 && status["records"].as_u64() >= Some(number as u64)
    });
    let page = service.get("/v1/assets/pump/segments?limit=1000").expect(200).json();
    let items = page["items"].as_array().unwrap().iter();
    let mut found: Vec<(u64, u64)> = items
        .map(|item| {
            let time: jiff::Timestamp = item["start_time"].as_str().unwrap().parse().unwrap();
            let seconds = (time.as_nanosecond() - i128::from(BEGIN_NS)) as f64 / 1e9;
            let first = (seconds * RATE_HZ as f64).round() as u64;
            let samples = item["samples"].as_u64().unwrap();
            let raw = service.get(&format!("/v1/segments/{}/raw", item["id"].as_str().unwrap()));
            assert_eq!(raw.expect(200).bytes.len() as u64, samples * 4);
            (first, samples)
        })
        .collect();
    found.sort_unstable();
    found
}

#[test]
fn records_are_cut_of_a_machine_that_is_steady_once_for_each_bin_and_are_the_same_after_a_restart() {
    let stream = json!({ "record_s": 2, "steady": { "for_s": 5, "at_most_every_s": 100 } });
    let bins = json!([{ "name": "slow", "shaft_speed_hz": [5, 15] }, { "name": "fast", "shaft_speed_hz": [15, 30] }]);
    let mut service = service(&stream, &json!({ "operating_bins": bins }));
    let mut socket = open(&service);
    send(&mut socket, 0, 20_000, u64::MAX);
    let say = |socket: &mut StreamSocket, speed_hz: f64| {
        socket.say(&json!({ "type": "operating", "shaft_speed_hz": speed_hz, "torque_nm": 80 }));
    };
    say(&mut socket, 10.0);
    send(&mut socket, 20_000, 24_000, u64::MAX);
    service.restart();
    let mut socket = open(&service);
    assert_eq!(socket.next, Some(24_000));
    // Within the bounds, and then for long.
    say(&mut socket, 10.1);
    send(&mut socket, 24_000, 40_000, u64::MAX);
    assert_eq!(records(&service, 1), [(23_000, 2000)]);
    say(&mut socket, 20.0);
    send(&mut socket, 40_000, 44_000, u64::MAX);
    say(&mut socket, 22.0);
    send(&mut socket, 44_000, 60_000, u64::MAX);
    let both = [(23_000, 2000), (47_000, 2000)];
    assert_eq!(records(&service, 2), both);
    service.restart();
    assert_eq!(records(&service, 2), both);
    let page = service.get("/v1/assets/pump/segments").expect(200).json();
    let speeds: Vec<f64> = page["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|item| item["operating_point"]["shaft_speed_hz"].as_f64().unwrap())
        .collect();
    assert!(speeds.contains(&10.1) && speeds.contains(&22.0), "{speeds:?}");
    service
        .put_json("/v1/assets/pump", &{
            let mut asset = plain_asset("pump");
            asset["stream"] = json!({ "steady": { "speed_fraction": 2 } });
            asset
        })
        .expect_problem(422, &["stream.steady.speed_fraction", "0 to 0.5"]);
}
