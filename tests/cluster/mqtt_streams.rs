//! Streams over MQTT: every acknowledged sample is stored once, by its index.

use flankwatch::recording::{BlockEncoding, RecordDefaults, decode_block, encode_block};
use flankwatch::signal::{OperatingPoint, Record, Tachometer};
use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};

use crate::broker::{Broker, LONGEST, Listener, Sender, unique};
use crate::mqtt::feed;
use crate::running::{Service, plain_asset};
use crate::stream_socket::StreamSocket;

const RATE_HZ: u64 = 1000;
const BLOCK: u64 = 100;

/// Starts a service, on the shared database if there is one; all samples become records of 2 s.
fn service() -> Service {
    let service = Service::start();
    let mut asset = plain_asset("pump");
    asset["stream"] = json!({ "record_s": 2.0, "interval_s": 2.0 });
    service.post_json("/v1/assets", &asset).expect(201);
    service
}

fn value(index: u64) -> f32 {
    (index.wrapping_mul(2_654_435_761) % 10_007) as f32 / 100.0
}

fn time_of(index: u64) -> Timestamp {
    let start: Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
    start + SignedDuration::from_millis((index * 1000 / RATE_HZ) as i64)
}

/// The block from an index on, with another time or rate where the test wants one.
fn block(first: u64, at: Timestamp, rate_hz: f64) -> Vec<u8> {
    let samples = (first..first + BLOCK).map(value).collect();
    let point = OperatingPoint { shaft_speed_hz: Some(12.5), ..OperatingPoint::default() };
    let record = Record::new("1", at, rate_hz, "m/s2", samples).unwrap();
    encode(first, &record.with_operating_point(point).unwrap())
}

