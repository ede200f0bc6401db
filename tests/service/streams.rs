//! Live streams: samples in chunks of any size are stored once and cut into records.

use std::io::{Read, Write};
use std::net::TcpStream;

use flankwatch::store::Scope;
use jiff::Timestamp;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::command::flankwatch;
use crate::program::Program;
use crate::running::{Service, plain_asset};
use crate::stream_socket::StreamSocket;
use crate::tokens::Tokens;

const RATE_HZ: u64 = 1000;
pub(crate) const FORMAT: &str =
    "sample=i16&sample_rate_hz=1000&channels=2&scale=0.5&unit=m/s2&channel_names=in,out";
/// 2026-01-01 in nanoseconds.
const BEGIN_NS: i64 = 1_767_225_600_000_000_000;

/// Returns the value of a channel's sample.
fn count(index: u64, channel: u64) -> i16 {
    (index.wrapping_mul(2_654_435_761).wrapping_add(channel * 40_503) >> 7) as i16
}

pub(crate) fn frames(first: u64, count_of: u64) -> Vec<u8> {
    let indices = first..first + count_of;
    indices.flat_map(|k| [count(k, 0), count(k, 1)]).flat_map(i16::to_le_bytes).collect()
}

pub(crate) fn time_ns(index: u64) -> i64 {
    BEGIN_NS + (index * 1_000_000_000 / RATE_HZ) as i64
}

/// Starts a service with an asset whose streams are cut into records of 2 s every 10 s.
pub(crate) fn service() -> Service {
    let service = Service::start();
    service.post_json("/v1/assets", &asset(2.0, 10.0)).expect(201);
    service
}

pub(crate) fn asset(record_s: f64, interval_s: f64) -> Value {
    let mut asset = plain_asset("pump");
    asset["stream"] = json!({ "record_s": record_s, "interval_s": interval_s });
    asset
}

pub(crate) fn address(service: &Service, more: &str) -> String {
    service.url(&format!("/v1/assets/pump/stream?{FORMAT}{more}"))
}

pub(crate) fn open(service: &Service, more: &str) -> StreamSocket {
    StreamSocket::open(&address(service, more), &[]).unwrap()
}

pub(crate) fn status(service: &Service) -> Value {
    service.get("/v1/assets/pump/stream").expect(200).json()
}

/// Waits for a number of records of a channel, and returns them in time order.
pub(crate) fn records(service: &Service, channel: &str, number: usize) -> Vec<Value> {
    let path = format!("/v1/assets/pump/segments?channel={channel}&limit=1000");
    let page = service.wait_for(&path, |page| page["items"].as_array().unwrap().len() >= number);
    let mut items = page["items"].as_array().unwrap().clone();
    assert_eq!(items.len(), number);
    items.sort_by_key(|item| item["start_time"].as_str().unwrap().to_owned());
    items
}

/// Checks that a record has the samples from an index on, bit for bit.
#[track_caller]
fn expect_samples(service: &Service, record: &Value, first: u64, number: u64) {
    let raw = service.get(&format!("/v1/segments/{}/raw", record["id"].as_str().unwrap())).expect(200);
    assert_eq!(record["samples"].as_u64(), Some(number));
    assert!(raw.bytes == frames(first, number), "samples from {first} on");
    assert_eq!(record["unit"], "m/s2");
}

#[test]
fn repeated_reordered_and_overlapping_chunks_are_stored_once_and_cut_into_records() {
    let service = service();
    let mut random = ChaCha8Rng::seed_from_u64(21);
    let mut socket = open(&service, "&first_index=0");
    assert_eq!(socket.next, Some(0));
    let end = 31_000;
    let mut sent = 0;
    while sent < end {
        // Within the two seconds that chunks may be out of order.
        let until = (sent + 1500).min(end);
        let mut chunks = Vec::new();
        let mut first = sent;
        while first < until {
            let length = random.random_range(1..200).min(until - first);
            chunks.push((first, length));
            let back = random.random_range(0..100).min(first);
            chunks.push((first - back, length));
            first += length;
        }
        chunks.shuffle(&mut random);
        for (first, length) in chunks {
            socket.send(first, time_ns(first), &frames(first, length));
        }
        assert_eq!(socket.wait_for(until), [[0; 2]; 0]);
        sent = until;
    }
    let status = status(&service);
    assert_eq!((&status["next"], &status["gaps"], &status["channels"]), (&json!(end), &json!(0), &json!(2)));
    for channel in ["in", "out"] {
        for (k, record) in records(&service, channel, 3).iter().enumerate() {
            let first = 10_000 * k as u64;
            let time: Timestamp = record["start_time"].as_str().unwrap().parse().unwrap();
            assert_eq!(time.as_nanosecond(), time_ns(first).into());
            expect_samples(&service, record, first, 2000);
        }
    }
    // The fourth is whole with a second more.
    socket.send(end, time_ns(end), &frames(end, 1000));
    socket.wait_for(end + 1000);
    records(&service, "in", 4);
    socket.send_json(&json!({ "type": "end" }));
    assert_eq!(socket.receive().unwrap_err().0, 1000);
    let list = service.get("/v1/assets/pump/streams").expect(200).json();
    assert_eq!((&list["items"][0]["name"], list["items"].as_array().unwrap().len()), (&json!("main"), 1));
}

