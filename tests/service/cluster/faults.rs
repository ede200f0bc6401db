//! What fails in a cluster costs nothing that was acknowledged, nothing is counted twice, and nobody has to do anything: with processes that
//! are killed, servers that are started again, and wires that are cut.
//!
//! `FLANKWATCH_FAULT_ROUNDS` says how often each happens.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use flankwatch::store::SharedSettings;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use tempfile::TempDir;

use super::nodes::{Client, OneMachine, database};
use super::processes::{NatsServer, Program, S3Server};
use super::proxy::{Proxy, Wire};
use crate::running::{plain_asset, record};
use crate::shared_store::TestDatabase;

/// Rounds where nothing else is said.
const ROUNDS: u32 = 1;

/// Connections that upload side by side.
const CONNECTIONS: u32 = 3;

/// Records of one round before they come slowly.
const UNHURRIED: u32 = 60;

fn rounds() -> u32 {
    std::env::var("FLANKWATCH_FAULT_ROUNDS").map_or(ROUNDS, |rounds| rounds.parse().unwrap())
}

/// The servers of a cluster of its own, and what its processes are started with.
struct Site {
    folder: TempDir,
    settings: SharedSettings,
    _database: TestDatabase,
    nats: NatsServer,
    objects: String,
    started: u32,
}

impl Site {
    /// None where a server is missing.
    fn start() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let nats = NatsServer::start(folder.path())?;
        let database = database()?;
        let settings = database.settings(folder.path());
        let objects = format!("folder = {:?}", folder.path().join("objects"));
        Some(Self {
            settings,
            _database: database,
            nats,
            objects,
            folder,
            started: 0,
        })
    }

    /// The address of the database's server.
    fn database_server(&self) -> SocketAddr {
        let url = &self.settings.database_url;
        let host = url.split("://").nth(1).unwrap().split('/').next().unwrap();
        let host = host.rsplit('@').next().unwrap();
        host.parse().unwrap()
    }

    /// A settings file; `database` stands between the process and the database.
    fn config(&self, database: Option<&Proxy>) -> PathBuf {
        let mut url = self.settings.database_url.clone();
        if let Some(proxy) = database {
            url = url.replace(&self.database_server().to_string(), &proxy.address().to_string());
        }
        let path = self
            .folder
            .path()
            .join(if database.is_some() { "cut.toml" } else { "cluster.toml" });
        let text = format!(
            "[cluster]\nname = \"faults\"\n[cluster.database]\nurl = {url:?}\nconnect_timeout_s = 2\n\
             [cluster.nats]\nurls = [{:?}]\nack_wait_s = 2\n[cluster.objects]\n{}\n",
            self.nats.url(),
            self.objects
        );
        std::fs::write(&path, text).unwrap();
        path
    }

    fn own_folder(&mut self) -> PathBuf {
        self.started += 1;
        self.folder.path().join(self.started.to_string())
    }

    fn api(&mut self, config: &Path) -> Program {
        let folder = self.own_folder();
        Program::api(config, &folder)
    }

    fn worker(&mut self, config: &Path) -> Program {
        let folder = self.own_folder();
        Program::worker(config, &folder)
    }
}

/// Records that are sent while something fails, and which of them were acknowledged.
#[derive(Default)]
struct Uploads {
    next: AtomicU32,
    acknowledged: Mutex<BTreeMap<u32, String>>,
}

impl Uploads {
    /// Sends over some connections, in turn to each of the clients, while `fault` happens.
    fn during(&self, clients: &[&Client], fault: impl FnOnce()) {
        let (is_over, first) = (AtomicBool::new(false), self.next.load(Ordering::Relaxed));
        std::thread::scope(|scope| {
            for _ in 0..CONNECTIONS {
                scope.spawn(|| {
                    while !is_over.load(Ordering::Relaxed) {
                        let n = self.next.fetch_add(1, Ordering::Relaxed);
                        if n > first + UNHURRIED {
                            // What takes long is not to be a test of many records.
                            std::thread::sleep(Duration::from_millis(500));
                        }
                        match clients[n as usize % clients.len()].try_upload("pump", &record("1", n)) {
                            Some((201, answer)) => {
                                let id = answer["id"].as_str().unwrap().to_owned();
                                self.acknowledged.lock().unwrap().insert(n, id);
                            }
                            // It cannot be taken now, or nobody answers.
                            Some((503, _)) | None => std::thread::sleep(Duration::from_millis(20)),
                            other => panic!("record {n}: {other:?}"),
                        }
                    }
                });
            }
            fault();
            is_over.store(true, Ordering::Relaxed);
        });
    }

