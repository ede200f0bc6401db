//! Live streams into the release binary over loopback:
//! `cargo bench --bench streams -- [seconds] [streams] [seconds at full speed]`.
//!
//! 16 streams, by default, of 4 channels of 32-bit floats at 25.6 kHz, each of its own asset; 10 s of each
//! minute become records and are analysed. First in real time, for 60 s by default; then as fast as the
//! service accepts them, by default for half as long. At the end every record must be where the policy of the
//! asset says, with the samples that were sent. `FLANKWATCH_BENCH_PROGRAM` selects another binary than the
//! one built. `FLANKWATCH_BENCH_CONFIG` is the settings file of a cluster, one of whose nodes is then
//! measured.

#[expect(dead_code, reason = "other benches use more of it")]
mod driven;

use std::net::TcpStream;
use std::process::Command;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use driven::{Service, folder};
use jiff::Timestamp;
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

/// Default number of streams.
const STREAMS: usize = 16;
const CHANNELS: usize = 4;
const RATE_HZ: u64 = 25_600;

/// Frames per message: a tenth of a second.
const FRAMES: u64 = RATE_HZ / 10;

/// Length of a record and time from the beginning of one to that of the next, in seconds: the default policy.
const RECORD_S: u64 = 10;
const INTERVAL_S: u64 = 60;

/// Data rate of a stream in real time, in MB/s.
const REAL_TIME_MB_PER_S: f64 = (CHANNELS * 4) as f64 * RATE_HZ as f64 / 1e6;

/// 2026-01-01 in nanoseconds.
const BEGIN_NS: u64 = 1_767_225_600_000_000_000;

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|word| word.parse::<f64>().ok());
    let seconds = numbers.next().unwrap_or(60.0);
    let streams = numbers.next().map_or(STREAMS, |streams| streams as usize);
    let seconds_at_full_speed = numbers.next().unwrap_or(seconds / 2.0);
    let service = match std::env::var("FLANKWATCH_BENCH_CONFIG") {
        Ok(config) => {
            let arguments = ["serve", "--listen", "127.0.0.1:0", "--config", config.as_str()];
            Service::start_as(&arguments, &folder("streams"))
        }
        Err(_) => Service::start(&folder("streams")),
    };
    for n in 0..streams {
        let asset = json!({
            "id": format!("asset-{n}"),
            "gear": { "teeth": [31, 62], "shaft_speed_hz": 20.0 },
            "sensor": { "unit": "m/s2" },
        });
        service.post("/v1/assets", "application/json", asset.to_string().as_bytes());
    }
    service.wait_until_idle();
    println!(
        "{streams} streams of {CHANNELS} channels at {RATE_HZ} Hz, f32: {:.2} MB/s in real time",
        streams as f64 * REAL_TIME_MB_PER_S
    );
    let mut senders: Vec<Sender> = (0..streams).map(|n| Sender::open(&service, n)).collect();
    let (_, cores) = run("in real time", &service, &mut senders, seconds, true);
    println!(
        "one stream costs {:.2} % of a core: {:.0} streams take one core",
        100.0 * cores / streams as f64,
        streams as f64 / cores
    );
    let (times, _) = run("at full speed", &service, &mut senders, seconds_at_full_speed, false);
    println!("real time allows {:.0} streams on this machine, beside their senders", times * streams as f64);
    for (n, sender) in senders.iter().enumerate() {
        let state = service.get(&format!("/v1/assets/asset-{n}/stream"));
        assert_eq!(state["next"], sender.acknowledged, "every sent sample is stored");
        assert_eq!(state["gaps"], 0);
    }
    let records: u64 = (0..streams).map(|n| check_records(&service, n, &senders[n])).sum();
    println!(
        "{records} records of {CHANNELS} channels, {RECORD_S} s from the beginning of each {INTERVAL_S} s"
    );
    stop(service);
}

/// Ends the program in order, so that a tool around it can report.
fn stop(mut service: Service) {
    let asked = Command::new("kill").arg(service.child.id().to_string()).status();
    assert!(asked.is_ok_and(|status| status.success()), "the program is gone");
    service.child.wait().expect("it ends");
}

/// Checks that the records of a stream are those of the policy, with the samples that were sent. Returns
/// their number; those of all channels count as one.
fn check_records(service: &Service, n: usize, sender: &Sender) -> u64 {
    let path = format!("/v1/assets/asset-{n}/stream");
    while service.get(&path)["records_waiting"] != 0 {
        std::thread::sleep(Duration::from_millis(50));
    }
    let records = (0..).take_while(|k| (k * INTERVAL_S + RECORD_S) * RATE_HZ <= sender.sent).count() as u64;
    let state = service.get(&path);
    assert_eq!((&state["records"], &state["records_refused"]), (&json!(records), &json!(0)));
    for channel in 1..=CHANNELS {
        let (mut listed, mut cursor) = (Vec::new(), Some(String::new()));
        while let Some(from) = cursor {
            let query = format!("limit=1000&channel={channel}{from}");
            let page = service.get(&format!("/v1/assets/asset-{n}/segments?{query}"));
            listed.extend(page["items"].as_array().expect("a page").iter().cloned());
            cursor = page["next_cursor"].as_str().map(|next| format!("&cursor={next}"));
        }
        let mut begins: Vec<u64> = Vec::new();
        for record in &listed {
            let time: Timestamp = record["start_time"].as_str().unwrap_or_default().parse().expect("a time");
            let since_ns = time.as_nanosecond() - i128::from(BEGIN_NS);
            begins.push((since_ns as f64 / 1e9 * RATE_HZ as f64).round() as u64);
            assert_eq!(record["samples"], RECORD_S * RATE_HZ);
        }
        // The object of all channels.
        for (record, first) in listed.iter().zip(&begins).filter(|_| channel == 1) {
            let messages = (0..RECORD_S * RATE_HZ).step_by(FRAMES as usize);
            let sent: Vec<u8> = messages.flat_map(|after| sender.samples(first + after)).collect();
            let id = record["id"].as_str().expect("an identifier");
            let url = format!("http://{}/v1/segments/{id}/raw", service.address);
            let mut answer = ureq::get(url).call().expect("an answer");
            let stored = answer.body_mut().read_to_vec().expect("a whole answer");
            assert!(stored == sent, "the samples of {id}");
        }
        begins.sort_unstable();
        let expected: Vec<u64> = (0..records).map(|k| k * INTERVAL_S * RATE_HZ).collect();
        assert_eq!(begins, expected, "channel {channel} of stream {n}");
    }
    records
}

