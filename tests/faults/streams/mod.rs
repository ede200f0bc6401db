//! Live streams during kills, cut and half-open links, with reordered and repeated chunks from a clock that
//! drifts and jumps: the stored samples are those that were sent, by index, bit for bit.
//!
//! `FLANKWATCH_KILL_ROUNDS` sets how often each fault is repeated.

mod senders;

use std::path::Path;
use std::time::{Duration, Instant};

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::program::Program;
use crate::proxy::{End, Proxy};
use crate::running::plain_asset;
use crate::stream_socket::{SenderClock, StreamSocket, shuffled};

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

/// Returns the records of the first channel.
fn listed(program: &Program) -> Vec<Value> {
    let (mut items, mut cursor) = (Vec::new(), Some(String::new()));
    while let Some(from) = cursor {
        let page = program.get(&format!("/v1/assets/pump/segments?channel=1&limit=1000{from}"));
        items.extend(page["items"].as_array().unwrap().iter().cloned());
        cursor = page["next_cursor"].as_str().map(|next| format!("&cursor={next}"));
    }
    items
}

/// Waits for a number of records per channel and returns their raw bytes in time order.
fn stored(program: &Program, records: u64) -> Vec<u8> {
    let began = Instant::now();
    let mut items = loop {
        let items = listed(program);
        if items.len() as u64 >= records {
            break items;
        }
        assert!(began.elapsed() < Duration::from_secs(300), "{} records: {}", items.len(), program.log());
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(items.len() as u64, records);
    items.sort_by_key(start_time);
    let raw = |item: &Value| {
        let mut answer =
            program.send("GET", &format!("/v1/segments/{}/raw", item["id"].as_str().unwrap()), &[], b"");
        answer.body_mut().read_to_vec().unwrap()
    };
    items.iter().flat_map(raw).collect()
}

/// How a round ends.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    ServerKilled,
    /// The sender is gone between two messages.
    SenderGone,
    /// The link breaks, in the middle of a message too.
    LinkCut,
    /// The service does not know that the sender is gone, in the middle of a message too: the next connection
    /// takes over.
    HalfOpen,
}

const FAULTS: [Fault; 4] = [Fault::ServerKilled, Fault::SenderGone, Fault::LinkCut, Fault::HalfOpen];

#[test]
fn every_acknowledged_sample_is_stored_once_despite_faults_and_repeated_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2_121);
    let address = free_address();
    let mut program = start_at(folder.path(), &address);
    let proxy = Proxy::to(address.parse().unwrap());
    let url = format!("http://{}", proxy.address());
    program.make(&asset());
    let mut clock = SenderClock::new(time_ns(0), 4000.0);
    let (mut acknowledged, mut half_open) = (0, Vec::new());
    let (mut rests, mut cut_in_a_round) = (0, 0);
    let mut faults = FAULTS.repeat(rounds() as usize);
    faults.shuffle(&mut random);
    for fault in faults {
        let bytes = random.random_range(500..40_000);
        match fault {
            Fault::LinkCut => proxy.end_next_after(bytes, End::Cut),
            Fault::HalfOpen => proxy.end_next_after(bytes, End::HalfOpen),
            Fault::ServerKilled | Fault::SenderGone => {}
        }
        let mut socket = open(&url);
        let next = socket.next.unwrap();
        assert!(next >= acknowledged, "{next} is before {acknowledged}, which was acknowledged");
        rests += u64::from(next > acknowledged);
        acknowledged = next;
        // Without a stored sample, nothing says what the time was before a jump.
        if random.random_bool(0.25) && next > 0 {
            clock.jump(next, &mut random);
        }
        let mut sent = next;
        // Some chunks are acknowledged, some are in flight.
        for _ in 0..random.random_range(1..12) {
            let until = sent + random.random_range(1..3000);
            let mut send =
                |(first, count)| socket.try_send(first, clock.time_ns(first), &frames(first, count));
            let mut is_open = shuffled(sent, until, &mut random).into_iter().all(&mut send);
            sent = until;
            if fault == Fault::HalfOpen && (sent - next) * 8 > bytes as u64 {
                break;
            }
            if is_open && fault != Fault::HalfOpen && random.random_bool(0.5) {
                is_open = socket.try_wait_for(sent, &mut acknowledged);
            }
            if !is_open {
                assert_eq!(fault, Fault::LinkCut);
                cut_in_a_round += 1;
                break;
            }
        }
        match fault {
            Fault::ServerKilled => {
                program.kill();
                program = start_at(folder.path(), &address);
                half_open.clear();
            }
            Fault::SenderGone | Fault::LinkCut => drop(socket),
            Fault::HalfOpen => half_open.push(socket),
        }
    }
    let mut socket = open(&url);
    let next = socket.next.unwrap();
    assert!(next >= acknowledged);
    let end = (next / 2000 + 1) * 2000;
    socket.send(next, clock.time_ns(next), &frames(next, end - next));
    socket.wait_for(end);
    let records = end / 2000;
    assert!(stored(&program, records) == frames(0, end), "the stored samples are not those that were sent");
    let status = program.get("/v1/assets/pump/stream");
    assert_eq!((&status["gaps"], &status["records"]), (&json!(0), &json!(records)));
    // No jump of the clock moves a record.
    let mut times: Vec<jiff::Timestamp> = listed(&program).iter().map(start_time).collect();
    times.sort_unstable();
    for (n, time) in times.iter().enumerate() {
        let expected_ns = clock.true_ns(n as u64 * 2000);
        let error_s = (time.as_nanosecond() - i128::from(expected_ns)) as f64 / 1e9;
        assert!(error_s.abs() < 0.1, "record {n} is {error_s} s off");
    }
    assert!(rests > 0 && cut_in_a_round > 0, "no fault came in the middle: {rests}, {cut_in_a_round}");
    eprintln!(
        "{} rounds of each of {FAULTS:?}: {end} samples in {records} records; {cut_in_a_round} links cut \
         while sending, {rests} rounds with stored samples that were not acknowledged; the clock jumped {} \
         times, {} of them noticed",
        rounds(),
        clock.jumps(),
        status["clock_jumps"]
    );
    program.kill();
}

fn open(url: &str) -> StreamSocket {
    StreamSocket::open(&format!("{url}/v1/assets/pump/stream?{FORMAT}"), &[]).unwrap()
}

/// Returns an address for a program that is started several times.
fn free_address() -> String {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

fn start_time(record: &Value) -> jiff::Timestamp {
    record["start_time"].as_str().unwrap().parse().unwrap()
}

fn time_ns(index: u64) -> i64 {
    1_767_225_600_000_000_000 + (index * 250_000) as i64
}

/// Starts the program on the same address as before.
fn start_at(data: &Path, address: &str) -> Program {
    Program::start_with(data, &["--listen", address])
}
