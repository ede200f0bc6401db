//! A live stream through several nodes while the sender's node is killed, its link is cut or half open, its
//! chunks are reordered and repeated, and its clock drifts and jumps: the stored samples are those that were
//! sent, by index, bit for bit.
//!
//! `FLANKWATCH_FAULT_ROUNDS` sets how often each fault is repeated.

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use super::client::Client;
use super::processes::Program;
use super::site::{Site, rounds};
use crate::proxy::{End, Proxy};
use crate::running::plain_asset;
use crate::stream_socket::{SenderClock, StreamSocket, frames, shuffled};

const RATE_HZ: u64 = 1000;
/// 2026-01-01 in nanoseconds.
const BEGIN_NS: i64 = 1_767_225_600_000_000_000;

/// How a round ends.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    NodeKilled,
    /// The link breaks, in the middle of a message too.
    LinkCut,
    /// The node does not know that the sender is gone, in the middle of a message too.
    HalfOpen,
}

const FAULTS: [Fault; 3] = [Fault::NodeKilled, Fault::LinkCut, Fault::HalfOpen];

/// A node behind a link.
struct Node {
    program: Program,
    link: Proxy,
}

impl Node {
    fn start(site: &mut Site, config: &std::path::Path) -> Self {
        let program = site.api(config);
        let address = program.client.url.trim_start_matches("http://").parse().unwrap();
        Self { link: Proxy::to(address), program }
    }

    fn open(&self) -> StreamSocket {
        let path = format!("/v1/assets/pump/stream?sample=f32&sample_rate_hz={RATE_HZ}&first_index=0");
        StreamSocket::open(&format!("http://{}{path}", self.link.address()), &[]).unwrap()
    }
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_stream_through_faulty_links_and_nodes_has_every_sample_once() {
    let mut site = Site::start();
    let (config, mut random) = (site.config(None), ChaCha8Rng::seed_from_u64(20_260_104));
    let _worker = site.worker(&config);
    let (mut own, mut other) = (Node::start(&mut site, &config), Node::start(&mut site, &config));
    let mut asset = plain_asset("pump");
    // All samples become records.
    asset["stream"] = json!({ "record_s": 2, "interval_s": 2 });
    own.program.client.send_json("POST", "/v1/assets", &asset, 201);
    let mut clock = SenderClock::new(BEGIN_NS, RATE_HZ as f64);
    let (mut acknowledged, mut half_open) = (0, Vec::new());
    let mut faults = FAULTS.repeat(rounds() as usize);
    faults.shuffle(&mut random);
    for fault in faults {
        let bytes = random.random_range(500..20_000);
        match fault {
            Fault::LinkCut => own.link.end_next_after(bytes, End::Cut),
            Fault::HalfOpen => own.link.end_next_after(bytes, End::HalfOpen),
            Fault::NodeKilled => {}
        }
        let mut socket = own.open();
        let next = socket.next.unwrap();
        assert!(next >= acknowledged, "{next} is before {acknowledged}, which was acknowledged");
        acknowledged = next;
        // Without a stored sample, nothing says what the time was before a jump.
        if random.random_bool(0.25) && next > 0 {
            clock.jump(next, &mut random);
        }
        let mut sent = next;
        // Some chunks are acknowledged, some are in flight.
        for _ in 0..random.random_range(1..8) {
            let until = sent + random.random_range(1..1500);
            let mut is_open = shuffled(sent, until, &mut random).into_iter().all(|(first, count)| {
                socket.try_send(first, clock.time_ns(first), &frames(first, count, u64::MAX))
            });
            sent = until;
            if fault == Fault::HalfOpen && (sent - next) * 4 > bytes as u64 {
                break;
            }
            if is_open && fault != Fault::HalfOpen && random.random_bool(0.5) {
                is_open = socket.try_wait_for(sent, &mut acknowledged);
            }
            if !is_open {
                assert_eq!(fault, Fault::LinkCut);
                break;
            }
        }
        match fault {
            Fault::NodeKilled => {
                own.program.process.kill();
                own = Node::start(&mut site, &config);
                half_open.clear();
            }
            Fault::LinkCut => drop(socket),
            Fault::HalfOpen => half_open.push(socket),
        }
        // The next sender is at any node.
        if random.random_bool(0.5) {
            std::mem::swap(&mut own, &mut other);
        }
    }
    let mut socket = own.open();
    let next = socket.next.unwrap();
    assert!(next >= acknowledged);
    let end = (next / 2000 + 1) * 2000;
    socket.send(next, clock.time_ns(next), &frames(next, end - next, u64::MAX));
    socket.wait_for(end);
    check_records(&other.program.client, &clock, end);
    eprintln!(
        "{} rounds of each of {FAULTS:?}: {end} samples, {} jumps of the clock",
        rounds(),
        clock.jumps()
    );
}

/// Waits for the records of all samples before an index, and compares them with what was sent.
fn check_records(client: &Client, clock: &SenderClock, end: u64) {
    let number = end / 2000;
    let status = client.wait_for("/v1/assets/pump/stream", |status| {
        status["records_waiting"] == 0 && status["records"] == number
    });
    assert_eq!(status["gaps"], 0);
    client.wait_for_segments("pump", number);
    let page = client.get("/v1/assets/pump/segments?limit=1000");
    let mut records = page["items"].as_array().unwrap().clone();
    assert_eq!(records.len() as u64, number);
    let time = |record: &Value| record["start_time"].as_str().unwrap().parse::<jiff::Timestamp>().unwrap();
    records.sort_by_key(time);
    for (record, first) in records.iter().zip((0..).step_by(2000)) {
        let url = format!("{}/v1/segments/{}/raw", client.url, record["id"].as_str().unwrap());
        let raw = ureq::get(url).call().unwrap().body_mut().read_to_vec().unwrap();
        assert!(raw == frames(first, 2000, u64::MAX), "samples from {first} on");
        // No jump of the clock moves a record.
        let error_s = (time(record).as_nanosecond() - i128::from(clock.true_ns(first))) as f64 / 1e9;
        assert!(error_s.abs() < 0.1, "the record from {first} on is {error_s} s off");
    }
}