    /// Waits until every record that was acknowledged is there.
    #[track_caller]
    fn wait_until_stored(&self, client: &Client) {
        let began = Instant::now();
        let acknowledged = self.acknowledged.lock().unwrap();
        for (n, id) in acknowledged.iter() {
            loop {
                match client.try_send("GET", &format!("/v1/segments/{id}"), "application/json", b"") {
                    Some((200, _)) => break,
                    found => assert!(
                        began.elapsed() < Duration::from_secs(120),
                        "record {n} was acknowledged and is not there: {found:?}"
                    ),
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }

    /// Sends all once more, and compares with one machine that has never been disturbed.
    #[track_caller]
    fn compare(&self, client: &Client) {
        let sent = self.next.load(Ordering::Relaxed);
        let machine = OneMachine::start();
        let alone = machine.client();
        alone.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
        for n in 0..sent {
            client.upload("pump", &record("1", n));
            alone.upload("pump", &record("1", n));
        }
        client.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] == sent);
        let expected = alone.history("pump");
        client.wait_for("/v1/assets/pump/indicators?max_points=200000&channel=1", |rows| {
            rows["items"] == expected[1]
        });
        assert_eq!(client.history("pump"), expected);
        let acknowledged = self.acknowledged.lock().unwrap().len();
        eprintln!(
            "{} rounds: {sent} records sent, {acknowledged} acknowledged, all there once",
            rounds()
        );
    }
}

fn random() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(20_260_101)
}

fn a_moment(random: &mut ChaCha8Rng) {
    std::thread::sleep(Duration::from_millis(random.random_range(100..600)));
}

#[test]
fn a_worker_killed_in_the_middle_loses_nothing() {
    let Some(mut site) = Site::start() else { return };
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let api = site.api(&config);
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let mut workers = vec![site.worker(&config), site.worker(&config)];
    for _ in 0..rounds() {
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            workers.remove(0).process.kill();
            a_moment(&mut random);
        });
        workers.push(site.worker(&config));
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
fn an_api_node_killed_after_its_answer_has_kept_its_word() {
    let Some(mut site) = Site::start() else { return };
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let steady = site.api(&config);
    steady.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for _ in 0..rounds() {
        let mut killed = site.api(&config);
        // Nobody works yet: what is acknowledged is in the queue alone.
        uploads.during(&[&killed.client, &steady.client], || {
            a_moment(&mut random);
            killed.process.kill();
        });
        let _worker = site.worker(&config);
        uploads.wait_until_stored(&steady.client);
    }
    let _worker = site.worker(&config);
    uploads.compare(&steady.client);
}