#[test]
fn a_gap_is_reported_with_its_length_and_no_record_spans_it() {
    let service = service();
    let mut socket = open(&service, "&first_index=0");
    socket.send(0, time_ns(0), &frames(0, 11_000));
    socket.wait_for(11_000);
    // The missing ones may still come for two seconds of samples.
    socket.send(11_100, time_ns(11_100), &frames(11_100, 1000));
    socket.send(12_100, time_ns(12_100), &frames(12_100, 2000));
    assert_eq!(socket.wait_for(14_100), [[11_000, 100]]);
    // No wait is needed if the sender declares them lost.
    socket.send_json(&json!({ "type": "gap", "next": 15_000 }));
    assert_eq!(socket.wait_for(15_000), [[14_100, 900]]);
    socket.send(14_000, time_ns(14_000), &frames(14_000, 2000));
    socket.wait_for(16_000);
    let status = status(&service);
    assert_eq!((&status["gaps"], &status["gap_samples"]), (&json!(2), &json!(1000)));
    let found = records(&service, "in", 2);
    expect_samples(&service, &found[0], 0, 2000);
    expect_samples(&service, &found[1], 11_100, 2000);
}

#[test]
fn all_samples_become_records_if_the_interval_equals_the_length() {
    let service = service();
    service.put_json("/v1/assets/pump", &asset(1.0, 1.0)).expect(200);
    let mut socket = open(&service, "&first_index=500");
    socket.send(500, time_ns(500), &frames(500, 5000));
    socket.wait_for(5500);
    for (k, record) in records(&service, "out", 5).iter().enumerate() {
        expect_samples(&service, record, 500 + 1000 * k as u64, 1000);
    }
}

#[test]
fn a_drifting_rate_is_reported_and_a_clock_jump_moves_no_record() {
    let service = service();
    let mut socket = open(&service, "&first_index=0");
    // The crystal is 100 ppm fast, and the clock jumps by an hour half-way.
    let seen_ns = |index: u64| {
        let jump_ns = if index >= 150_000 { 3600 * 1_000_000_000 } else { 0 };
        BEGIN_NS + (index as f64 / 1.0001 * 1e6) as i64 + jump_ns
    };
    for first in (0..300_000).step_by(1000) {
        socket.send(first, seen_ns(first), &frames(first, 1000));
    }
    socket.wait_for(300_000);
    let status = status(&service);
    let drift_ppm = status["drift_ppm"].as_f64().unwrap();
    assert!((drift_ppm - 100.0).abs() < 5.0, "{drift_ppm}");
    assert_eq!(status["clock_jumps"], 1);
    for (k, record) in records(&service, "in", 30).iter().enumerate() {
        let time: Timestamp = record["start_time"].as_str().unwrap().parse().unwrap();
        let expected_s = 10.0 * k as f64 / 1.0001;
        let error_s = (time.as_nanosecond() - i128::from(BEGIN_NS)) as f64 / 1e9 - expected_s;
        assert!(error_s.abs() < 0.02, "record {k} is {error_s} s off");
    }
}