/// A connection that sends a stream.
struct Sender {
    socket: WebSocket<TcpStream>,
    sent: u64,
    acknowledged: u64,
    /// Of a message.
    noise: Vec<u8>,
}

impl Sender {
    fn open(service: &Service, n: usize) -> Self {
        let stream = TcpStream::connect(&service.address).expect("a connection");
        stream.set_nodelay(true).expect("a connection");
        let url = format!(
            "ws://{}/v1/assets/asset-{n}/stream?sample=f32&sample_rate_hz={RATE_HZ}&channels={CHANNELS}&first_index=0",
            service.address
        );
        let (socket, _) = tungstenite::client(url, stream).expect("a stream");
        let mut state = n as u32 ^ 0x9E37_79B9;
        let noise = (0..FRAMES as usize * CHANNELS).flat_map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (f32::from((state >> 16) as u16) / 32_768.0 - 1.0).to_le_bytes()
        });
        let mut sender = Self { socket, sent: 0, acknowledged: 0, noise: noise.collect() };
        sender.receive();
        sender
    }

    /// The samples of a message from an index on: noise, after the number of the message. So no record has
    /// the samples of another one.
    fn samples(&self, first: u64) -> Vec<u8> {
        let number = (first / FRAMES) as f32;
        [&number.to_le_bytes(), &self.noise[4..]].concat()
    }

    fn send(&mut self) {
        let time_ns = BEGIN_NS + self.sent * 1_000_000_000 / RATE_HZ;
        let message =
            [&self.sent.to_le_bytes()[..], &time_ns.to_le_bytes(), &self.samples(self.sent)].concat();
        self.socket.send(Message::Binary(message.into())).expect("the service takes it");
        self.sent += FRAMES;
    }

    /// Receives one message of the service.
    fn receive(&mut self) {
        let message = self.socket.read().expect("the service speaks");
        if let Message::Text(text) = message {
            let message: Value = serde_json::from_str(text.as_str()).expect("JSON");
            assert_ne!(message["type"], "gap", "samples were lost: {message}");
            self.acknowledged = message["next"].as_u64().unwrap_or(self.acknowledged);
        }
    }
}

/// Sends for a number of seconds and prints the cost, with the memory after each tenth of the time. Returns
/// how many times faster than real time it was, and the processor seconds of the service in a second.
fn run(what: &str, service: &Service, senders: &mut [Sender], seconds: f64, is_paced: bool) -> (f64, f64) {
    let resident_before = service.memory_mb("VmRSS");
    let (_, user_before, system_before) = service.used();
    let acknowledged_before: u64 = senders.iter().map(|sender| sender.acknowledged).sum();
    let (began, longest_us) = (Instant::now(), AtomicU64::new(0));
    let mut resident = Vec::new();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for tenth in 1..10 {
                let due = Duration::from_secs_f64(seconds * f64::from(tenth) / 10.0);
                std::thread::sleep(due.saturating_sub(began.elapsed()));
                resident.push(format!("{:.0}", service.memory_mb("VmRSS")));
            }
        });
        for sender in senders.iter_mut() {
            scope.spawn(|| {
                let mut messages = 0_u32;
                while began.elapsed().as_secs_f64() < seconds {
                    messages += 1;
                    if is_paced {
                        let due = Duration::from_secs_f64(f64::from(messages) / 10.0);
                        std::thread::sleep(due.saturating_sub(began.elapsed()));
                    }
                    let sent_at = Instant::now();
                    sender.send();
                    // At most a second ahead of the acknowledgements, unless paced.
                    while sender.acknowledged + if is_paced { 0 } else { RATE_HZ } < sender.sent {
                        sender.receive();
                    }
                    longest_us.fetch_max(sent_at.elapsed().as_micros() as u64, Ordering::Relaxed);
                }
                while sender.acknowledged < sender.sent {
                    sender.receive();
                }
            });
        }
    });
    let took = began.elapsed().as_secs_f64();
    let acknowledged: u64 =
        senders.iter().map(|sender| sender.acknowledged).sum::<u64>() - acknowledged_before;
    let mb_per_s = acknowledged as f64 * (CHANNELS * 4) as f64 / 1e6 / took;
    let (_, user, system) = service.used();
    let times = mb_per_s / REAL_TIME_MB_PER_S / senders.len() as f64;
    let cores = (user + system - user_before - system_before) / took;
    resident.push(format!("{:.0}", service.memory_mb("VmRSS")));
    println!(
        "{what}: {took:.1} s, {mb_per_s:.2} MB/s, {times:.2} times real time; {cores:.2} s of CPU a second \
         ({:.2} of the system); resident {resident_before:.0} MB before, {} MB after each tenth; longest \
         wait for a response {:.0} ms",
        (system - system_before) / took,
        resident.join(", "),
        longest_us.into_inner() as f64 / 1e3,
    );
    (times, cores)
}