#[test]
fn a_nats_server_killed_and_started_again_has_everything() {
    let Some(mut site) = Site::start() else { return };
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let (api, worker) = (site.api(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for _ in 0..rounds() {
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            site.nats.kill();
            for program in [&api, &worker] {
                let health = program.wait_for_readiness(503);
                assert!(health["parts"]["queue_server"] != "ok", "{health}");
                assert_eq!(health["database"], "ok");
            }
            site.nats.start_again();
            for program in [&api, &worker] {
                program.wait_for_readiness(200);
            }
            a_moment(&mut random);
        });
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
fn a_database_that_was_away_is_gone_on_with() {
    let Some(mut site) = Site::start() else { return };
    let proxy = Proxy::to(site.database_server());
    let (direct, cut) = (site.config(None), site.config(Some(&proxy)));
    let (uploads, mut random) = (Uploads::default(), random());
    let (api, worker) = (site.api(&direct), site.worker(&cut));
    // Like the worker it loses the database.
    let beside = site.api(&cut);
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for round in 0..rounds() {
        // In turn a server that is down, and a plug that is pulled.
        let wire = if round % 2 == 0 { Wire::Closed } else { Wire::Silent };
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            proxy.set(wire);
            for program in [&worker, &beside] {
                let health = program.wait_for_readiness(503);
                assert!(health["database"] != "ok", "{health}");
                assert_eq!(health["parts"]["queue_server"], "ok", "{health}");
            }
            let (status, problem) = beside.client.try_upload("pump", &record("1", 0)).unwrap();
            assert_eq!(status, 503, "{problem}");
            proxy.set(Wire::Closed);
            proxy.set(Wire::Whole);
            for program in [&worker, &beside] {
                program.wait_for_readiness(200);
            }
            a_moment(&mut random);
        });
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
fn an_object_store_that_was_away_is_gone_on_with() {
    let Some(server) = S3Server::start() else { return };
    let Some(mut site) = Site::start() else { return };
    let proxy = Proxy::to(server.address());
    site.objects = format!("bucket = \"records\"\nendpoint = \"http://{}\"", proxy.address());
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let (api, worker) = (site.api(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for _ in 0..rounds() {
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            proxy.set(Wire::Closed);
            for program in [&api, &worker] {
                let health = program.wait_for_readiness(503);
                assert!(health["parts"]["object_store"] != "ok", "{health}");
                assert_eq!(health["database"], "ok");
            }
            proxy.set(Wire::Whole);
            for program in [&api, &worker] {
                program.wait_for_readiness(200);
            }
            a_moment(&mut random);
        });
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
fn a_full_queue_refuses_until_there_is_room() {
    let Some(mut site) = Site::start() else { return };
    let config = site.config(None);
    let text = std::fs::read_to_string(&config).unwrap();
    std::fs::write(&config, text.replace("ack_wait_s = 2", "ack_wait_s = 2\nmost_records = 5")).unwrap();
    let api = site.api(&config);
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for n in 0..5 {
        assert_eq!(api.client.try_upload("pump", &record("1", n)).unwrap().0, 201);
    }
    let (status, problem) = api.client.try_upload("pump", &record("1", 5)).unwrap();
    assert_eq!(
        (status, problem["detail"].as_str().unwrap().contains("full")),
        (503, true),
        "{problem}"
    );
    let health = api.wait_for_readiness(503);
    assert!(health["parts"]["queue_server"].as_str().unwrap().contains("5 of 5"), "{health}");
    let _worker = site.worker(&config);
    api.client.upload("pump", &record("1", 5));
    api.client.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] == 6);
    api.wait_for_readiness(200);
}

#[test]
fn a_record_that_cannot_be_stored_goes_to_the_dead_letters_with_its_reason() {
    let Some(mut site) = Site::start() else { return };
    let config = site.config(None);
    let (api, worker) = (site.api(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let (reason, payload) = runtime.block_on(async {
        let client = async_nats::connect(site.nats.url()).await.unwrap();
        let jetstream = async_nats::jetstream::new(client);
        let sent = jetstream.publish("faults.work", "no record".into()).await.unwrap();
        sent.await.unwrap();
        let stream = jetstream.get_stream("faults_dead").await.unwrap();
        for _ in 0..200 {
            if let Ok(letter) = stream.get_last_raw_message_by_subject("faults.dead").await {
                let reason = letter.headers.get("Flankwatch-Reason").unwrap().to_string();
                return (reason, letter.payload);
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("no dead letter: {}", worker.process.log());
    });
    assert!(reason.contains("cannot be read"), "{reason}");
    assert_eq!(&payload[..], b"no record");
    // What comes after it is not held up.
    let answer = api.client.upload("pump", &record("1", 1));
    assert_eq!(answer["state"], json!("queued"));
    api.client.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] == 1);
}
