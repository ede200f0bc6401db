//! Live streams in a cluster: any node receives a stream, shows it and acts on it; a killed node loses
//! nothing that it acknowledged.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use super::client::Client;
use super::nodes::TestCluster;
use super::site::{Site, rounds};
use crate::event_stream::EventStream;
use crate::running::plain_asset;
use crate::stream_socket::{StreamSocket, frames};

const RATE_HZ: u64 = 1000;
/// 2026-01-01 in nanoseconds.
const BEGIN_NS: i64 = 1_767_225_600_000_000_000;

/// Samples of a message, and most samples that are sent and not acknowledged.
const CHUNK: u64 = 250;
const WINDOW: u64 = 3000;

/// Number of kills, if the faults are not repeated more often.
const KILLS: u32 = 5;

fn time_ns(index: u64) -> i64 {
    BEGIN_NS + (index * 1_000_000_000 / RATE_HZ) as i64
}

fn asset(stream: &Value) -> Value {
    let mut asset = plain_asset("pump");
    asset["stream"] = stream.clone();
    asset
}

fn open(client: &Client) -> StreamSocket {
    let path = format!("/v1/assets/pump/stream?sample=f32&sample_rate_hz={RATE_HZ}&first_index=0");
    StreamSocket::open(&format!("{}{path}", client.url), &[]).unwrap()
}

fn send(socket: &mut StreamSocket, first: u64, until: u64, loud_from: u64) {
    socket.send(first, time_ns(first), &frames(first, until - first, loud_from));
    assert_eq!(socket.wait_for(until), [[0; 2]; 0]);
}

