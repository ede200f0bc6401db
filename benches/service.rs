//! The service under load, driven as the release binary: `cargo bench --bench service -- [replay|uploads|polling|growth]`.
//!
//! Every figure stands beside a reference from the same run: writing and syncing the same bytes as plain files. The recording for the
//! replay is made once by `flankwatch simulate` into `target/bench` (or is the file that `FLANKWATCH_BENCH_RUN` names).

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use flankwatch::recording::message::WaveformBlock;
use flankwatch::recording::{BlockEncoding, McapOptions, McapWriter, encode_block};
use flankwatch::signal::Record;
use jiff::{SignedDuration, Timestamp};
use prost::Message;
use serde_json::{Value, json};

const BINARY: &str = env!("CARGO_BIN_EXE_flankwatch");
const RATE_HZ: f64 = 20_000.0;
const SAMPLES: usize = 200_000;
const RECORD_BYTES: usize = 4 * SAMPLES;

fn main() {
    let asked: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let wanted = |name: &str| asked.is_empty() || asked.iter().any(|word| word == name);
    if wanted("replay") {
        replay();
    }
    if wanted("uploads") {
        uploads();
    }
    if wanted("polling") {
        polling();
    }
    if wanted("growth") {
        growth();
    }
}

/// The release binary serving a folder of its own.
struct Service {
    child: Child,
    address: String,
    folder: PathBuf,
    agent: ureq::Agent,
}

impl Service {
    fn start(folder: &Path) -> Self {
        let mut child = Command::new(BINARY)
            .args(["serve", "--listen", "127.0.0.1:0", "--data-dir"])
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
        let agent = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(600))).build();
        Self {
            child,
            address,
            folder: folder.to_owned(),
            agent: agent.into(),
        }
    }

    fn get(&self, path: &str) -> Value {
        let mut response = self.agent.get(format!("http://{}{path}", self.address)).call().expect("an answer");
        let bytes = response
            .body_mut()
            .with_config()
            .limit(1 << 30)
            .read_to_vec()
            .expect("a whole answer");
        serde_json::from_slice(&bytes).expect("JSON")
    }

    fn post(&self, path: &str, media_type: &str, body: &[u8]) -> Value {
        let url = format!("http://{}{path}", self.address);
        let mut response = self.agent.post(url).content_type(media_type).send(body).expect("an answer");
        let bytes = response
            .body_mut()
            .with_config()
            .limit(1 << 30)
            .read_to_vec()
            .expect("a whole answer");
        serde_json::from_slice(&bytes).expect("JSON")
    }

    fn make_asset(&self, id: &str) {
        let pair: toml::Value = toml::from_str(include_str!("../fixtures/pairs/shen2022.toml")).expect("the fixture is TOML");
        let asset = json!({ "id": id, "gear": { "teeth": [24, 36], "shaft_speed_hz": 16.6, "pair": pair }, "sensor": { "unit": "m/s2" } });
        let teeth = asset["gear"]["pair"]["geometry"]["teeth"].clone();
        let speed = asset["gear"]["pair"]["operation"]["shaft_speed_hz"].clone();
        let mut asset = asset;
        asset["gear"]["teeth"] = teeth;
        asset["gear"]["shaft_speed_hz"] = speed;
        self.post("/v1/assets", "application/json", asset.to_string().as_bytes());
        while self.get(&format!("/v1/assets/{id}"))["summary"]["library_state"] != "ready" {
            std::thread::sleep(Duration::from_millis(20));
        }
        // Variants of the pair are simulated in the background, once for each pair: not what is measured here.
        let mut before = f64::NEG_INFINITY;
        while self.used().1 > before + 0.02 {
            before = self.used().1;
            std::thread::sleep(Duration::from_secs(1));
        }
    }

    /// Greatest resident memory in MB, and user and system time in seconds, so far.
    fn used(&self) -> (f64, f64, f64) {
        let proc = format!("/proc/{}", self.child.id());
        let status = fs::read_to_string(format!("{proc}/status")).unwrap_or_default();
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let peak_kb: f64 = peak
            .and_then(|text| text.trim().trim_end_matches(" kB").parse().ok())
            .unwrap_or(f64::NAN);
        let stat = fs::read_to_string(format!("{proc}/stat")).unwrap_or_default();
        let fields: Vec<&str> = stat.rsplit(") ").next().unwrap_or_default().split(' ').collect();
        let ticks = |n: usize| fields.get(n).and_then(|text| text.parse::<f64>().ok()).unwrap_or(f64::NAN) / 100.0;
        (peak_kb / 1024.0, ticks(11), ticks(12))
    }

    /// Forgets the greatest resident memory of before.
    fn reset_peak(&self) {
        let _ = fs::write(format!("/proc/{}/clear_refs", self.child.id()), "5");
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = fs::remove_dir_all(&self.folder);
    }
}

