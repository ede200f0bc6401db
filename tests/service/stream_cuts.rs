//! Which parts of live streams become records: those of a steady machine, those around an alarm, and all of a
//! measuring campaign.

use std::io::Cursor;

use flankwatch::recording::McapReader;
use flankwatch::signal::Record;
use serde_json::{Value, json};

use crate::alarms::at_once;
use crate::running::{Service, plain_asset};
use crate::stream_socket::{StreamSocket, frames};

const RATE_HZ: u64 = 1000;
/// 2026-01-01 in nanoseconds.
const BEGIN_NS: i64 = 1_767_225_600_000_000_000;

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

/// Waits for a number of records, and returns their first samples and lengths.
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
fn a_steady_machine_gives_one_record_per_bin_and_the_same_after_a_restart() {
    let stream = json!({ "record_s": 2, "steady": { "for_s": 5, "at_most_every_s": 100 } });
    let bins = json!([{ "name": "slow", "shaft_speed_hz": [5, 15] }, { "name": "fast", "shaft_speed_hz": [15, 30] }]);
    let mut service = service(&stream, &json!({ "operating_bins": bins }));
    let mut socket = open(&service);
    send(&mut socket, 0, 20_000, u64::MAX);
    let send_speed = |socket: &mut StreamSocket, speed_hz: f64| {
        socket.send_json(&json!({ "type": "operating", "shaft_speed_hz": speed_hz, "torque_nm": 80 }));
    };
    send_speed(&mut socket, 10.0);
    send(&mut socket, 20_000, 24_000, u64::MAX);
    service.restart();
    let mut socket = open(&service);
    assert_eq!(socket.next, Some(24_000));
    // Within the bounds, and then for long.
    send_speed(&mut socket, 10.1);
    send(&mut socket, 24_000, 40_000, u64::MAX);
    assert_eq!(records(&service, 1), [(23_000, 2000)]);
    send_speed(&mut socket, 20.0);
    send(&mut socket, 40_000, 44_000, u64::MAX);
    send_speed(&mut socket, 22.0);
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

#[test]
fn samples_around_an_alarm_are_kept_within_limits_and_over_a_restart() {
    let stream = json!({ "record_s": 2, "interval_s": 20, "on_alarm": { "before_s": 5, "after_s": 7 } });
    let alarms = json!([{ "quantity": { "indicator": "rms" }, "warning": 5, "danger": 500,
        "settings": { "raise": 1, "raise_of": 1, "clear": 1, "clear_of": 1 } }]);
    let mut service = service(&stream, &json!({ "alarms": alarms }));
    let mut socket = open(&service);
    send(&mut socket, 0, 19_000, 18_000);
    assert_eq!(records(&service, 1), [(0, 2000)]);
    // The record of the next interval is loud.
    send(&mut socket, 19_000, 22_500, 18_000);
    service.wait_for("/v1/alarms?asset=pump", |list| list["items"][0]["severity"] == "warning");
    // From 17.5 s up to 29.5 s: what is there is cut at once.
    let begun = [(0, 2000), (17_500, 2000), (19_500, 2000), (20_000, 2000)];
    assert_eq!(records(&service, 4), begun);
    send(&mut socket, 22_500, 24_000, 18_000);
    service.restart();
    let mut socket = open(&service);
    send(&mut socket, 24_000, 39_000, 18_000);
    let all = [begun.as_slice(), &[(21_500, 2000), (23_500, 2000), (25_500, 2000), (27_500, 2000)]].concat();
    assert_eq!(records(&service, 8), all);
    // The alarm persists without a new one; records continue by the interval.
    send(&mut socket, 39_000, 43_000, 18_000);
    assert_eq!(records(&service, 9)[8], (40_000, 2000));
}

#[test]
fn a_campaign_does_not_shorten_what_is_recorded_around_an_alarm() {
    let stream = json!({ "record_s": 2, "interval_s": 20, "on_alarm": { "before_s": 5, "after_s": 7 } });
    let alarms = json!([{ "quantity": { "indicator": "rms" }, "warning": 5, "settings": at_once() }]);
    let mut service = service(&stream, &json!({ "alarms": alarms }));
    let mut socket = open(&service);
    send(&mut socket, 0, 22_500, 18_000);
    service.wait_for("/v1/alarms?asset=pump", |list| list["items"][0]["severity"] == "warning");
    // From 17.5 s up to 29.5 s.
    let begun = [(0, 2000), (17_500, 2000), (19_500, 2000), (20_000, 2000)];
    assert_eq!(records(&service, 4), begun);
    let path = "/v1/assets/pump/stream/campaign";
    let campaign = service.post(&format!("{path}?seconds=1"), "", b"").expect(200).json();
    assert_eq!((&campaign["first"], &campaign["end"]), (&json!(21_500), &json!(29_500)));
    service.delete(path).expect(204);
    service.restart();
    let mut socket = open(&service);
    send(&mut socket, 22_500, 33_000, 18_000);
    let all = [begun.as_slice(), &[(21_500, 2000), (23_500, 2000), (25_500, 2000), (27_500, 2000)]].concat();
    assert_eq!(records(&service, 8), all);
    let campaign = service.get("/v1/assets/pump/stream").expect(200).json()["campaign"].clone();
    assert_eq!((&campaign["is_running"], &campaign["end"]), (&json!(false), &json!(29_500)));
}

#[test]
fn a_campaign_keeps_everything_until_it_ends_and_is_exported() {
    let mut service = service(&json!({ "record_s": 2, "interval_s": 0 }), &json!({}));
    let path = "/v1/assets/pump/stream/campaign";
    service.post(path, "", b"").expect_problem(404, &["main"]);
    let mut socket = open(&service);
    service.post(path, "", b"").expect_problem(404, &["main"]);
    send(&mut socket, 0, 3500, u64::MAX);
    for seconds in ["0", "86401", "nan"] {
        service
            .post(&format!("{path}?seconds={seconds}"), "", b"")
            .expect_problem(400, &["seconds", "86400"]);
    }
    let begun = service.post(&format!("{path}?seconds=9"), "", b"").expect(200).json();
    assert_eq!(
        (&begun["is_running"], &begun["first"], &begun["end"]),
        (&json!(true), &json!(3500), &json!(12_500))
    );
    send(&mut socket, 3500, 7000, u64::MAX);
    service.restart();
    let mut socket = open(&service);
    // A gap ends a record, and the next one begins after it.
    socket.send_json(&json!({ "type": "gap", "next": 8000 }));
    send(&mut socket, 8000, 20_000, u64::MAX);
    let all = [(3500, 2000), (5500, 1500), (8000, 2000), (10_000, 2000), (12_000, 500)];
    assert_eq!(records(&service, 5), all);
    let campaign = service.get("/v1/assets/pump/stream").expect(200).json()["campaign"].clone();
    assert_eq!((&campaign["is_running"], &campaign["records"]), (&json!(false), &json!(5)));
    assert_eq!(campaign["start_time"], "2026-01-01T00:00:03.5Z");
    assert_eq!(campaign["end_time"], "2026-01-01T00:00:12.5Z");
    // Ended early; the samples until then are kept.
    service.post(&format!("{path}?seconds=1000"), "", b"").expect(200);
    let longer = service.post(&format!("{path}?seconds=2000"), "", b"").expect(200).json();
    assert_eq!((&longer["first"], &longer["end"]), (&json!(20_000), &json!(2_020_000)));
    send(&mut socket, 20_000, 22_700, u64::MAX);
    service.delete(path).expect(204);
    service.delete(path).expect(204);
    send(&mut socket, 22_700, 30_000, u64::MAX);
    assert_eq!(records(&service, 7)[5..], [(20_000, 2000), (22_000, 700)]);
    let campaign = service.get("/v1/assets/pump/stream").expect(200).json()["campaign"].clone();
    assert_eq!((&campaign["is_running"], &campaign["end"]), (&json!(false), &json!(22_700)));
    let (from, to) = (campaign["start_time"].as_str().unwrap(), campaign["end_time"].as_str().unwrap());
    let export =
        service.get(&format!("/v1/assets/pump/export?from={from}&to={to}&spectra=10000")).expect(200);
    let messages = mcap::MessageStream::new(&export.bytes).unwrap().map(Result::unwrap);
    assert_eq!(messages.filter(|message| message.channel.topic == "/pump/1/spectrum").count(), 2);
    // With its samples, the export is a normal recording.
    let whole = service
        .get(&format!("/v1/assets/pump/export?from={from}&to={to}&spectra=0&waveforms=true"))
        .expect(200);
    let again: Vec<Record> =
        McapReader::new(Cursor::new(whole.bytes)).map(|recorded| recorded.unwrap().record).collect();
    let times: Vec<String> = again.iter().map(|record| record.start_time().to_string()).collect();
    assert_eq!(times, ["2026-01-01T00:00:20Z", "2026-01-01T00:00:22Z"]);
    let samples = again.iter().flat_map(|record| record.samples().to_vec());
    assert_eq!(samples.flat_map(f32::to_le_bytes).collect::<Vec<u8>>(), frames(20_000, 2_700, u64::MAX));
}

#[test]
fn records_that_are_complete_at_once_are_in_memory_a_few_at_a_time() {
    let service = Service::start_with(|config| config.work.workers = 1);
    let mut asset = plain_asset("pump");
    asset["stream"] = json!({ "record_s": 20, "interval_s": 20 });
    service.post_json("/v1/assets", &asset).expect(201);
    let length = 20 * RATE_HZ;
    let open = |n: u64| {
        let format = format!("sample=f32&sample_rate_hz={RATE_HZ}&channel_names=s{n}");
        let path = format!("/v1/assets/pump/stream?{format}&name=s{n}&first_index=0");
        StreamSocket::open(&service.url(&path), &[]).unwrap()
    };
    let mut sockets: Vec<StreamSocket> = (0..12).map(open).collect();
    sockets.iter_mut().for_each(|socket| send(socket, 0, length - 1, u64::MAX));
    // The last sample of all records.
    let time_ns = BEGIN_NS + ((length - 1) * 1_000_000_000 / RATE_HZ) as i64;
    let last = frames(length - 1, 1, u64::MAX);
    sockets.iter_mut().for_each(|socket| socket.send(length - 1, time_ns, &last));
    let running = service.service();
    let most = std::thread::scope(|scope| {
        let stored = scope.spawn(|| {
            service.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] == 12);
        });
        let mut most = 0;
        while !stored.is_finished() {
            most = most.max(running.workers.queue().0);
        }
        most
    });
    assert_eq!(most, 2, "records in memory, with one worker thread");
}
