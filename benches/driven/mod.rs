//! Shared code of the service benches: the release binary, driven over HTTP.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use flankwatch::recording::message::WaveformBlock;
use flankwatch::signal::Record;
use jiff::{SignedDuration, Timestamp};
use prost::Message;
use serde_json::{Value, json};

/// The binary.
pub(crate) const BINARY: &str = env!("CARGO_BIN_EXE_flankwatch");

/// Arguments of a single machine.
const SERVE: [&str; 3] = ["serve", "--listen", "127.0.0.1:0"];

const RATE_HZ: f64 = 20_000.0;

/// Samples of a record of 10 s.
pub(crate) const SAMPLES: usize = 200_000;

/// The release binary serving a folder of its own.
pub(crate) struct Service {
    pub(crate) child: Child,
    pub(crate) address: String,
    pub(crate) folder: PathBuf,
    agent: ureq::Agent,
}

impl Service {
    pub(crate) fn start(folder: &Path) -> Self {
        Self::start_as(&SERVE, folder)
    }

    /// Kills the service, and starts it again on its folder.
    pub(crate) fn restart(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        (self.child, self.address) = spawn(&SERVE, &self.folder);
    }

    /// Starts with these arguments and a folder.
    pub(crate) fn start_as(arguments: &[&str], folder: &Path) -> Self {
        let (child, address) = spawn(arguments, folder);
        let agent = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(600))).build();
        Self { child, address, folder: folder.to_owned(), agent: agent.into() }
    }

    pub(crate) fn get(&self, path: &str) -> Value {
        read_json(self.agent.get(format!("http://{}{path}", self.address)).call())
    }

    pub(crate) fn post(&self, path: &str, media_type: &str, body: &[u8]) -> Value {
        let url = format!("http://{}{path}", self.address);
        read_json(self.agent.post(url).content_type(media_type).send(body))
    }

    /// Creates an asset with a gear pair and waits for its library.
    pub(crate) fn make_asset(&self, id: &str) {
        self.post("/v1/assets", "application/json", described(id).to_string().as_bytes());
        while self.get(&format!("/v1/assets/{id}"))["summary"]["library_state"] != "ready" {
            std::thread::sleep(Duration::from_millis(20));
        }
        self.wait_until_idle();
    }

    /// Waits for the ensemble, which is simulated once per pair in the background and is not measured here.
    pub(crate) fn wait_until_idle(&self) {
        let mut before = f64::NEG_INFINITY;
        while self.used().1 > before + 0.02 {
            before = self.used().1;
            std::thread::sleep(Duration::from_secs(1));
        }
    }

    /// Returns an amount of memory in MB by its name in `/proc/PID/status`.
    pub(crate) fn memory_mb(&self, name: &str) -> f64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap_or_default();
        let value = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
        let kb: f64 =
            value.and_then(|text| text.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(f64::NAN);
        kb / 1024.0
    }

    /// Returns the peak resident memory in MB, and the user and system time in seconds.
    pub(crate) fn used(&self) -> (f64, f64, f64) {
        let proc = format!("/proc/{}", self.child.id());
        let stat = fs::read_to_string(format!("{proc}/stat")).unwrap_or_default();
        let fields: Vec<&str> = stat.rsplit(") ").next().unwrap_or_default().split(' ').collect();
        let ticks =
            |n: usize| fields.get(n).and_then(|text| text.parse::<f64>().ok()).unwrap_or(f64::NAN) / 100.0;
        (self.memory_mb("VmHWM"), ticks(11), ticks(12))
    }
}

/// Starts the program with these arguments and a folder. Returns it with its address, which is in its first
/// line of output.
fn spawn(arguments: &[&str], folder: &Path) -> (Child, String) {
    // Another version, for comparison.
    let program = std::env::var_os("FLANKWATCH_BENCH_PROGRAM").unwrap_or_else(|| BINARY.into());
    let mut child = Command::new(program)
        .args(arguments)
        .arg("--data-dir")
        .arg(folder)
        .env("FLANKWATCH_LOG", "warn")
        .stdout(Stdio::piped())
        .spawn()
        .expect("the release binary starts");
    let mut line = String::new();
    let mut out = BufReader::new(child.stdout.take().expect("its output is piped"));
    while !line.contains("http://") {
        line.clear();
        assert!(out.read_line(&mut line).expect("it speaks") > 0, "the service did not start");
    }
    let address = line.split("http://").nth(1).unwrap_or_default().trim().to_owned();
    (child, address)
}

/// Reads a response to its end.
fn read_json(answer: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> Value {
    let mut response = answer.expect("an answer");
    let body = response.body_mut().with_config().limit(1 << 30);
    serde_json::from_slice(&body.read_to_vec().expect("a whole answer")).expect("JSON")
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        // A folder that was given to the bench stays.
        if self.folder.starts_with(own_folders()) {
            let _ = fs::remove_dir_all(&self.folder);
        }
    }
}