fn folder(name: &str) -> PathBuf {
    let target = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/bench");
    let path = target.join(format!("{name}-{}", std::process::id()));
    fs::create_dir_all(&path).expect("a folder for the bench");
    path
}

/// Seconds to write and sync these bytes as plain files, one after the other.
fn plain(folder: &Path, count: usize, bytes: &[u8]) -> f64 {
    let began = Instant::now();
    for n in 0..count {
        let mut file = File::create(folder.join(format!("plain-{n}"))).expect("a file");
        file.write_all(bytes).expect("room");
        file.sync_all().expect("synced");
    }
    let seconds = began.elapsed().as_secs_f64();
    for n in 0..count {
        let _ = fs::remove_file(folder.join(format!("plain-{n}")));
    }
    seconds
}

fn recording() -> PathBuf {
    if let Some(given) = std::env::var_os("FLANKWATCH_BENCH_RUN") {
        return given.into();
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/bench/run.mcap");
    if !path.exists() {
        fs::create_dir_all(path.parent().expect("a folder above")).expect("a folder for the recording");
        println!("simulating {} (once)", path.display());
        let done = Command::new(BINARY)
            .args(["simulate", "--records", "600", "--seconds", "10", "--rate", "20000", "--out"])
            .arg(&path)
            .status();
        assert!(done.expect("the release binary").success());
    }
    path
}

/// 600 records of 10 s at 20 kHz from an MCAP file through decoding, indicators, wear and storage.
fn replay() {
    let folder = folder("replay");
    fs::create_dir_all(folder.join("recordings")).expect("a folder");
    fs::copy(recording(), folder.join("recordings/run.mcap")).expect("the recording");
    let service = Service::start(&folder);
    service.make_asset("pump");
    service.reset_peak();
    let (_, user_before, system_before) = service.used();
    let reference = plain(&folder, 100, &vec![7; RECORD_BYTES]) / 100.0;
    let began = Instant::now();
    let replay = service.post(
        "/v1/replays",
        "application/json",
        br#"{"asset":"pump","file":"run.mcap","pace":"max"}"#,
    );
    let path = format!("/v1/replays/{}", replay["id"].as_str().expect("an id"));
    let ended = loop {
        let replay = service.get(&path);
        if replay["state"] != "running" {
            break replay;
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    let seconds = began.elapsed().as_secs_f64();
    let (peak_mb, user, system) = service.used();
    let records = ended["stored"].as_f64().unwrap_or(0.0);
    let recorded = ended["record_seconds_done"].as_f64().unwrap_or(0.0);
    println!(
        "replay: {records} records, {recorded} s of vibration in {seconds:.2} s = {:.0} × real time; user {:.2} s, system {:.2} s, \
         peak memory {peak_mb:.0} MB; {:.1} × plain write and sync ({:.2} ms each)",
        recorded / seconds,
        user - user_before,
        system - system_before,
        seconds / (reference * records),
        reference * 1e3,
    );
}

fn record(n: i64, samples: usize) -> Record {
    let start = "2026-01-01T00:00:00Z".parse::<Timestamp>().expect("a time") + SignedDuration::from_secs(60 * n);
    let mut state = n as u32 ^ 0x9E37_79B9;
    let samples = (0..samples).map(|k| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
        let phase = std::f64::consts::TAU * 400.0 * k as f64 / RATE_HZ;
        (phase.sin() + 0.5 * (2.0 * phase).sin() + 0.3 * noise) as f32
    });
    Record::new("1", start, RATE_HZ, "m/s2", samples.collect()).expect("finite samples")
}

/// Sends a request over a connection that stays open and returns the status once the answer is whole.
fn exchange(stream: &mut BufReader<TcpStream>, head: &str, body: &[u8]) -> u16 {
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

fn connect(service: &Service) -> BufReader<TcpStream> {
    let stream = TcpStream::connect(&service.address).expect("a connection");
    stream.set_nodelay(true).expect("a connection");
    BufReader::new(stream)
}

/// Runs requests over connections side by side, each due at its time where there is a rate. Returns the seconds it took in all and each
/// request's seconds from when it was due, sorted.
fn load(
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

fn quantile(sorted: &[f64], level: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * level) as usize]
}

/// Uploads of 800 kB over 8 connections, each answered when it is durable.
fn uploads() {
    const COUNT: usize = 600;
    let service = Service::start(&folder("uploads"));
    service.make_asset("pump");
    // Without a time and a channel of its own, so that those of the address count.
    let block = WaveformBlock {
        sample_rate_hz: RATE_HZ,
        unit: "m/s2".to_owned(),
        samples: record(0, SAMPLES).samples().to_vec(),
        ..Default::default()
    };
    let body = block.encode_to_vec();
    let upload = |n: usize, stream: &mut BufReader<TcpStream>| {
        let start = "2026-01-01T00:00:00Z".parse::<Timestamp>().expect("a time") + SignedDuration::from_secs(60 * n as i64);
        // The same samples under another time and so another hash: what is appended is a field that no reader knows.
        let mut body = body.clone();
        body.extend_from_slice(&[0xfd, 0x7f]);
        body.extend_from_slice(&(n as u32).to_le_bytes());
        let head = format!(
            "POST /v1/assets/pump/segments?start_time={start}&channel={} HTTP/1.1\r\nhost: bench\r\ncontent-type: application/x-protobuf\r\ncontent-length: {}\r\n\r\n",
            n % 4,
            body.len()
        );
        assert_eq!(exchange(stream, &head, &body), 201);
    };
    let reference = plain(&service.folder, 200, &vec![7; RECORD_BYTES]) / 200.0;
    // In the order of time, as a machine's records come: what came before is never folded again.
    const WARM_UP: usize = 40;
    load(&service, 8, WARM_UP, None, upload);
    let (_, user_before, system_before) = service.used();
    let (seconds, times) = load(&service, 8, COUNT, None, |n, stream| upload(WARM_UP + n, stream));
    let (peak_mb, user, system) = service.used();
    let rate = COUNT as f64 / seconds;
    println!(
        "uploads: {rate:.0} a second over 8 connections, p50 {:.1} ms, p99 {:.1} ms; a record costs the service {:.2} ms user and {:.2} ms system; \
         plain write and sync {:.2} ms each: ratio {:.1}; peak memory {peak_mb:.0} MB",
        1e3 * quantile(&times, 0.5),
        1e3 * quantile(&times, 0.99),
        1e3 * (user - user_before) / COUNT as f64,
        1e3 * (system - system_before) / COUNT as f64,
        1e3 * reference,
        1.0 / (rate * reference),
    );
    let (_, times) = load(&service, 8, COUNT, Some(0.7 * rate), |n, stream| {
        upload(WARM_UP + COUNT + n, stream)
    });
    println!(
        "uploads at 70 % of that: p50 {:.1} ms, p99 {:.1} ms",
        1e3 * quantile(&times, 0.5),
        1e3 * quantile(&times, 0.99)
    );
}

/// Puts this many short records into an asset, as MCAP files of 10 000.
fn fill(service: &Service, asset: &str, records: i64) -> f64 {
    let began = Instant::now();
    for first in (0..records).step_by(10_000) {
        let mut writer = McapWriter::new(std::io::Cursor::new(Vec::new()), McapOptions::default()).expect("a writer");
        for n in first..records.min(first + 10_000) {
            writer.write("/pump/1/waveform", &record(n, 256)).expect("a record");
        }
        let bytes = writer.finish().expect("a recording").into_inner();
        service.post(&format!("/v1/assets/{asset}/segments"), "application/mcap", &bytes);
    }
    began.elapsed().as_secs_f64()
}

/// What dashboards ask for, with an asset of many records.
fn polling() {
    let records: i64 = std::env::var("FLANKWATCH_BENCH_RECORDS").map_or(100_000, |text| text.parse().expect("a number"));
    let service = Service::start(&folder("polling"));
    service.make_asset("pump");
    let seconds = fill(&service, "pump", records);
    println!(
        "filling: {records} records of 256 samples in {seconds:.1} s = {:.2} ms each",
        1e3 * seconds / records as f64
    );
    let get = "GET /v1/assets/pump/wear HTTP/1.1\r\nhost: bench\r\n\r\n";
    let (seconds, times) = load(&service, 8, 10_000, None, |_, stream| assert_eq!(exchange(stream, get, b""), 200));
    println!(
        "polling: {:.0} GET wear a second over 8 connections, p50 {:.2} ms, p99 {:.2} ms",
        10_000.0 / seconds,
        1e3 * quantile(&times, 0.5),
        1e3 * quantile(&times, 0.99)
    );
    let trend = "GET /v1/assets/pump/indicators?names=rms&max_points=1000 HTTP/1.1\r\nhost: bench\r\n\r\n";
    let (_, first) = load(&service, 1, 1, None, |_, stream| assert_eq!(exchange(stream, trend, b""), 200));
    let (_, times) = load(&service, 1, 200, None, |_, stream| assert_eq!(exchange(stream, trend, b""), 200));
    println!(
        "trend of {records} points reduced to 1000: p50 {:.2} ms, p99 {:.2} ms; the first one, read from the disk, {:.0} ms",
        1e3 * quantile(&times, 0.5),
        1e3 * quantile(&times, 0.99),
        1e3 * first[0]
    );
}

/// Cost against the number of records: each step ten times as many.
fn growth() {
    let most: i64 = std::env::var("FLANKWATCH_BENCH_RECORDS").map_or(100_000, |text| text.parse().expect("a number"));
    let mut records = 1000;
    while records <= most {
        let folder = folder(&format!("growth-{records}"));
        let service = Service::start(&folder);
        service.make_asset("pump");
        let filled = fill(&service, "pump", records);
        let one = Instant::now();
        let body = encode_block(&record(records, 256), BlockEncoding::Protobuf);
        service.post("/v1/assets/pump/segments", "application/x-protobuf", &body);
        let append = one.elapsed().as_secs_f64();
        let one = Instant::now();
        let body = encode_block(&record(-1, 256), BlockEncoding::Protobuf);
        service.post("/v1/assets/pump/segments", "application/x-protobuf", &body);
        let late = one.elapsed().as_secs_f64();
        let database = fs::metadata(folder.join("flankwatch.db")).map_or(0, |metadata| metadata.len());
        // Killed and started again on the same folder.
        let kept = folder.with_extension("kept");
        fs::rename(&folder, &kept).expect("the folder moves");
        drop(service);
        let began = Instant::now();
        let service = Service::start(&kept);
        let started = began.elapsed().as_secs_f64();
        println!(
            "growth: {records} records: {:.3} ms each to store, {:.1} ms to append one, {:.1} ms for one before all others, \
             {:.2} kB of database each, start {:.0} ms",
            1e3 * filled / records as f64,
            1e3 * append,
            1e3 * late,
            database as f64 / records as f64 / 1024.0,
            1e3 * started
        );
        drop(service);
        records *= 10;
    }
}