#[test]
fn a_stream_resumes_after_a_restart_at_the_services_index() {
    let mut service = service();
    let mut socket = open(&service, "&first_index=0");
    socket.send_json(&json!({ "type": "operating", "shaft_speed_hz": 9.5, "torque_nm": 80.0 }));
    socket.send(0, time_ns(0), &frames(0, 1700));
    socket.wait_for(1700);
    service.stop();
    assert_eq!(socket.receive().unwrap_err().0, 1001);
    service.launch();
    let mut socket = open(&service, "");
    assert_eq!(socket.next, Some(1700));
    socket.send(1500, time_ns(1500), &frames(1500, 1000));
    socket.wait_for(2500);
    let found = records(&service, "in", 1);
    expect_samples(&service, &found[0], 0, 2000);
    assert_eq!(found[0]["operating_point"]["torque_nm"], 80.0);
    service.restart();
    service.wait_for("/v1/assets/pump/stream", |status| status["records"] == 1);
    records(&service, "in", 1);
}

/// Begins a request with samples whose number is unknown.
fn begin_body(service: &Service, path: &str, more: &str) -> TcpStream {
    let mut stream = TcpStream::connect(service.url("").trim_start_matches("http://")).unwrap();
    let head =
        "content-type: application/octet-stream\r\ntransfer-encoding: chunked\r\nconnection: close\r\n";
    write!(stream, "POST {path} HTTP/1.1\r\nhost: localhost\r\n{head}{more}\r\n").unwrap();
    stream
}

fn send_piece(stream: &mut TcpStream, piece: &[u8]) {
    write!(stream, "{:x}\r\n", piece.len()).unwrap();
    stream.write_all(piece).unwrap();
    stream.write_all(b"\r\n").unwrap();
}

#[test]
fn an_endless_body_follows_the_description_and_the_token() {
    let service = service();
    let path = format!("/v1/assets/pump/stream?{FORMAT}&start_time=2026-01-01T00:00:00Z");
    let stored = |next: u64| {
        service.wait_for("/v1/assets/pump/streams", |list| list["items"][0]["next"] == next);
    };
    let mut stream = begin_body(&service, &path, "");
    send_piece(&mut stream, &frames(0, 3000));
    stored(3000);
    service.put_json("/v1/assets/pump", &asset(1.0, 1.0)).expect(200);
    std::thread::sleep(std::time::Duration::from_secs(2));
    send_piece(&mut stream, &frames(3000, 12_000));
    service.wait_for("/v1/assets/pump/stream", |status| status["records"] == 6);
    drop(stream);

    let tokens = Tokens::of(service.folder());
    let token = tokens.create("sensor", Scope::Write);
    let mut stream = begin_body(&service, &path, &format!("authorization: Bearer {token}\r\n"));
    send_piece(&mut stream, &frames(15_000, 100));
    std::thread::sleep(std::time::Duration::from_millis(200));
    tokens.revoke(token.split('_').nth(1).unwrap()).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(4100));
    send_piece(&mut stream, &frames(15_100, 100));
    let mut answer = String::new();
    stream.set_read_timeout(Some(std::time::Duration::from_secs(20))).unwrap();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 401 "), "{answer}");
}

#[test]
fn an_endless_body_is_stored_as_it_arrives() {
    let service = service();
    let path = format!("/v1/assets/pump/stream?{FORMAT}&first_index=0&start_time=2026-01-01T00:00:00Z");
    let mut stream = begin_body(&service, &path, "");
    let all = frames(0, 3000);
    // Pieces that end in the middle of a frame and of a sample.
    all.chunks(1001).for_each(|piece| send_piece(&mut stream, piece));
    service.wait_for("/v1/assets/pump/streams", |list| list["items"][0]["next"] == 3000);
    stream.write_all(b"0\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains("\"next\":3000"), "{answer}");
    let found = records(&service, "in", 1);
    expect_samples(&service, &found[0], 0, 2000);
    assert_eq!(found[0]["start_time"], "2026-01-01T00:00:00Z");
    // A repeat changes nothing, and what follows is appended.
    let bare = "application/octet-stream";
    let again = service.post(&path, bare, &all).expect(200).json();
    assert_eq!(again, json!({ "next": 3000, "gaps": [], "repeated": 3000 }));
    let append = format!("/v1/assets/pump/stream?{FORMAT}");
    assert_eq!(service.post(&append, bare, &frames(3000, 10)).expect(200).json()["next"], 3010);
    let gap = format!("{append}&first_index=4000&after_gap=true");
    let answer = service.post(&gap, bare, &frames(4000, 10)).expect(200).json();
    assert_eq!(answer, json!({ "next": 4010, "gaps": [{ "first": 3010, "samples": 990 }], "repeated": 0 }));
    let part = format!("{append}&first_index=3990");
    let answer = service.post(&part, bare, &frames(3990, 30)).expect(200).json();
    assert_eq!(answer, json!({ "next": 4020, "gaps": [], "repeated": 20 }));
    service
        .post(&format!("{append}&first_index=9007199254740992"), bare, b"")
        .expect_problem(400, &["first_index is \"9007199254740992\", expected a number below 2^53"]);
    service.post(&append, bare, &frames(4020, 1)[..3]).expect_problem(422, &["multiple"]);
    service.post(&append, "audio/wav", &all).expect_problem(415, &["application/octet-stream"]);
}