/// Waits until all records of the stream are stored, and returns their first samples and lengths; their
/// samples must be those that were sent.
#[track_caller]
fn records(client: &Client, number: usize, loud_from: u64) -> Vec<(u64, u64)> {
    client.wait_for("/v1/assets/pump/stream", |status| {
        status["records_waiting"] == 0 && status["records"] == number
    });
    client.wait_for_segments("pump", number);
    let page = client.get("/v1/assets/pump/segments?limit=1000");
    let mut found = Vec::new();
    for record in page["items"].as_array().unwrap() {
        let time: jiff::Timestamp = record["start_time"].as_str().unwrap().parse().unwrap();
        let first = (time.as_nanosecond() - i128::from(BEGIN_NS)) as u64 * RATE_HZ / 1_000_000_000;
        let samples = record["samples"].as_u64().unwrap();
        let path = format!("{}/v1/segments/{}/raw", client.url, record["id"].as_str().unwrap());
        let raw = ureq::get(path).call().unwrap().body_mut().read_to_vec().unwrap();
        assert!(raw == frames(first, samples, loud_from), "samples from {first} on");
        found.push((first, samples));
    }
    found.sort_unstable();
    found
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn a_stream_is_the_same_through_any_node() {
    let cluster = TestCluster::start(2, 1);
    let (one, other) = (cluster.client(0), cluster.client(1));
    one.send_json("POST", "/v1/assets", &asset(&json!({ "record_s": 2, "interval_s": 10 })), 201);
    let mut socket = open(&one);
    send(&mut socket, 0, 3500, u64::MAX);
    let mut view = EventStream::open_path(&other.url, "/v1/assets/pump/stream/live", "");
    assert_eq!(view.next().data["next"], 3500);
    // More messages than between two checkpoints.
    for first in (3500..33_500).step_by(100) {
        socket.send(first, time_ns(first), &frames(first, 100, u64::MAX));
    }
    socket.wait_for(33_500);
    // A view follows through the other node.
    while view.next().data["next"] != 33_500 {}
    assert_eq!(records(&other, 4, u64::MAX), [(0, 2000), (10_000, 2000), (20_000, 2000), (30_000, 2000)]);
    for path in ["stream", "streams", "stream/levels", "segments?limit=1000"] {
        let path = format!("/v1/assets/pump/{path}");
        assert_eq!(one.get(&path), other.get(&path), "{path}");
    }
    let status = other.get("/v1/assets/pump/stream");
    assert_eq!((&status["next"], &status["gaps"]), (&json!(33_500), &json!(0)));
    assert_eq!(other.get("/v1/assets/pump/stream/levels")["items"].as_array().unwrap().len(), 33);

    // Through the other node than the sender's: its last seconds, and a campaign.
    let kept = other.send_json("POST", "/v1/assets/pump/stream/keep?seconds=1", &Value::Null, 200);
    assert_eq!(kept["samples"], 1000);
    records(&one, 5, u64::MAX);
    let path = "/v1/assets/pump/stream/campaign";
    let begun = other.send_json("POST", &format!("{path}?seconds=1000"), &Value::Null, 200);
    assert_eq!((&begun["is_running"], &begun["first"]), (&json!(true), &json!(33_500)));
    send(&mut socket, 33_500, 38_200, u64::MAX);
    assert_eq!(other.try_send("DELETE", path, "", b"").unwrap().0, 204);
    send(&mut socket, 38_200, 39_000, u64::MAX);
    let campaign = [(33_500, 2000), (35_500, 2000), (37_500, 700)];
    assert_eq!(records(&one, 8, u64::MAX)[5..], campaign);
    assert_eq!(one.get("/v1/assets/pump/stream"), other.get("/v1/assets/pump/stream"));
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn the_latest_sender_at_any_node_has_the_stream_until_its_asset_is_deleted() {
    let cluster = TestCluster::start(2, 1);
    let (one, other) = (cluster.client(0), cluster.client(1));
    let described = asset(&json!({ "record_s": 2, "interval_s": 0 }));
    one.send_json("POST", "/v1/assets", &described, 201);
    let mut old = open(&one);
    send(&mut old, 0, 1000, u64::MAX);
    let mut new = open(&other);
    assert_eq!(new.next, Some(1000));
    assert_eq!(old.receive().unwrap_err().0, 4409);
    send(&mut new, 1000, 1500, u64::MAX);
    // Back at the first node, whose memory of the stream is old.
    let mut newest = open(&one);
    assert_eq!(newest.next, Some(1500));
    // One that sends is told at once.
    new.send(1500, time_ns(1500), &frames(1500, 500, u64::MAX));
    assert_eq!(new.receive().unwrap_err().0, 4409);
    send(&mut newest, 1500, 3000, u64::MAX);
    assert_eq!(other.try_send("DELETE", "/v1/assets/pump", "", b"").unwrap().0, 204);
    assert!([4404, 4409].contains(&newest.receive().unwrap_err().0));
    one.send_json("POST", "/v1/assets", &described, 201);
    let mut again = open(&other);
    assert_eq!(again.next, Some(0));
    // It is created with its first sample.
    assert_eq!(one.get("/v1/assets/pump/streams")["items"], json!([]));
    send(&mut again, 0, 500, u64::MAX);
    assert_eq!(one.get("/v1/assets/pump/streams")["items"][0]["next"], 500);
    assert_eq!(one.try_send("DELETE", "/v1/assets/pump/stream", "", b"").unwrap().0, 204);
    assert_eq!(again.receive().unwrap_err().0, 4409);
    assert_eq!(other.get("/v1/assets/pump/streams")["items"], json!([]));
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn samples_around_an_alarm_of_a_worker_become_records_once() {
    let cluster = TestCluster::start(2, 1);
    let (one, other) = (cluster.client(0), cluster.client(1));
    let stream = json!({ "record_s": 2, "interval_s": 20, "on_alarm": { "before_s": 5, "after_s": 7 } });
    let mut described = asset(&stream);
    described["alarms"] = json!([{ "quantity": { "indicator": "rms" }, "warning": 5, "danger": 500,
        "settings": { "raise": 1, "raise_of": 1, "clear": 1, "clear_of": 1 } }]);
    one.send_json("POST", "/v1/assets", &described, 201);
    let mut socket = open(&one);
    send(&mut socket, 0, 22_500, 18_000);
    // From 17.5 s up to 29.5 s: two of them are complete, besides the two of the interval.
    records(&other, 4, 18_000);
    send(&mut socket, 22_500, 39_000, 18_000);
    let cut = [17_500, 19_500, 20_000, 21_500, 23_500, 25_500, 27_500].map(|first| (first, 2000));
    assert_eq!(records(&other, 8, 18_000), [&[(0, 2000)], &cut[..]].concat());
}

/// A sender that goes on at another node when its connection is lost.
struct Sender {
    socket: StreamSocket,
    next: u64,
    acknowledged: u64,
}

impl Sender {
    /// Continues at a node, from the index that it names.
    fn go_on(&mut self, client: &Client) {
        self.socket = open(client);
        self.next = self.socket.next.unwrap();
        assert!(self.next >= self.acknowledged, "{} of {} are there", self.next, self.acknowledged);
        self.acknowledged = self.next;
    }

    /// Sends until everything before an index is acknowledged; false if the connection is lost. `sent` gets
    /// the index after each message.
    fn send(&mut self, until: u64, mut sent: impl FnMut(u64)) -> bool {
        while self.acknowledged < until {
            if self.next < until && self.next < self.acknowledged + WINDOW {
                let samples = frames(self.next, CHUNK, u64::MAX);
                if !self.socket.try_send(self.next, time_ns(self.next), &samples) {
                    return false;
                }
                self.next += CHUNK;
                sent(self.next);
                continue;
            }
            let Ok(message) = self.socket.receive() else { return false };
            assert_eq!(message["type"], "ack");
            self.acknowledged = message["next"].as_u64().unwrap();
        }
        true
    }
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_stream_moves_to_another_node_when_its_own_is_killed() {
    let mut site = Site::start();
    let (config, mut random) = (site.config(None), ChaCha8Rng::seed_from_u64(20_260_103));
    let _worker = site.worker(&config);
    let (mut own, mut other) = (site.api(&config), site.api(&config));
    // All samples become records.
    own.client.send_json("POST", "/v1/assets", &asset(&json!({ "record_s": 1, "interval_s": 1 })), 201);
    let mut sender = Sender { socket: open(&own.client), next: 0, acknowledged: 0 };
    let kills = rounds().max(KILLS);
    for _ in 0..kills {
        let killed_at = sender.next + CHUNK * random.random_range(4..40);
        let is_there = sender.send(killed_at + 2 * WINDOW, |next| {
            if next == killed_at {
                own.process.kill();
            }
        });
        assert!(!is_there);
        sender.go_on(&other.client);
        own = std::mem::replace(&mut other, site.api(&config));
    }
    let end = (sender.next + WINDOW).next_multiple_of(RATE_HZ);
    assert!(sender.send(end, |_| {}));
    let status = own.client.get("/v1/assets/pump/stream");
    assert_eq!((&status["next"], &status["gap_samples"]), (&json!(end), &json!(0)));
    let expected: Vec<(u64, u64)> = (0..end / RATE_HZ).map(|k| (k * RATE_HZ, RATE_HZ)).collect();
    assert_eq!(records(&other.client, expected.len(), u64::MAX), expected);
    eprintln!("{kills} kills: {end} samples sent, all in {} records, each stored once", expected.len());
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn records_of_a_killed_node_are_stored_by_another_one() {
    let mut site = Site::start();
    let config = site.config(None);
    let _worker = site.worker(&config);
    let (mut own, other) = (site.api(&config), site.api(&config));
    own.client.send_json("POST", "/v1/assets", &asset(&json!({ "record_s": 1, "interval_s": 1 })), 201);
    let mut socket = open(&own.client);
    // All records of a minute are planned with its samples.
    send(&mut socket, 0, 60_000, u64::MAX);
    own.process.kill();
    let waiting = other.client.get("/v1/assets/pump/stream")["records_waiting"].as_u64().unwrap();
    assert!(waiting > 0, "all are stored already");
    let expected: Vec<(u64, u64)> = (0..60).map(|k| (k * RATE_HZ, RATE_HZ)).collect();
    assert_eq!(records(&other.client, 60, u64::MAX), expected);
}
