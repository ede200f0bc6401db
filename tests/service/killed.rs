//! The program killed at random moments while it is written to: what it acknowledged is there, once, and nothing else changes.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use flankwatch::recording::{BlockEncoding, encode_block};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::running::{plain_asset, record};

/// Rounds where nothing else is said: a hundred take minutes.
const ROUNDS: u32 = 4;

/// Connections that upload side by side.
const CONNECTIONS: u32 = 4;

/// How long the histories of thousands of records may take to be folded again on a busy machine.
const LONGEST_RECOMPUTATION: Duration = Duration::from_secs(600);

/// A running program and what it said.
pub(crate) struct Program {
    child: Child,
    url: String,
    log: Arc<Mutex<String>>,
    agent: ureq::Agent,
}

impl Program {
    fn start(folder: &Path) -> Self {
        Self::start_with(folder, &[])
    }

    /// Starts with further options.
    pub(crate) fn start_with(folder: &Path, options: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_flankwatch"))
            .args(["serve", "--listen", "127.0.0.1:0", "--data-dir"])
            .arg(folder)
            .args(options)
            .env("FLANKWATCH_LOG", "info")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let mut err = child.stderr.take().unwrap();
        let log = Arc::new(Mutex::new(String::new()));
        let said = Arc::clone(&log);
        std::thread::spawn(move || {
            let mut piece = [0; 4096];
            while let Ok(count) = err.read(&mut piece)
                && count > 0
            {
                said.lock().unwrap().push_str(&String::from_utf8_lossy(&piece[..count]));
            }
        });
        let mut url = String::new();
        while !url.contains("http://") {
            url.clear();
            let count = out.read_line(&mut url).unwrap();
            assert!(count > 0, "did not start: {}", log.lock().unwrap());
        }
        let url = url[url.find("http://").unwrap()..].trim().to_owned();
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(Duration::from_secs(60)))
            .build();
        Self {
            child,
            url,
            log,
            agent: agent.into(),
        }
    }

    pub(crate) fn get(&self, path: &str) -> Value {
        let mut response = self.agent.get(format!("{}{path}", self.url)).call().unwrap();
        let text = response.body_mut().with_config().limit(256 << 20).read_to_string().unwrap();
        assert!(response.status().is_success(), "{path}: {text}");
        serde_json::from_str(&text).unwrap()
    }

    pub(crate) fn send(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> ureq::http::Response<ureq::Body> {
        let mut request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", self.url));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        self.agent.run(request.body(body).unwrap()).unwrap()
    }

    /// The segment of an upload that was acknowledged; none where the program is gone.
    fn upload(&self, asset: &str, n: u32) -> Option<Value> {
        let body = encode_block(&record("1", n), BlockEncoding::Protobuf);
        let request = self.agent.post(format!("{}/v1/assets/{asset}/segments", self.url));
        let mut response = request.content_type("application/x-protobuf").send(&body[..]).ok()?;
        let status = response.status().as_u16();
        let text = response.body_mut().read_to_string().ok()?;
        assert_eq!(status, 201, "{text}");
        serde_json::from_str(&text).ok()
    }

    pub(crate) fn make(&self, asset: &Value) {
        let request = self.agent.post(format!("{}/v1/assets", self.url));
        let response = request.content_type("application/json").send(asset.to_string().as_bytes()).unwrap();
        assert!([201, 409].contains(&response.status().as_u16()));
    }

    pub(crate) fn kill(mut self) -> String {
        // SIGKILL
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        let log = self.log.lock().unwrap();
        log.clone()
    }

    /// Number of segments by identifier over all pages.
    pub(crate) fn segments(&self, asset: &str) -> BTreeMap<String, u32> {
        let mut found = BTreeMap::new();
        let mut cursor = String::new();
        loop {
            let page = self.get(&format!("/v1/assets/{asset}/segments?limit=1000{cursor}"));
            for item in page["items"].as_array().unwrap() {
                *found.entry(item["id"].as_str().unwrap().to_owned()).or_default() += 1;
            }
            match page["next_cursor"].as_str() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => return found,
            }
        }
    }

    /// Every number of every record in the order of time.
    fn history(&self, asset: &str) -> Vec<Value> {
        let mut rows = Vec::new();
        for path in ["wear/history", "indicators"] {
            let answer = self.get(&format!("/v1/assets/{asset}/{path}?max_points=200000"));
            let mut items = answer["items"].as_array().unwrap().clone();
            for item in &mut items {
                item.as_object_mut().unwrap().remove("segment_id");
            }
            rows.push(json!(items));
        }
        rows
    }
}

/// The first record that two histories say different things of.
fn first_difference(one: &[Value], other: &[Value]) -> Option<(Value, Value)> {
    let rows = |history: &[Value]| -> Vec<Value> {
        history
            .iter()
            .flat_map(|rows| rows.as_array().cloned().unwrap_or_default())
            .collect()
    };
    let (one, other) = (rows(one), rows(other));
    let different = |(one, other): &(Value, Value)| one != other;
    one.into_iter().zip(other).find(different)
}

