//! A channel of a live stream that is the signal of a tachometer: records have its pulses instead, whatever
//! way the samples arrive.

use flankwatch::recording::{BlockEncoding, RecordDefaults, decode_block};
use serde_json::{Value, json};

use crate::command::flankwatch;
use crate::running::{Service, plain_asset};
use crate::stream_socket::StreamSocket;

const RATE_HZ: f64 = 4000.0;
const FORMAT: &str = "sample=f32&sample_rate_hz=4000&channels=2&unit=m/s2&channel_names=in,tacho";
const TACHOMETER: &str = "tachometer_channel=tacho&tachometer_level=2.5&pulses_per_revolution=2";
const START: &str = "2026-01-01T00:00:00Z";
/// Four seconds at 40 pulses per second, and two at a standstill.
const TURNING: u64 = 16_000;
const END: u64 = 24_000;

/// Samples between the edges of two pulses.
const PERIOD: f64 = 99.7;

fn vibration(k: u64) -> f32 {
    (k as f64 * 0.7).sin() as f32
}

/// Pulses of 5 V, each with an edge of four samples, half-way at a multiple of the period.
fn tachometer(k: u64) -> f32 {
    if k >= TURNING {
        return 0.0;
    }
    let phase = (k as f64 + 2.0).rem_euclid(PERIOD);
    (if phase < 4.0 {
        1.25 * phase
    } else if phase < 50.0 {
        5.0
    } else {
        0.0
    }) as f32
}

fn frames(from: u64, until: u64) -> Vec<u8> {
    (from..until).flat_map(|k| [vibration(k), tachometer(k)]).flat_map(f32::to_le_bytes).collect()
}

fn service(assets: &[&str]) -> Service {
    let service = Service::start();
    for asset in assets {
        let mut asset = plain_asset(asset);
        asset["stream"] = json!({ "record_s": 2, "interval_s": 2 });
        service.post_json("/v1/assets", &asset).expect(201);
    }
    service
}

/// The records of an asset in time order.
fn records(service: &Service, asset: &str) -> Vec<Value> {
    service.wait_for(&format!("/v1/assets/{asset}/stream"), |status| status["records"] == 3);
    let page = service.get(&format!("/v1/assets/{asset}/segments")).expect(200).json();
    let mut items = page["items"].as_array().unwrap().clone();
    items.sort_by_key(|item| item["start_time"].as_str().unwrap().to_owned());
    assert!(items.len() == 3 && items.iter().all(|item| item["channel"] == "in"), "{page}");
    items
}

