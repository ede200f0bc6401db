//! The service under load, as the release binary:
//! `cargo bench --bench service -- [replay|uploads|new-asset|polling|growth|fleet|memory|start]`.
//! Without a name all run but `memory`, which takes two hours, and `start`. `start` measures starts on the
//! data folder in `FLANKWATCH_BENCH_FOLDER`, whose records `benches/multiply_rows.py` can multiply.
//!
//! Every result is printed with a reference from the same run: writing and syncing the same bytes as plain
//! files for what is stored, `GET /healthz` for what is read, and an empty folder for a start. What is read
//! from a filled folder is measured after each of five starts; the result is the median, with the range. The
//! recording for the replay is the file of `FLANKWATCH_BENCH_RUN`, or is simulated once into `target/bench`.

mod driven;

use std::fmt;
use std::fs::{self, File};
use std::io::{BufReader, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use driven::{SAMPLES, Service, Uploads, described, exchange, folder, load, record};
use flankwatch::recording::{BlockEncoding, McapOptions, McapWriter, encode_block};

/// Time after which an unchanged history is stored as columns.
const STORED_AS_COLUMNS: Duration = Duration::from_secs(20);

/// Number of starts on a filled folder, each with all measurements.
const STARTS: usize = 5;

/// Bytes of a record of 10 s.
const RECORD_BYTES: usize = 4 * SAMPLES;

fn main() {
    let selected: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let is_selected = |name: &str| selected.is_empty() || selected.iter().any(|word| word == name);
    if is_selected("replay") {
        replay();
    }
    if is_selected("uploads") {
        uploads();
    }
    if is_selected("new-asset") {
        new_asset();
    }
    if is_selected("polling") {
        polling();
    }
    if is_selected("growth") {
        growth();
    }
    if is_selected("fleet") {
        fleet();
    }
    if selected.iter().any(|word| word == "memory") {
        memory();
    }
    if selected.iter().any(|word| word == "start") {
        start();
    }
}

/// Returns the seconds to write and sync these bytes as plain files, one after the other.
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

fn quantile(sorted: &[f64], level: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * level) as usize]
}

/// Results of several runs, printed as their median and range with one decimal.
struct Runs(Vec<f64>);

impl fmt::Display for Runs {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut sorted = self.0.clone();
        sorted.sort_by(f64::total_cmp);
        let of = |level| quantile(&sorted, level);
        write!(to, "{:.1} ({:.1} to {:.1})", of(0.5), of(0.0), of(1.0))
    }
}

/// Turns results by run into runs by result.
fn by_result<const N: usize>(runs: &[[f64; N]]) -> [Runs; N] {
    std::array::from_fn(|result| Runs(runs.iter().map(|run| run[result]).collect()))
}

/// Resets the peak resident memory.
fn reset_peak(service: &Service) {
    let _ = fs::write(format!("/proc/{}/clear_refs", service.child.id()), "5");
}