/// Returns the description of an asset with a gear pair.
pub(crate) fn described(id: &str) -> Value {
    let pair: toml::Value =
        toml::from_str(include_str!("../../fixtures/pairs/shen2022.toml")).expect("the fixture is TOML");
    let mut asset = json!({ "id": id, "gear": { "pair": pair }, "sensor": { "unit": "m/s2" } });
    asset["gear"]["teeth"] = asset["gear"]["pair"]["geometry"]["teeth"].clone();
    asset["gear"]["shaft_speed_hz"] = asset["gear"]["pair"]["operation"]["shaft_speed_hz"].clone();
    asset
}

/// The parent of the folders that benches make and remove.
fn own_folders() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("target/bench")
}

pub(crate) fn folder(name: &str) -> PathBuf {
    let path = own_folders().join(format!("{name}-{}", std::process::id()));
    fs::create_dir_all(&path).expect("a folder for the bench");
    path
}

pub(crate) fn record(n: i64, samples: usize) -> Record {
    let start =
        "2026-01-01T00:00:00Z".parse::<Timestamp>().expect("a time") + SignedDuration::from_secs(60 * n);
    let mut state = n as u32 ^ 0x9E37_79B9;
    let samples = (0..samples).map(|k| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
        let phase = std::f64::consts::TAU * 400.0 * k as f64 / RATE_HZ;
        (phase.sin() + 0.5 * (2.0 * phase).sin() + 0.3 * noise) as f32
    });
    Record::new("1", start, RATE_HZ, "m/s2", samples.collect()).expect("finite samples")
}

/// Sends a request on a persistent connection and returns the status after the whole response.
pub(crate) fn exchange(stream: &mut BufReader<TcpStream>, head: &str, body: &[u8]) -> u16 {
    stream.get_mut().write_all(head.as_bytes()).expect("a connection");
    stream.get_mut().write_all(body).expect("a connection");
    let mut line = String::new();
    stream.read_line(&mut line).expect("an answer");
    let status = line.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0);
    let mut length = 0;
    loop {
        line.clear();
        stream.read_line(&mut line).expect("an answer");
        let header = line.trim().to_ascii_lowercase();
        if header.is_empty() {
            break;
        }
        if let Some(value) = header.strip_prefix("content-length:") {
            length = value.trim().parse().unwrap_or(0);
        }
    }
    let mut answer = vec![0; length];
    stream.read_exact(&mut answer).expect("a whole answer");
    status
}

pub(crate) fn connect(service: &Service) -> BufReader<TcpStream> {
    let stream = TcpStream::connect(&service.address).expect("a connection");
    stream.set_nodelay(true).expect("a connection");
    BufReader::new(stream)
}

/// Runs requests over concurrent connections, at a rate if given. Returns the total seconds and the sorted
/// latencies, each from the time when the request was due.
pub(crate) fn load(
    service: &Service,
    connections: usize,
    requests: usize,
    rate: Option<f64>,
    one: impl Fn(usize, &mut BufReader<TcpStream>) + Sync,
) -> (f64, Vec<f64>) {
    let next = AtomicUsize::new(0);
    let began = Instant::now();
    let work = || {
        let mut stream = connect(service);
        let mut times = Vec::new();
        loop {
            let n = next.fetch_add(1, Ordering::Relaxed);
            if n >= requests {
                return times;
            }
            let due = rate.map(|rate| Duration::from_secs_f64(n as f64 / rate));
            if let Some(due) = due {
                std::thread::sleep(due.saturating_sub(began.elapsed()));
            }
            let from = due.unwrap_or_else(|| began.elapsed());
            one(n, &mut stream);
            times.push((began.elapsed() - from).as_secs_f64());
        }
    };
    let mut times: Vec<f64> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..connections).map(|_| scope.spawn(work)).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("no panic")).collect()
    });
    let seconds = began.elapsed().as_secs_f64();
    times.sort_by(f64::total_cmp);
    (seconds, times)
}

/// Records with the same samples, each with another time and so another hash.
pub(crate) struct Uploads {
    body: Vec<u8>,
}

impl Uploads {
    /// Records of 10 s.
    pub(crate) fn new() -> Self {
        Self::of(SAMPLES)
    }

    pub(crate) fn of(samples: usize) -> Self {
        // Without time and channel, so that those of the query apply.
        let block = WaveformBlock {
            sample_rate_hz: RATE_HZ,
            unit: "m/s2".to_owned(),
            samples: record(0, samples).samples().to_vec(),
            ..Default::default()
        };
        Self { body: block.encode_to_vec() }
    }

    /// Sends record `n` to an asset, on a channel.
    pub(crate) fn send(&self, stream: &mut BufReader<TcpStream>, asset: &str, channel: usize, n: usize) {
        let start = "2026-01-01T00:00:00Z".parse::<Timestamp>().expect("a time")
            + SignedDuration::from_secs(60 * n as i64);
        let mut body = self.body.clone();
        // Appends a field that no reader knows.
        body.extend_from_slice(&[0xfd, 0x7f]);
        body.extend_from_slice(&(n as u32).to_le_bytes());
        let head = format!(
            "POST /v1/assets/{asset}/segments?start_time={start}&channel={channel} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/x-protobuf\r\ncontent-length: {}\r\n\r\n",
            body.len()
        );
        let status = exchange(stream, &head, &body);
        assert!(status == 201 || status == 202, "answered {status}");
    }
}