#[test]
fn pulses_of_a_channel_are_the_same_however_it_is_sent() {
    let service = service(&["by-socket", "by-body", "by-command"]);
    let address = |asset: &str, more: &str| format!("/v1/assets/{asset}/stream?{FORMAT}&{TACHOMETER}{more}");

    let url = service.url(&address("by-socket", "&first_index=0"));
    let mut socket = StreamSocket::open(&url, &[]).unwrap();
    let begin_ns = 1_767_225_600_000_000_000;
    for first in (0..END).step_by(777) {
        let until = (first + 777).min(END);
        socket.send(first, begin_ns + first as i64 * 250_000, &frames(first, until));
    }
    socket.wait_for(END);
    socket.send_json(&json!({ "type": "tachometer", "from": END, "pulses": [5] }));
    let (code, reason) = socket.receive().unwrap_err();
    assert!(code == 4400 && reason.contains("a channel of the stream is its tachometer"), "{code} {reason}");

    for first in (0..END).step_by(5001) {
        let time: jiff::Timestamp = START.parse().unwrap();
        let time = time + jiff::SignedDuration::from_micros(first as i64 * 250);
        let path = address("by-body", &format!("&first_index={first}&start_time={time}"));
        service.post(&path, "application/octet-stream", &frames(first, (first + 5001).min(END))).expect(200);
    }

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("samples.raw");
    std::fs::write(&path, frames(0, END)).unwrap();
    let (path, url) = (path.to_str().unwrap(), service.url(""));
    let sending = ["stream", path, "--asset", "by-command", "--url", &url, "--start-time", START];
    let format = ["--sample", "f32", "--rate", "4000", "--channels", "2", "--unit", "m/s2"];
    let channels = ["--channel-names", "in,tacho", "--tachometer-channel", "tacho"];
    let pulses = ["--tachometer-level", "2.5", "--pulses-per-revolution", "2"];
    flankwatch(&[&sending[..], &format, &channels, &pulses].concat()).expect_success();

    for asset in ["by-socket", "by-body", "by-command"] {
        let found = records(&service, asset);
        for (n, record) in found.iter().enumerate() {
            let raw =
                service.get(&format!("/v1/segments/{}/raw", record["id"].as_str().unwrap())).expect(200);
            let first = 8000 * n as u64;
            let samples: Vec<f32> = (first..first + 8000).map(vibration).collect();
            if first >= TURNING {
                // The last pulses before it are not followed by others.
                assert_ne!(record["shaft_angle"]["source"], "tachometer");
                continue;
            }
            let block =
                decode_block(&raw.bytes, BlockEncoding::Protobuf, &RecordDefaults::default()).unwrap();
            assert_eq!(block.samples(), samples);
            let given = block.tachometer().unwrap();
            assert_eq!(given.pulses_per_revolution, 2);
            // The signal has to be low first.
            let from = if first == 0 { 1.0 } else { first as f64 - RATE_HZ };
            let pulses = (1..).map(|k| f64::from(k) * PERIOD).skip_while(|position| *position < from);
            let pulses: Vec<f64> = pulses.take_while(|position| *position < (first + 8000) as f64).collect();
            assert_eq!(given.pulse_times_s.len(), pulses.len());
            for (time_s, position) in given.pulse_times_s.iter().zip(pulses) {
                let expected_s = (position - first as f64) / RATE_HZ;
                assert!((time_s - expected_s).abs() < 1e-7, "{time_s}, {expected_s}");
            }
            assert_eq!(record["shaft_speed"]["source"], "tachometer");
            let speed_hz = record["shaft_speed"]["shaft_speed_hz"].as_f64().unwrap();
            assert!((speed_hz - RATE_HZ / PERIOD / 2.0).abs() < 1e-3, "{record}");
        }
    }
    let status = service.get("/v1/assets/by-body/stream").expect(200).json();
    let expected =
        json!({ "channel": "tacho", "level": 2.5, "hysteresis": 1.25, "pulses_per_revolution": 2 });
    assert_eq!(status["tachometer"], expected);
}

#[test]
fn errors_about_a_tachometer_name_the_parameter() {
    let service = service(&["pump"]);
    for (more, status, words) in [
        ("&tachometer_channel=tacho", 400, "tachometer_level"),
        ("&tachometer_level=1", 400, "tachometer_channel"),
        ("&tachometer_channel=out&tachometer_level=1", 422, "tachometer_channel is out"),
        (
            "&tachometer_channel=in&tachometer_level=1&tachometer_hysteresis=-1",
            422,
            "tachometer_hysteresis is -1",
        ),
        (
            "&tachometer_channel=in&tachometer_level=1&pulses_per_revolution=0",
            422,
            "pulses_per_revolution is 0",
        ),
    ] {
        let path = format!("/v1/assets/pump/stream?{FORMAT}{more}");
        service.post(&path, "application/octet-stream", &frames(0, 10)).expect_problem(status, &[words]);
    }
    // Another level would give other records.
    let send = |level: &str| {
        let path =
            format!("/v1/assets/pump/stream?{FORMAT}&tachometer_channel=tacho&tachometer_level={level}");
        service.post(&path, "application/octet-stream", &frames(0, 10))
    };
    send("2.5").expect(200);
    send("2").expect_problem(409, &["tachometer"]);
    let refused = flankwatch(&["stream", "--asset", "pump", "--tachometer-channel", "2"]);
    refused.expect_failure(&["--tachometer-level"]);
}