#[test]
fn levels_are_stored_per_second_and_a_record_is_cut_on_demand() {
    let service = service();
    let mut socket = open(&service, "&first_index=0");
    let square: Vec<u8> = (0..7500)
        .flat_map(|k| [if k % 2 == 0 { 8_i16 } else { -8 }, 100])
        .flat_map(i16::to_le_bytes)
        .collect();
    socket.send(0, time_ns(0), &square);
    socket.wait_for(7500);
    let levels = service.get("/v1/assets/pump/stream/levels?from=2026-01-01T00:00:02Z").expect(200).json();
    let items = levels["items"].as_array().unwrap();
    assert_eq!((items.len(), &items[0]["time"]), (5, &json!("2026-01-01T00:00:02Z")));
    assert_eq!((&items[0]["rms"], &items[0]["peak"]), (&json!([4.0, 50.0]), &json!([4.0, 50.0])));
    assert_eq!(levels["next_cursor"], Value::Null);
    let cursor = time_ns(4000);
    let rest = service.get(&format!("/v1/assets/pump/stream/levels?cursor={cursor}")).expect(200).json();
    assert_eq!(rest["items"][0], items[2]);
    service.get("/v1/assets/pump/stream/levels?cursor=x").expect_problem(400, &["cursor", "next_cursor"]);
    let kept = service.post("/v1/assets/pump/stream/keep?seconds=3", "", b"").expect(200).json();
    assert_eq!(kept, json!({ "start_time": "2026-01-01T00:00:04.5Z", "samples": 3000 }));
    let found = records(&service, "in", 2);
    assert_eq!((&found[1]["start_time"], &found[1]["samples"]), (&kept["start_time"], &json!(3000)));
    // As many samples as there are, from the same first sample as the interval's record.
    let all = service.post("/v1/assets/pump/stream/keep?seconds=10", "", b"").expect(200).json();
    assert_eq!(all, json!({ "start_time": "2026-01-01T00:00:00Z", "samples": 7500 }));
    let found = records(&service, "in", 3);
    let begun: Vec<_> = found.iter().filter(|record| record["start_time"] == all["start_time"]).collect();
    let mut lengths: Vec<_> = begun.iter().filter_map(|record| record["samples"].as_u64()).collect();
    lengths.sort_unstable();
    assert_eq!(lengths, [2000, 7500]);
    let counts =
        |list: &Value| (list["items"][0]["records"].clone(), list["items"][0]["records_waiting"].clone());
    service.wait_for("/v1/assets/pump/streams", |list| counts(list) == (json!(3), json!(0)));
    service.post("/v1/assets/pump/stream/keep?seconds=100", "", b"").expect_problem(400, &["seconds", "60"]);
    service.get("/v1/assets/pump/stream/levels?name=other").expect_problem(404, &["other"]);
}

#[test]
fn a_stream_without_an_interval_gives_records_on_demand_only() {
    let service = Service::start();
    service
        .post_json("/v1/assets", &asset(2.0, 1.0))
        .expect_problem(422, &["stream.interval_s", "0, or at least"]);
    service.post_json("/v1/assets", &asset(2.0, 0.0)).expect(201);
    let mut socket = open(&service, "&first_index=0");
    socket.send(0, time_ns(0), &frames(0, 7500));
    socket.wait_for(7500);
    service.post("/v1/assets/pump/stream/keep?seconds=3", "", b"").expect(200);
    let found = records(&service, "in", 1);
    expect_samples(&service, &found[0], 4500, 3000);
    let list = service.get("/v1/assets/pump/streams").expect(200).json();
    assert_eq!(list["items"][0]["records_waiting"], 0);
    // Records begin where the description changes.
    service.put_json("/v1/assets/pump", &asset(2.0, 2.0)).expect(200);
    socket.send(7500, time_ns(7500), &frames(7500, 2500));
    socket.wait_for(10_000);
    drop(socket);
    let mut socket = open(&service, "");
    socket.send(10_000, time_ns(10_000), &frames(10_000, 2500));
    socket.wait_for(12_500);
    let found = records(&service, "in", 2);
    assert_eq!(found[1]["samples"], 2000);
}

