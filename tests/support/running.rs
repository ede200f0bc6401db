//! A running service, a client for it, and records to send.

use std::io::Cursor;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant};

use flankwatch::http::{RunningService, ServiceConfig, start};
use flankwatch::library::EnsembleSettings;
use flankwatch::service::Clock;
use flankwatch::signal::Record;
use jiff::Timestamp;
use serde_json::{Value, json};
use tempfile::TempDir;

/// A clock that advances only when told to.
#[derive(Default)]
pub(crate) struct ManualClock {
    seconds: AtomicI64,
}

impl ManualClock {
    pub(crate) fn advance(&self, seconds: i64) {
        self.seconds.fetch_add(seconds, Ordering::SeqCst);
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Timestamp {
        let start: Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
        start + jiff::SignedDuration::from_secs(self.seconds.load(Ordering::SeqCst))
    }
}

/// A service with its own folder, clock and threads.
pub(crate) struct Service {
    runtime: tokio::runtime::Runtime,
    running: Option<RunningService>,
    pub(crate) clock: Arc<ManualClock>,
    folder: TempDir,
    elsewhere: Option<PathBuf>,
    change: fn(&mut ServiceConfig),
    agent: ureq::Agent,
    /// The database, if the tests use PostgreSQL instead of SQLite.
    #[cfg(feature = "cluster")]
    database: Option<crate::shared_store::TestDatabase>,
}

/// A response of the service.
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) headers: ureq::http::HeaderMap,
    pub(crate) bytes: Vec<u8>,
}

impl Answer {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.bytes)
            .unwrap_or_else(|error| panic!("{error} in {:?}", String::from_utf8_lossy(&self.bytes)))
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }

    #[track_caller]
    pub(crate) fn expect(self, status: u16) -> Self {
        assert_eq!(self.status, status, "{}", String::from_utf8_lossy(&self.bytes));
        self
    }

    /// Checks that the response is a problem with this status whose detail contains every one of the words.
    #[track_caller]
    pub(crate) fn expect_problem(self, status: u16, words: &[&str]) -> Value {
        let answer = self.expect(status);
        assert_eq!(answer.header("content-type"), "application/problem+json");
        let problem = answer.json();
        assert_eq!(problem["status"], status);
        for key in ["type", "title", "detail"] {
            assert!(problem[key].as_str().is_some_and(|text| !text.is_empty()), "{key} in {problem}");
        }
        let detail = problem["detail"].as_str().unwrap();
        for word in words {
            assert!(detail.contains(word), "{word:?} in {detail:?}");
        }
        problem
    }
}

impl Service {
    pub(crate) fn start() -> Self {
        Self::start_with(|_| {})
    }