/// Files below a folder.
fn files(folder: &Path) -> usize {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    entries
        .flatten()
        .map(|entry| if entry.path().is_dir() { files(&entry.path()) } else { 1 })
        .sum()
}

/// A segment's indicators without the one that follows from the records before it, which a late record changes.
fn of_itself(segment: &Value) -> Value {
    let mut indicators = segment["indicators"].clone();
    indicators.as_object_mut().unwrap().remove("novelty");
    indicators
}

fn asset_with_pair(id: &str) -> Value {
    let mut asset = plain_asset(id);
    asset["gear"]["pair"] = json!({
        "name": "test pair",
        "geometry": { "teeth": [31, 62], "module_mm": 3.0, "face_width_mm": 20.0, "bore_radius_mm": [15.0, 30.0] },
        "operation": { "torque_nm": 60.0, "shaft_speed_hz": 10.0 },
    });
    asset
}

#[test]
fn what_was_acknowledged_survives_being_killed_at_random_moments() {
    let rounds = std::env::var("FLANKWATCH_KILL_ROUNDS").map_or(ROUNDS, |rounds| rounds.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(20_260_101);
    let next = AtomicU32::new(0);
    let acknowledged: Mutex<BTreeMap<u32, Value>> = Mutex::default();
    let (mut unacknowledged, mut repaired) = (0, 0);
    let first = Program::start(folder.path());
    for asset in ["killed", "undisturbed"] {
        first.make(&asset_with_pair(asset));
    }
    let began = Instant::now();
    while first.get("/v1/assets/killed")["summary"]["library_state"] != "ready" {
        assert!(began.elapsed() < Duration::from_secs(300), "{}", first.log.lock().unwrap());
        std::thread::sleep(Duration::from_millis(50));
    }
    let mut program = Some(first);
    for round in 0..rounds {
        let running = program.take().unwrap_or_else(|| Program::start(folder.path()));
        let gone = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for _ in 0..CONNECTIONS {
                scope.spawn(|| {
                    while !gone.load(Ordering::Relaxed) {
                        let n = next.fetch_add(1, Ordering::Relaxed);
                        if let Some(segment) = running.upload("killed", n) {
                            acknowledged.lock().unwrap().insert(n, segment);
                        }
                    }
                });
            }
            std::thread::sleep(Duration::from_micros(random.random_range(20_000..400_000)));
            // Killed first, so that requests are cut off; then the connections are told.
            let mut killed = Command::new("kill");
            killed.args(["-9", &running.child.id().to_string()]);
            assert!(killed.status().unwrap().success());
            gone.store(true, Ordering::Relaxed);
        });
        running.kill();
        let after = Program::start(folder.path());
        let stored = after.segments("killed");
        let known = acknowledged.lock().unwrap();
        for (n, segment) in known.iter() {
            let id = segment["id"].as_str().unwrap();
            assert_eq!(stored.get(id), Some(&1), "round {round}: record {n} was acknowledged");
        }
        // Nothing but what was sent, and no raw object without its record for long.
        assert!(stored.len() <= next.load(Ordering::Relaxed) as usize);
        unacknowledged = stored.len() - known.len();
        drop(known);
        let began = Instant::now();
        while files(&folder.path().join("raw")) != stored.len() {
            assert!(
                began.elapsed() < Duration::from_secs(30),
                "round {round}: {} raw objects of {} records",
                files(&folder.path().join("raw")),
                stored.len()
            );
            std::thread::sleep(Duration::from_millis(5));
        }
        repaired += usize::from(after.log.lock().unwrap().contains("removed"));
        program = Some(after);
    }
    let program = program.unwrap();
    let sent = next.load(Ordering::Relaxed);
    for n in 0..sent {
        let again = program.upload("killed", n).expect("a running program");
        if let Some(first) = acknowledged.lock().unwrap().get(&n) {
            for same in ["id", "raw", "features", "received_at"] {
                assert_eq!(again[same], first[same], "{same} of record {n}");
            }
            assert_eq!(of_itself(&again), of_itself(first), "indicators of record {n}");
        }
        program.upload("undisturbed", n).expect("a running program");
    }
    let began = Instant::now();
    loop {
        // Records that came very late are folded in the background, and everything once more where the pair's variants are ready: for one
        // asset before the other.
        let (killed, undisturbed) = (program.history("killed"), program.history("undisturbed"));
        if killed == undisturbed {
            break;
        }
        assert!(
            began.elapsed() < LONGEST_RECOMPUTATION,
            "the histories differ: {:?}; under way: {}",
            first_difference(&killed, &undisturbed),
            program.get("/v1/recomputations")
        );
        std::thread::sleep(Duration::from_millis(500));
    }
    let stored = program.segments("killed");
    assert_eq!(stored.len(), sent as usize);
    assert_eq!(stored.values().copied().collect::<BTreeSet<u32>>(), BTreeSet::from([1]));
    let known = acknowledged.lock().unwrap().len();
    eprintln!(
        "{rounds} rounds: {sent} records sent, {known} acknowledged, {unacknowledged} stored although the answer was cut off, \
         {repaired} starts that removed something"
    );
    program.kill();
}
