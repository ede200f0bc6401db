//! Live streams while the receiving or the sending program is killed: the stored samples are those that were
//! sent, by index, bit for bit.

use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::program::Program;
use crate::running::plain_asset;
use crate::stream_socket::StreamSocket;

/// Default number of rounds.
const ROUNDS: u64 = 5;

const FORMAT: &str = "sample=f32&sample_rate_hz=4000&channels=2&first_index=0";

fn rounds() -> u64 {
    std::env::var("FLANKWATCH_KILL_ROUNDS").map_or(ROUNDS, |rounds| rounds.parse().unwrap())
}

fn frames(first: u64, count: u64) -> Vec<u8> {
    let value = |k: u64| (k.wrapping_mul(2_654_435_761) % 65_521) as f32 / 1000.0 - 32.0;
    (first..first + count).flat_map(|k| [value(k), -value(k + 7)]).flat_map(f32::to_le_bytes).collect()
}

/// Creates an asset whose streams are cut into records without gaps.
fn asset() -> Value {
    let mut asset = plain_asset("pump");
    asset["stream"] = json!({ "record_s": 0.5, "interval_s": 0.5 });
    asset
}

/// Waits for a number of records per channel and returns their raw bytes in time order.
fn stored(program: &Program, records: u64) -> Vec<u8> {
    let path = "/v1/assets/pump/segments?channel=1&limit=1000";
    let began = Instant::now();
    let mut items = loop {
        let items = program.get(path)["items"].as_array().unwrap().clone();
        if items.len() as u64 >= records {
            break items;
        }
        assert!(began.elapsed() < Duration::from_secs(300), "{} records: {}", items.len(), program.log());
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(items.len() as u64, records);
    items.sort_by_key(|item| item["start_time"].as_str().unwrap().parse::<jiff::Timestamp>().unwrap());
    let raw = |item: &Value| {
        let mut answer =
            program.send("GET", &format!("/v1/segments/{}/raw", item["id"].as_str().unwrap()), &[], b"");
        answer.body_mut().read_to_vec().unwrap()
    };
    items.iter().flat_map(raw).collect()
}

#[test]
fn every_acknowledged_sample_is_stored_once_despite_kills_and_repeated_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2_121);
    let mut program = Program::start(folder.path());
    program.make(&asset());
    let (mut acknowledged, mut half_open) = (0, Vec::new());
    for round in 0..rounds() {
        let mut socket = open(&program);
        let next = socket.next.unwrap();
        assert!(next >= acknowledged, "{next} is before {acknowledged}, which was acknowledged");
        acknowledged = next;
        let mut sent = next;
        // Some chunks are acknowledged, some are in flight.
        for _ in 0..random.random_range(1..12) {
            let until = sent + random.random_range(1..3000);
            for (first, count) in shuffled(sent, until, &mut random) {
                socket.send(first, time_ns(first), &frames(first, count));
            }
            sent = until;
            if random.random_bool(0.5) {
                assert_eq!(socket.wait_for(sent), [[0; 2]; 0]);
                acknowledged = sent;
            }
        }
        match round % 3 {
            0 => {
                program.kill();
                program = Program::start(folder.path());
                half_open.clear();
            }
            // The sender disconnects without closing the connection.
            1 => drop(socket),
            // The service does not know that the sender is gone: the next connection takes over.
            _ => half_open.push(socket),
        }
    }
    let mut socket = open(&program);
    let next = socket.next.unwrap();
    assert!(next >= acknowledged);
    let end = (next / 2000 + 1) * 2000;
    socket.send(next, time_ns(next), &frames(next, end - next));
    socket.wait_for(end);
    assert!(
        stored(&program, end / 2000) == frames(0, end),
        "the stored samples are not those that were sent"
    );
    assert_eq!(program.get("/v1/assets/pump/stream")["gaps"], 0);
    program.kill();
}

/// Cuts samples into chunks in random order, some of them repeated or overlapping.
fn shuffled(from: u64, until: u64, random: &mut ChaCha8Rng) -> Vec<(u64, u64)> {
    let (mut chunks, mut first) = (Vec::new(), from);
    while first < until {
        let count = random.random_range(1..1000).min(until - first);
        chunks.push((first, count));
        if random.random_bool(0.3) {
            let back = random.random_range(0..200).min(first);
            chunks.push((first - back, count));
        }
        first += count;
    }
    chunks.shuffle(random);
    chunks
}

#[test]
fn a_sender_killed_at_random_moments_resumes_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2_122);
    let program = Program::start(&folder.path().join("data"));
    program.make(&asset());
    let path = folder.path().join("samples.raw");
    let mut file = std::fs::File::create(&path).unwrap();
    let send = |more: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_flankwatch"))
            .arg("stream")
            .arg(&path)
            .args(["--asset", "pump", "--url", program.url(), "--sample", "f32", "--rate", "4000"])
            .args(["--channels", "2", "--start-time", "1970-01-01T00:00:00Z"])
            .args(more)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    };
    let mut written = 0;
    for _ in 0..rounds() {
        let mut child = send(&["--follow"]);
        for _ in 0..4 {
            let count = random.random_range(1..8000);
            file.write_all(&frames(written, count)).unwrap();
            written += count;
            std::thread::sleep(Duration::from_millis(random.random_range(0..150)));
        }
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let end = (written / 2000 + 1) * 2000;
    file.write_all(&frames(written, end - written)).unwrap();
    assert!(send(&[]).wait().unwrap().success());
    assert!(
        stored(&program, end / 2000) == frames(0, end),
        "the stored samples are not those that were sent"
    );
    program.kill();
}

fn open(program: &Program) -> StreamSocket {
    StreamSocket::open(&format!("{}/v1/assets/pump/stream?{FORMAT}", program.url()), &[]).unwrap()
}

fn time_ns(index: u64) -> i64 {
    1_767_225_600_000_000_000 + (index * 250_000) as i64
}

/// Starts `flankwatch stream` with raw samples from standard input.
fn sender(url: &str, spool: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_flankwatch"))
        .args(["stream", "-", "--asset", "pump", "--url", url, "--sample", "f32", "--rate", "4000"])
        .args(["--channels", "2", "--start-time", "1970-01-01T00:00:00Z", "--spool"])
        .arg(spool)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

#[test]
fn a_sender_resumes_when_its_server_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let spool = folder.path().join("spool");
    let data = folder.path().join("data");
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    drop(listener);
    let program = start_at(&data, &address);
    program.make(&asset());
    let mut child = sender(program.url(), &spool);
    let mut pipe = child.stdin.take().unwrap();
    pipe.write_all(&frames(0, 6000)).unwrap();
    let kept = |program: &Program, next: u64| {
        let began = Instant::now();
        while program.get("/v1/assets/pump/streams")["items"][0]["next"] != next {
            assert!(began.elapsed() < Duration::from_secs(100), "{}", program.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    kept(&program, 6000);
    program.kill();
    // More than fits in memory.
    pipe.write_all(&frames(6000, 534_000)).unwrap();
    let program = start_at(&data, &address);
    kept(&program, 540_000);
    drop(pipe);
    assert!(child.wait().unwrap().success());
    let left =
        std::fs::read_dir(&spool).unwrap().flatten().filter(|entry| entry.path().extension().is_some());
    assert_eq!(left.count(), 0);
    assert!(stored(&program, 270) == frames(0, 540_000), "the stored samples are not those that were sent");
    program.kill();
}

/// Starts the program on the same address as before.
fn start_at(data: &Path, address: &str) -> Program {
    Program::start_with(data, &["--listen", address])
}
