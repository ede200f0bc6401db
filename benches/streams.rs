//! Live streams into the release binary over loopback: `cargo bench --bench streams -- [seconds] [streams]`.
//!
//! 16 streams, by default, of 4 channels of 32-bit floats at 25.6 kHz, each of its own asset; 10 s of each minute become
//! records and are analysed. First in real time, for 60 s by default; then as fast as the service accepts them.
//! `FLANKWATCH_BENCH_PROGRAM` selects another binary than the one built. `FLANKWATCH_BENCH_CONFIG` is the
//! settings file of a cluster, one of whose nodes is then measured.

#[expect(dead_code, reason = "other benches use more of it")]
mod driven;

use std::net::TcpStream;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use driven::{Service, folder};
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

/// Default number of streams.
const STREAMS: usize = 16;
const CHANNELS: usize = 4;
const RATE_HZ: u64 = 25_600;

/// Frames per message: a tenth of a second.
const FRAMES: u64 = RATE_HZ / 10;

/// Data rate of a stream in real time, in MB/s.
const REAL_TIME_MB_PER_S: f64 = (CHANNELS * 4) as f64 * RATE_HZ as f64 / 1e6;

/// 2026-01-01 in nanoseconds.
const BEGIN_NS: u64 = 1_767_225_600_000_000_000;

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|word| word.parse::<f64>().ok());
    let seconds = numbers.next().unwrap_or(60.0);
    let streams = numbers.next().map_or(STREAMS, |streams| streams as usize);
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
    run("in real time", &service, &mut senders, seconds, true);
    run("at full speed", &service, &mut senders, seconds / 2.0, false);
    for (n, sender) in senders.iter().enumerate() {
        let state = service.get(&format!("/v1/assets/asset-{n}/stream"));
        assert_eq!(state["next"], sender.acknowledged, "every sent sample is stored");
        assert_eq!(state["gaps"], 0);
    }
}

/// A connection that sends a stream.
struct Sender {
    socket: WebSocket<TcpStream>,
    sent: u64,
    acknowledged: u64,
    samples: Vec<u8>,
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
        // A tenth of a second of noise, repeated.
        let mut state = n as u32 ^ 0x9E37_79B9;
        let samples = (0..FRAMES as usize * CHANNELS).flat_map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (f32::from((state >> 16) as u16) / 32_768.0 - 1.0).to_le_bytes()
        });
        let samples = samples.collect();
        let mut sender = Self { socket, sent: 0, acknowledged: 0, samples };
        sender.receive();
        sender
    }

    fn send(&mut self) {
        let time_ns = BEGIN_NS + self.sent * 1_000_000_000 / RATE_HZ;
        let message = [&self.sent.to_le_bytes()[..], &time_ns.to_le_bytes(), &self.samples].concat();
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

/// Sends for a number of seconds and prints the cost.
fn run(what: &str, service: &Service, senders: &mut [Sender], seconds: f64, is_paced: bool) {
    let resident_before = service.memory_mb("VmRSS");
    let (_, user_before, system_before) = service.used();
    let acknowledged_before: u64 = senders.iter().map(|sender| sender.acknowledged).sum();
    let (began, longest_us) = (Instant::now(), AtomicU64::new(0));
    std::thread::scope(|scope| {
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
    println!(
        "{what}: {took:.1} s, {mb_per_s:.2} MB/s, {:.2} times real time; {:.2} s of CPU a second ({:.2} of the \
         system); resident {resident_before:.0} MB before, {:.0} MB after; longest wait for a response {:.0} ms",
        mb_per_s / REAL_TIME_MB_PER_S / senders.len() as f64,
        (user + system - user_before - system_before) / took,
        (system - system_before) / took,
        service.memory_mb("VmRSS"),
        longest_us.into_inner() as f64 / 1e3,
    );
}