fn recording() -> PathBuf {
    if let Some(given) = std::env::var_os("FLANKWATCH_BENCH_RUN") {
        return given.into();
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/bench/run.mcap");
    if !path.exists() {
        fs::create_dir_all(path.parent().expect("a folder above")).expect("a folder for the recording");
        println!("simulating {} (once)", path.display());
        let done = Command::new(driven::BINARY)
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
    reset_peak(&service);
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

/// Uploads of 800 kB over 8 connections, each answered when it is durable.
fn uploads() {
    const COUNT: usize = 600;
    let service = Service::start(&folder("uploads"));
    service.make_asset("pump");
    let records = Uploads::new();
    let upload = |n: usize, stream: &mut BufReader<TcpStream>| records.send(stream, "pump", n % 4, n);
    let reference = plain(&service.folder, 200, &vec![7; RECORD_BYTES]) / 200.0;
    // In time order, as a machine sends its records: no record causes a recomputation.
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
    let (_, times) =
        load(&service, 8, COUNT, Some(0.7 * rate), |n, stream| upload(WARM_UP + COUNT + n, stream));
    println!(
        "uploads at 70 % of that: p50 {:.1} ms, p99 {:.1} ms",
        1e3 * quantile(&times, 0.5),
        1e3 * quantile(&times, 0.99)
    );
}

/// 20 uploads a second to a new asset, while its library and ensemble are simulated.
fn new_asset() {
    const COUNT: usize = 600;
    let service = Service::start(&folder("new-asset"));
    service.post("/v1/assets", "application/json", described("new").to_string().as_bytes());
    let records = Uploads::new();
    let (_, times) = load(&service, 8, COUNT, Some(20.0), |n, stream| records.send(stream, "new", n % 4, n));
    let summary = service.get("/v1/assets/new")["summary"].clone();
    println!(
        "uploads to a new asset: p50 {:.1} ms, p99 {:.1} ms; after {COUNT} records its library is {}, and its simulation at {}",
        1e3 * quantile(&times, 0.5),
        1e3 * quantile(&times, 0.99),
        summary["library_state"],
        summary["simulation"]
    );
}

/// Runs the same GET request over concurrent connections; returns the total seconds and the sorted latencies.
fn requests(service: &Service, connections: usize, count: usize, path: &str) -> (f64, Vec<f64>) {
    let get = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\n\r\n");
    load(service, connections, count, None, |_, stream| assert_eq!(exchange(stream, &get, b""), 200))
}

/// Uploads short records to an asset, as MCAP files of 10 000; returns the seconds.
fn fill(service: &Service, asset: &str, records: i64) -> f64 {
    let began = Instant::now();
    for first in (0..records).step_by(10_000) {
        let mut writer =
            McapWriter::new(std::io::Cursor::new(Vec::new()), McapOptions::default()).expect("a writer");
        for n in first..records.min(first + 10_000) {
            writer.write("/pump/1/waveform", &record(n, 256)).expect("a record");
        }
        let bytes = writer.finish().expect("a recording").into_inner();
        service.post(&format!("/v1/assets/{asset}/segments"), "application/mcap", &bytes);
    }
    began.elapsed().as_secs_f64()
}

/// Requests of dashboards, with an asset of many records.
fn polling() {
    const POLLS: usize = 10_000;
    let records: i64 =
        std::env::var("FLANKWATCH_BENCH_RECORDS").map_or(100_000, |text| text.parse().expect("a number"));
    let mut service = Service::start(&folder("polling"));
    service.make_asset("pump");
    let seconds = fill(&service, "pump", records);
    println!(
        "filling: {records} records of 256 samples in {seconds:.1} s = {:.2} ms each",
        1e3 * seconds / records as f64
    );
    std::thread::sleep(STORED_AS_COLUMNS);
    let run = |_| {
        service.restart();
        let trend = "/v1/assets/pump/indicators?names=rms&max_points=1000";
        let (_, first) = requests(&service, 1, 1, trend);
        let (_, trends) = requests(&service, 1, 200, trend);
        let (alone, _) = requests(&service, 8, POLLS, "/healthz");
        let (seconds, times) = requests(&service, 8, POLLS, "/v1/assets/pump/wear");
        [
            1e3 * first[0],
            1e3 * quantile(&trends, 0.5),
            POLLS as f64 / seconds,
            1e3 * quantile(&times, 0.99),
            POLLS as f64 / alone,
            median_ms(&service, 200, "/healthz"),
        ]
    };
    let runs: Vec<_> = (0..STARTS).map(run).collect();
    let [first, trend, polls, slow, alone, health] = by_result(&runs);
    println!(
        "trend of {records} points reduced to 1000, in ms: {trend}; the first one after a start: {first}"
    );
    println!("GET wear a second over 8 connections: {polls}, p99 in ms: {slow}");
    println!("reference: GET /healthz a second over 8 connections: {alone}; over one, in ms: {health}");
}

/// Cost by number of records, in steps of ten.
fn growth() {
    let max: i64 =
        std::env::var("FLANKWATCH_BENCH_RECORDS").map_or(100_000, |text| text.parse().expect("a number"));
    let mut records = 1000;
    while records <= max {
        let folder = folder(&format!("growth-{records}"));
        let mut service = Service::start(&folder);
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
        let began = Instant::now();
        service.restart();
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

/// Median latency of a GET request over one connection.
fn median_ms(service: &Service, count: usize, path: &str) -> f64 {
    1e3 * quantile(&requests(service, 1, count, path).1, 0.5)
}

/// Kills the service, starts it again, and waits for its answer to a GET request.
fn restart_ms(service: &mut Service, path: &str) -> f64 {
    let began = Instant::now();
    service.restart();
    requests(service, 1, 1, path);
    1e3 * began.elapsed().as_secs_f64()
}

/// Cost by number of assets, in steps of ten; each has the same gear pair and one record.
fn fleet() {
    let max: usize =
        std::env::var("FLANKWATCH_BENCH_ASSETS").map_or(10_000, |text| text.parse().expect("a number"));
    let mut assets = 100;
    while assets <= max {
        let folder = folder(&format!("fleet-{assets}"));
        let mut service = Service::start(&folder);
        let empty = |_| {
            let started = restart_ms(&mut service, "/healthz");
            service.get("/v1/assets");
            [started, service.used().0]
        };
        let empty: Vec<_> = (0..STARTS).map(empty).collect();
        service.make_asset("first");
        let post = |stream: &mut BufReader<TcpStream>, path: &str, media_type: &str, body: &[u8]| {
            let head = format!(
                "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {media_type}\r\ncontent-length: {}\r\n\r\n",
                body.len()
            );
            assert_eq!(exchange(stream, &head, body), 201, "POST {path}");
        };
        let in_part = assets / STARTS;
        let fill = |part: usize| {
            let (made, _) = load(&service, 8, in_part, None, |n, stream| {
                let body = described(&format!("a{:06}", part * in_part + n)).to_string();
                post(stream, "/v1/assets", "application/json", body.as_bytes());
            });
            let (stored, _) = load(&service, 8, in_part, None, |n, stream| {
                let n = part * in_part + n;
                let body = encode_block(&record(n as i64, 256), BlockEncoding::Protobuf);
                post(stream, &format!("/v1/assets/a{n:06}/segments"), "application/x-protobuf", &body);
            });
            [made, stored].map(|seconds| 1e3 * seconds / in_part as f64)
        };
        let parts: Vec<_> = (0..STARTS).map(fill).collect();
        let [made, stored] = by_result(&parts);
        let filled_mb = service.used().0;
        println!("fleet: {assets} assets, at most {filled_mb:.0} MB");
        println!("in ms for each, by fifths of the assets: to make it {made}; a record of it {stored}");
        let run = |_| {
            let wear = "/v1/assets/a000050/wear";
            [
                restart_ms(&mut service, wear),
                median_ms(&service, 20, "/v1/assets?limit=100"),
                median_ms(&service, 200, wear),
                median_ms(&service, 5, "/metrics"),
                median_ms(&service, 3, "/metrics/machines"),
                median_ms(&service, 3, "/metrics/machines?indicators=rms,kurtosis"),
                service.used().0,
                median_ms(&service, 200, "/healthz"),
            ]
        };
        let runs: Vec<_> = (0..STARTS).map(run).collect();
        let [started, page, wear, metrics, machines, of_two, memory_mb, health] = by_result(&runs);
        println!("start until the first answer in ms: {started}; memory in MB: {memory_mb}");
        println!("in ms: page of 100 {page}; GET wear {wear}; metrics {metrics}");
        println!("in ms: metrics of all machines {machines}; with two indicators {of_two}");
        let [started, memory_mb] = by_result(&empty);
        println!("reference: GET /healthz in ms: {health}");
        println!("reference: without assets, start in ms: {started}; memory in MB: {memory_mb}");
        drop(service);
        assets *= 10;
    }
}

/// Starts on a given data folder with an asset `pump`, which stays.
fn start() {
    let given =
        std::env::var_os("FLANKWATCH_BENCH_FOLDER").expect("FLANKWATCH_BENCH_FOLDER has a data folder");
    let mut service = Service::start(Path::new(&given));
    let started =
        |service: &mut Service, path| Runs((0..STARTS).map(|_| restart_ms(service, path)).collect());
    let records = service.get("/v1/assets/pump")["summary"]["segments"].clone();
    let [health, wear] = ["/healthz", "/v1/assets/pump/wear"].map(|path| started(&mut service, path));
    println!(
        "start with {records} records until GET /healthz is answered, in ms: {health}; GET wear: {wear}"
    );
    service.folder = folder("start");
    println!("reference: start without records in ms: {}", started(&mut service, "/healthz"));
}

/// Resident memory under steady load, for `FLANKWATCH_BENCH_SECONDS` (two hours): records of 2 s go to 20
/// assets with two channels each, and dashboards read.
fn memory() {
    const ASSETS: usize = 20;
    const CONNECTIONS: usize = 4;
    const RECORDS_A_SECOND: f64 = 4.0;
    const STEP_SECONDS: usize = 300;
    let total_seconds: usize =
        std::env::var("FLANKWATCH_BENCH_SECONDS").map_or(7200, |text| text.parse().expect("a number"));
    let service = Service::start(&folder("memory"));
    for n in 0..ASSETS {
        service.post("/v1/assets", "application/json", described(&format!("a{n:02}")).to_string().as_bytes());
    }
    let records = Uploads::of(SAMPLES / 5);
    let step = STEP_SECONDS.min(total_seconds);
    let in_step = (step as f64 * RECORDS_A_SECOND) as usize;
    for done in 0..total_seconds / step {
        let (_, times) = load(&service, CONNECTIONS, in_step, Some(RECORDS_A_SECOND), |n, stream| {
            let sent = done * in_step + n;
            let asset = format!("a{:02}", sent % ASSETS);
            // One channel of every asset, then the other.
            records.send(stream, &asset, (sent / ASSETS) % 2, sent);
            for path in [
                "/v1/assets?limit=100".to_owned(),
                format!("/v1/assets/{asset}/wear"),
                format!("/v1/assets/{asset}/indicators?names=rms&max_points=1000"),
            ] {
                let head = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\n\r\n");
                assert_eq!(exchange(stream, &head, b""), 200, "{path}");
            }
        });
        let [all_mb, anonymous_mb, files_mb] =
            ["VmRSS", "RssAnon", "RssFile"].map(|name| service.memory_mb(name));
        println!(
            "memory: after {} s and {} records {all_mb:.0} MB resident: {anonymous_mb:.0} MB anonymous, {files_mb:.0} MB of files; p99 {:.0} ms",
            (done + 1) * step,
            (done + 1) * in_step,
            1e3 * quantile(&times, 0.99)
        );
    }
}