/// A record as the block from an index on.
fn encode(first: u64, record: &Record) -> Vec<u8> {
    // Field 3, the index, as a varint.
    let mut bytes = [encode_block(record, BlockEncoding::Protobuf), vec![3 << 3]].concat();
    let mut rest = first;
    while rest >= 0x80 {
        bytes.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    bytes.push(rest as u8);
    bytes
}

fn json_block(first: u64) -> Vec<u8> {
    let samples: Vec<f32> = (first..first + BLOCK).map(value).collect();
    let block = json!({
        "start_time": time_of(first).to_string(), "sample_rate_hz": RATE_HZ, "unit": "m/s2",
        "first_sample_index": first, "samples": samples, "operating_point": { "shaft_speed_hz": 12.5 },
    });
    block.to_string().into_bytes()
}

#[test]
#[ignore = "needs mosquitto"]
fn blocks_become_a_stream_and_its_records() {
    let broker = Broker::start();
    let port = broker.port;
    let service = service();
    let (root, client) = (unique("stream"), unique("service"));
    let settings = format!("client_id = \"{client}\"");
    let first_feed = feed(&service, port, &root, &settings);
    let topic = format!("{root}/pump/in/samples");
    let mut sender = Sender::connect(port);
    // 33 is lost; 10 and 11 are swapped, as are 24 and 25; some are sent twice.
    let mut send = |n: u64| {
        let first = n * BLOCK;
        let bytes = match n % 3 {
            0 => json_block(first),
            _ => block(first, time_of(first), RATE_HZ as f64),
        };
        sender.send(&topic, &bytes);
        if n.is_multiple_of(7) {
            sender.send(&topic, &bytes);
        }
    };
    for n in (0..45).filter(|n| *n != 33) {
        let swapped = match n {
            10 | 24 => n + 1,
            11 | 25 => n - 1,
            _ => n,
        };
        send(swapped);
    }
    // Those before the lost one; the others wait for it.
    service.wait_for("/v1/assets/pump/streams", |streams| {
        streams["items"][0]["next"].as_u64().is_some_and(|next| next >= 33 * BLOCK)
    });
    // The broker keeps what comes meanwhile.
    service.run(first_feed.stop(LONGEST));
    (45..60).for_each(&mut send);
    let second_feed = feed(&service, port, &root, &settings);
    (60..80).for_each(&mut send);
    let stream = service.wait_for("/v1/assets/pump/stream?name=in", |stream| stream["next"] == 80 * BLOCK);
    assert_eq!((&stream["gaps"], &stream["gap_samples"]), (&json!(1), &json!(BLOCK)), "{stream}");

    // Each record ends after 2 s, or at the gap.
    let page = service
        .wait_for("/v1/assets/pump/segments?limit=1000", |page| page["items"].as_array().unwrap().len() >= 4);
    let mut ranges = Vec::new();
    for record in page["items"].as_array().unwrap() {
        let raw = service.get(&format!("/v1/segments/{}/raw", record["id"].as_str().unwrap())).expect(200);
        let at: Timestamp = record["start_time"].as_str().unwrap().parse().unwrap();
        let first = at.duration_since(time_of(0)).as_millis() as u64 * RATE_HZ / 1000;
        let count = record["samples"].as_u64().unwrap();
        let expected: Vec<u8> = (first..first + count).flat_map(|n| value(n).to_le_bytes()).collect();
        assert!(raw.bytes == expected, "{first}: {record}");
        ranges.push([first, first + count]);
        assert_eq!((&record["channel"], &record["unit"]), (&json!("in"), &json!("m/s2")));
        assert_eq!(record["operating_point"]["shaft_speed_hz"], 12.5);
    }
    ranges.sort_unstable();
    assert_eq!(ranges, [[0, 2000], [2000, 3300], [3400, 5400], [5400, 7400]]);
    service.run(second_feed.stop(LONGEST));
    // Nothing was left unacknowledged at the broker.
    let third_feed = feed(&service, port, &root, &settings);
    send(80);
    service.wait_for("/v1/assets/pump/stream?name=in", |stream| stream["next"] == 81 * BLOCK);
    let text = String::from_utf8(service.get("/metrics").expect(200).bytes).unwrap();
    let repeated = text.lines().rfind(|line| line.contains("outcome=\"repeated\"")).unwrap();
    assert!(repeated.ends_with(" 0"), "{repeated}");
    service.run(third_feed.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn a_repeated_block_is_recognised_after_a_jump_of_the_sensors_clock() {
    let broker = Broker::start();
    let port = broker.port;
    let service = service();
    let (root, rate_hz) = (unique("jump"), RATE_HZ as f64);
    let topic = format!("{root}/pump/in/samples");
    let listener = Listener::connect(port, &format!("{root}/+/+/rejected"));
    let first_feed = feed(&service, port, &root, "client_id = \"jump\"");
    let mut sender = Sender::connect(port);
    // The clock is set an hour ahead after 5 s.
    let at = |n: u64| time_of(n * BLOCK) + SignedDuration::from_hours(i64::from(n >= 50));
    let last = 230;
    for n in 0..=last {
        sender.send(&topic, &block(n * BLOCK, at(n), rate_hz));
    }
    let stored = |next: u64| {
        service.wait_for("/v1/assets/pump/streams", |streams| streams["items"][0]["next"] == next);
    };
    stored((last + 1) * BLOCK);
    service.run(first_feed.stop(LONGEST));
    let second_feed = feed(&service, port, &root, "client_id = \"jump\"");
    sender.send(&topic, &block(last * BLOCK, at(last), rate_hz));
    // The count of this one has restarted.
    sender.send(&topic, &block(0, at(last + 20), rate_hz));
    let rejected = listener.wait_for(1);
    assert_eq!(rejected[0].1["value"], "0", "{rejected:?}");
    sender.send(&topic, &block((last + 1) * BLOCK, at(last + 1), rate_hz));
    stored((last + 2) * BLOCK);
    assert_eq!(listener.wait_for(1).len(), 1);
    service.run(second_feed.stop(LONGEST));
}

/// The shaft speeds of the records of a stream in time order.
fn speeds(service: &Service, count: usize) -> Vec<Value> {
    let page = service.wait_for("/v1/assets/pump/segments?limit=1000", |page| {
        page["items"].as_array().unwrap().len() >= count
    });
    let mut records = page["items"].as_array().unwrap().clone();
    records.sort_by_key(|record| record["start_time"].as_str().unwrap().to_owned());
    records.iter().map(|record| record["operating_point"]["shaft_speed_hz"].clone()).collect()
}

/// The pulses of a tachometer in samples, from one index to another.
fn pulses(from: f64, until: f64) -> impl Iterator<Item = f64> {
    (0..)
        .map(|k| 10.2 + 37.3 * f64::from(k))
        .skip_while(move |at| *at < from)
        .take_while(move |at| *at < until)
}

#[test]
#[ignore = "needs mosquitto"]
fn each_pulse_of_a_tachometer_counts_once() {
    let broker = Broker::start();
    let port = broker.port;
    let service = service();
    let root = unique("pulses");
    let topic = format!("{root}/pump/in/samples");
    let feed = feed(&service, port, &root, "");
    let mut sender = Sender::connect(port);
    // With the pulses before and after the block. The sensor reads its clock up to 40 µs late.
    let mut send = |first: u64| {
        let late_us = (first / BLOCK % 3) as i64 * 20;
        let samples = (first..first + BLOCK).map(value).collect();
        let at = time_of(first) + SignedDuration::from_micros(late_us);
        let (from, rate_hz) = (first as f64, RATE_HZ as f64);
        let around = pulses(from - 40.0, from + BLOCK as f64 + 40.0);
        let pulse_times_s = around.map(|at| (at - from) / rate_hz - late_us as f64 * 1e-6).collect();
        let tachometer = Tachometer { pulse_times_s, pulses_per_revolution: 1 };
        let record = Record::new("1", at, rate_hz, "m/s2", samples).unwrap();
        sender.send(&topic, &encode(first, &record.with_tachometer(Some(tachometer))));
    };
    // Some are swapped, one is sent twice, and one overlaps the one before and the one after it.
    let order = (0..10).chain([11, 10, 12, 13, 13, 15, 14]).chain(16..30);
    order.for_each(|n| send(n * BLOCK));
    send(30 * BLOCK - BLOCK / 2);
    (30..40).for_each(|n| send(n * BLOCK));

    let page = service
        .wait_for("/v1/assets/pump/segments?limit=1000", |page| page["items"].as_array().unwrap().len() == 2);
    for record in page["items"].as_array().unwrap() {
        let raw = service.get(&format!("/v1/segments/{}/raw", record["id"].as_str().unwrap())).expect(200);
        let raw = decode_block(&raw.bytes, BlockEncoding::Protobuf, &RecordDefaults::default()).unwrap();
        let first = (raw.start_time().duration_since(time_of(0)).as_secs_f64() * RATE_HZ as f64).round();
        let found = &raw.tachometer().unwrap().pulse_times_s;
        let expected: Vec<f64> =
            pulses(first - 1000.0, first + 2000.0).map(|at| (at - first) / 1e3).collect();
        assert_eq!(found.len(), expected.len(), "{first}: {found:?}");
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-4, "{first}: {found}, {expected}");
        }
    }
    service.run(feed.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn an_operating_point_does_not_outlast_a_connection() {
    let broker = Broker::start();
    let port = broker.port;
    let service = service();
    let root = unique("point");
    let topic = format!("{root}/pump/in/samples");
    let mut sender = Sender::connect(port);
    let first_feed = feed(&service, port, &root, "");
    (0..20).for_each(|n| sender.send(&topic, &json_block(n * BLOCK)));
    assert_eq!(speeds(&service, 1), [json!(12.5)]);
    service.run(first_feed.stop(LONGEST));
    let second_feed = feed(&service, port, &root, "");
    for n in 20..40 {
        let mut unknown: Value = serde_json::from_slice(&json_block(n * BLOCK)).unwrap();
        unknown.as_object_mut().unwrap().remove("operating_point");
        sender.send(&topic, unknown.to_string().as_bytes());
    }
    assert_eq!(speeds(&service, 2), [json!(12.5), Value::Null]);
    service.run(second_feed.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn invalid_blocks_are_rejected_with_the_reason() {
    let broker = Broker::start();
    let port = broker.port;
    let service = service();
    let root = unique("blocks");
    let listener = Listener::connect(port, &format!("{root}/+/+/rejected"));
    let feed = feed(&service, port, &root, "");
    let mut sender = Sender::connect(port);
    let mut send = |asset: &str, point: &str, payload: &[u8]| {
        sender.send(&format!("{root}/{asset}/{point}/samples"), payload);
    };
    let rate_hz = RATE_HZ as f64;
    send("pump", "in", &block(0, time_of(0), rate_hz));
    service.wait_for("/v1/assets/pump/streams", |streams| streams["items"][0]["next"] == BLOCK);
    let restarted = time_of(0) + SignedDuration::from_secs(60);
    let mut timeless: Value = serde_json::from_slice(&json_block(BLOCK)).unwrap();
    timeless.as_object_mut().unwrap().remove("start_time");
    let mut far: Value = serde_json::from_slice(&json_block(BLOCK)).unwrap();
    far["first_sample_index"] = json!(u64::MAX);
    let cases = [
        ("pump", "in", far.to_string().into_bytes(), 422, "first index"),
        ("nobody", "in", block(BLOCK, time_of(BLOCK), rate_hz), 404, "nobody"),
        ("pump", "in", block(0, restarted, rate_hz), 409, "first_sample_index is 0, expected at least 100"),
        ("pump", "in", block(BLOCK, time_of(BLOCK), 2000.0), 409, "format"),
        ("pump", "in", timeless.to_string().into_bytes(), 422, "start_time is missing"),
        ("pump", "in", vec![0xff; 50], 422, "not a WaveformBlock in protobuf"),
        ("pump", "input shaft", block(0, time_of(0), rate_hz), 422, "topic is"),
    ];
    for (n, (asset, point, payload, status, words)) in cases.iter().enumerate() {
        send(asset, point, payload);
        // One by one, as streams reject at their own pace.
        let (topic, problem) = listener.wait_for(n + 1).pop().unwrap();
        assert_eq!(topic, format!("{root}/{asset}/{point}/rejected"));
        assert_eq!(problem["status"], *status, "{problem}");
        assert!(problem["detail"].as_str().unwrap().contains(words), "{words}: {problem}");
    }
    // They do not disturb the stream.
    send("pump", "in", &block(BLOCK, time_of(BLOCK), rate_hz));
    service.wait_for("/v1/assets/pump/stream?name=in", |stream| stream["next"] == 2 * BLOCK);
    service.run(feed.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn points_count_towards_the_limit_on_streams() {
    let broker = Broker::start();
    let port = broker.port;
    let service = Service::start_with(|config| config.work.streams_at_once = 3);
    service.plain_asset("pump");
    let root = unique("places");
    let listener = Listener::connect(port, &format!("{root}/+/+/rejected"));
    let feed = feed(&service, port, &root, "");
    let mut sender = Sender::connect(port);
    let mut send = |point: &str, first: u64| {
        sender.send(&format!("{root}/pump/{point}/samples"), &block(first, time_of(first), RATE_HZ as f64));
    };
    let stored = |point: &str, next: u64| {
        let path = format!("/v1/assets/pump/stream?name={point}");
        let began = std::time::Instant::now();
        while service.get(&path).json()["next"] != next {
            assert!(began.elapsed() < LONGEST, "{point}");
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    };
    for point in ["a", "b"] {
        send(point, 0);
        stored(point, BLOCK);
    }
    // Three quarters of them are two.
    send("c", 0);
    let (topic, problem) = listener.wait_for(1).pop().unwrap();
    assert_eq!((topic, &problem["status"]), (format!("{root}/pump/c/rejected"), &json!(503)), "{problem}");
    assert!(problem["detail"].as_str().unwrap().contains("limits.streams"), "{problem}");
    let path = |name: &str| {
        service.url(&format!("/v1/assets/pump/stream?sample=f32&sample_rate_hz=1000&name={name}"))
    };
    let _held = StreamSocket::open(&path("d"), &[]).unwrap();
    assert_eq!(StreamSocket::open(&path("e"), &[]).map(|_| ()), Err(503));
    // Points that have a place go on.
    send("a", BLOCK);
    stored("a", 2 * BLOCK);
    service.run(feed.stop(LONGEST));
    let began = std::time::Instant::now();
    while StreamSocket::open(&path("e"), &[]).is_err() {
        assert!(began.elapsed() < LONGEST, "the places of the points are not free");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
}