#[test]
fn a_restored_stream_keeps_samples_that_are_not_in_a_record_yet() {
    let place = tempfile::tempdir().unwrap();
    let [data, copy, elsewhere] = ["data", "copy", "elsewhere"].map(|name| place.path().join(name));
    let open = |program: &Program| {
        let url = format!("{}/v1/assets/pump/stream?{FORMAT}&first_index=0", program.url());
        StreamSocket::open(&url, &[]).unwrap()
    };
    let on = |folder: &std::path::Path, words: [&str; 2]| {
        let output =
            flankwatch(&[words[0], words[1], "--data-dir", folder.to_str().unwrap()]).expect_success();
        assert!(output.out().contains("1 live stream\n"), "{}", output.out());
    };
    let program = Program::start(&data);
    program.make(&asset(2.0, 10.0));
    let mut socket = open(&program);
    // Half of the second record is there.
    socket.send(0, time_ns(0), &frames(0, 11_000));
    socket.wait_for(11_000);
    on(&data, ["backup", copy.to_str().unwrap()]);
    socket.send(11_000, time_ns(11_000), &frames(11_000, 500));
    socket.wait_for(11_500);
    program.kill();

    on(&elsewhere, ["restore", copy.to_str().unwrap()]);
    let restored = Program::start(&elsewhere);
    let mut socket = open(&restored);
    assert_eq!(socket.next, Some(11_000));
    socket.send(11_000, time_ns(11_000), &frames(11_000, 1000));
    socket.wait_for(12_000);
    let began = std::time::Instant::now();
    let mut items = loop {
        let items = restored.get("/v1/assets/pump/segments?channel=in")["items"].as_array().unwrap().clone();
        if items.len() == 2 {
            break items;
        }
        assert!(began.elapsed() < std::time::Duration::from_secs(100), "{}", restored.log());
        std::thread::sleep(std::time::Duration::from_millis(20));
    };
    items.sort_by_key(|item| item["start_time"].as_str().unwrap().to_owned());
    for (item, first) in items.iter().zip([0, 10_000]) {
        let path = format!("/v1/segments/{}/raw", item["id"].as_str().unwrap());
        let raw = restored.send("GET", &path, &[], b"").body_mut().read_to_vec().unwrap();
        assert!(raw == frames(first, 2000), "samples from {first} on");
    }
    restored.kill();
}

#[test]
fn a_lost_database_leaves_the_journals_of_streams() {
    if std::env::var("FLANKWATCH_TEST_DATABASE").is_ok() {
        return;
    }
    let mut service = service();
    let mut socket = open(&service, "&first_index=0");
    socket.send(0, time_ns(0), &frames(0, 1500));
    socket.wait_for(1500);
    drop(socket);
    service.stop();
    for name in ["flankwatch.db", "flankwatch.db-wal", "flankwatch.db-shm"] {
        let _ = std::fs::remove_file(service.folder().join(name));
    }
    let journal = service.folder().join("streams/pump/main");
    service.launch();
    assert!(journal.is_dir());
    // An asset that somebody creates in its place later does not get the stream, nor removes it.
    service.clock.advance(60);
    service.post_json("/v1/assets", &asset(2.0, 10.0)).expect(201);
    assert_eq!(StreamSocket::open(&address(&service, ""), &[]).err(), Some(409));
    service.delete("/v1/assets/pump").expect(204);
    assert!(journal.is_dir());
    service.stop();
    flankwatch(&["rebuild", "--data-dir", service.folder().to_str().unwrap()]).expect_success();
    service.launch();
    assert_eq!(status(&service)["next"], 1500);
    let mut socket = open(&service, "");
    socket.send(1500, time_ns(1500), &frames(1500, 1500));
    socket.wait_for(3000);
    expect_samples(&service, &records(&service, "in", 1)[0], 0, 2000);
    // Without a doubt about the database, the journal is removed with its asset.
    service.delete("/v1/assets/pump").expect(204);
    assert!(!journal.exists());
}