    pub(crate) fn start_with(change: fn(&mut ServiceConfig)) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), None, change)
    }

    /// Starts with its data in a given folder.
    pub(crate) fn start_at(path: &Path) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), Some(path.join("data")), |_| {})
    }

    fn start_in(folder: TempDir, elsewhere: Option<PathBuf>, change: fn(&mut ServiceConfig)) -> Self {
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(Duration::from_secs(120)))
            .build();
        let mut service = Self {
            runtime: tokio::runtime::Builder::new_multi_thread()
                .worker_threads(2)
                .enable_all()
                .build()
                .unwrap(),
            running: None,
            clock: Arc::default(),
            folder,
            elsewhere,
            change,
            agent: agent.into(),
            #[cfg(feature = "cluster")]
            database: crate::shared_store::TestDatabase::named(),
        };
        service.launch();
        service
    }

    pub(crate) fn launch(&mut self) {
        self.try_launch().unwrap();
    }

    /// Starts the service; returns the error if it does not start.
    pub(crate) fn try_launch(&mut self) -> Result<(), String> {
        let mut config = ServiceConfig::new(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), self.folder());
        config.http.grace = Duration::from_secs(30);
        // The clock stands still while records of later times come.
        config.work.start_time_ahead = Duration::from_secs(10 * 365 * 24 * 3600);
        // No ensemble in the background, so that results do not depend on timing.
        config.work.ensemble = EnsembleSettings::described_alone();
        #[cfg(feature = "cluster")]
        if let Some(database) = &self.database {
            config.store = Some(flankwatch::store::StoreSettings::Shared(database.settings(self.folder())));
        }
        (self.change)(&mut config);
        let clock = Arc::clone(&self.clock);
        let running = self.runtime.block_on(start(config, clock)).map_err(|error| error.to_string())?;
        self.running = Some(running);
        Ok(())
    }

    pub(crate) fn stop(&mut self) {
        let running = self.running.take().unwrap();
        self.runtime.block_on(running.stop()).unwrap();
    }

    /// Restarts the service on the same folder.
    pub(crate) fn restart(&mut self) {
        self.stop();
        self.launch();
    }

    /// Returns the service, for tests that call it directly.
    pub(crate) fn service(&self) -> std::sync::Arc<flankwatch::service::Service> {
        self.running.as_ref().unwrap().service().clone()
    }

    /// Runs a future on the service's runtime.
    pub(crate) fn run<T>(&self, work: impl Future<Output = T>) -> T {
        self.runtime.block_on(work)
    }

    pub(crate) fn folder(&self) -> &Path {
        self.elsewhere.as_deref().unwrap_or(self.folder.path())
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.running.as_ref().unwrap().address())
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        self.send("GET", path, &[], &[])
    }

    pub(crate) fn delete(&self, path: &str) -> Answer {
        self.send("DELETE", path, &[], &[])
    }

    pub(crate) fn post(&self, path: &str, media_type: &str, body: &[u8]) -> Answer {
        self.send("POST", path, &[("content-type", media_type)], body)
    }

    pub(crate) fn post_json(&self, path: &str, body: &Value) -> Answer {
        self.post(path, "application/json", body.to_string().as_bytes())
    }

    pub(crate) fn put_json(&self, path: &str, body: &Value) -> Answer {
        self.send("PUT", path, &[("content-type", "application/json")], body.to_string().as_bytes())
    }

    pub(crate) fn send(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        let mut request = ureq::http::Request::builder().method(method).uri(self.url(path));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let mut response = self.agent.run(request.body(body).unwrap()).unwrap();
        Answer {
            status: response.status().as_u16(),
            headers: response.headers().clone(),
            bytes: response.body_mut().with_config().limit(64 << 20).read_to_vec().unwrap(),
        }
    }

    /// Lets 25 hours pass for resumable uploads: advances the service's clock or, with a shared database,
    /// ages the rows, as the database's clock cannot be set.
    pub(crate) fn let_uploads_expire(&self) {
        self.clock.advance(25 * 3600);
        #[cfg(feature = "cluster")]
        if let Some(database) = &self.database {
            database.age_uploads(Duration::from_secs(25 * 3600));
        }
    }

    /// Creates an asset without a gear pair, which has indicators but no wear.
    pub(crate) fn plain_asset(&self, id: &str) {
        self.post_json("/v1/assets", &plain_asset(id)).expect(201);
    }

    /// Polls a path until the response satisfies a condition.
    #[track_caller]
    pub(crate) fn wait_for(&self, path: &str, is_wanted: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let answer = self.get(path).expect(200).json();
            if is_wanted(&answer) {
                return answer;
            }
            assert!(began.elapsed() < Duration::from_secs(300), "still {answer}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Sends a record as JSON and returns its segment.
    #[track_caller]
    pub(crate) fn upload(&self, asset: &str, record: &Record) -> Value {
        let block = flankwatch::recording::encode_block(record, flankwatch::recording::BlockEncoding::Json);
        let path = format!("/v1/assets/{asset}/segments");
        self.post(&path, "application/json", &block).expect(201).json()
    }
}

/// Returns the description of an asset without a gear pair.
pub(crate) fn plain_asset(id: &str) -> Value {
    json!({
        "id": id,
        "gear": { "teeth": [31, 62], "shaft_speed_hz": 10.0 },
        "sensor": { "unit": "m/s2" },
        "baseline": { "records": 8 },
    })
}

/// Returns the description of an asset with a small pair, whose face width tells it from those of other
/// tests.
pub(crate) fn asset_with_pair(id: &str, face_width_mm: f64) -> Value {
    let mut asset = plain_asset(id);
    asset["gear"]["pair"] = json!({
        "name": "test pair",
        "geometry": { "teeth": [31, 62], "module_mm": 3.0, "face_width_mm": face_width_mm, "bore_radius_mm": [15.0, 30.0] },
        "operation": { "torque_nm": 60.0, "shaft_speed_hz": 10.0 },
    });
    asset
}

/// Returns the time `n` minutes after 2026-01-01T00:00:00Z.
pub(crate) fn minute(n: i64) -> Timestamp {
    let start: Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
    start + jiff::SignedDuration::from_mins(n)
}

/// Returns half a second at 4 kHz of a 310 Hz mesh with harmonics and noise; `n` varies the samples.
pub(crate) fn samples(n: u32) -> Vec<f32> {
    let mut state = n.wrapping_mul(2_654_435_761).wrapping_add(12_345);
    (0..2000)
        .map(|k| {
            // Numerical Recipes' linear congruential generator.
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
            let phase = std::f64::consts::TAU * 310.0 * f64::from(k) / 4000.0;
            let growth = 1.0 + f64::from(n) / 100.0;
            (growth * phase.sin() + 0.5 * (2.0 * phase).sin() + 0.2 * (3.0 * phase).sin() + 0.1 * noise)
                as f32
        })
        .collect()
}

/// Returns two seconds at 10 kHz of a gearbox of 24 and 26 teeth at 16.64 Hz: mesh harmonics with sidebands,
/// the shaft's own lines, and noise.
pub(crate) fn gearbox_24_26() -> Vec<f32> {
    let (shaft_hz, rate_hz) = (16.64, 10_000.0);
    let mesh = (1..=12).map(|order| (f64::from(24 * order), 1.0));
    let sides = [-2, -1, 1, 2].into_iter();
    let sidebands =
        (1..=4).flat_map(move |order| sides.clone().map(move |side| (f64::from(24 * order + side), 0.3)));
    let lines: Vec<(f64, f64)> =
        mesh.chain(sidebands).chain((1..=4).map(|order| (f64::from(order), 0.3))).collect();
    let mut state = 12_345_u32;
    (0..20_000)
        .map(|k| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
            let turns = shaft_hz * f64::from(k) / rate_hz;
            let sum: f64 = lines
                .iter()
                .map(|(order, amplitude)| {
                    amplitude * (std::f64::consts::TAU * order * turns + order * order).sin()
                })
                .sum();
            (sum + noise) as f32
        })
        .collect()
}

/// Returns record `n` of a channel, one per minute.
pub(crate) fn record(channel: &str, n: u32) -> Record {
    Record::new(channel, minute(n.into()), 4000.0, "m/s2", samples(n)).unwrap()
}

/// Encodes channels as a WAV of 32-bit floats at 4 kHz.
pub(crate) fn wav(channels: &[Vec<f32>]) -> Vec<u8> {
    let spec = hound::WavSpec {
        channels: channels.len() as u16,
        sample_rate: 4000,
        bits_per_sample: 32,
        sample_format: hound::SampleFormat::Float,
    };
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = hound::WavWriter::new(&mut bytes, spec).unwrap();
    for k in 0..channels[0].len() {
        for channel in channels {
            writer.write_sample(channel[k]).unwrap();
        }
    }
    writer.finalize().unwrap();
    bytes.into_inner()
}

/// Encodes records as MCAP.
pub(crate) fn mcap(records: &[Record]) -> Vec<u8> {
    use flankwatch::recording::{McapOptions, McapWriter};
    let mut writer = McapWriter::new(Cursor::new(Vec::new()), McapOptions::default()).unwrap();
    for record in records {
        writer.write(&format!("/asset/{}/waveform", record.channel()), record).unwrap();
    }
    writer.finish().unwrap().into_inner()
}
