//! A cluster of processes with its own servers, and records sent to it during faults.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use flankwatch::store::SharedSettings;
use tempfile::TempDir;

use super::client::Client;
use super::nodes::{OneMachine, database};
use super::postgres::PostgresServer;
use super::processes::{NatsServer, Program};
use super::small_disk::SmallDisk;
use crate::proxy::Proxy;
use crate::running::{plain_asset, record};
use crate::shared_store::TestDatabase;

/// Default number of rounds.
const ROUNDS: u32 = 1;

/// Number of concurrent upload connections.
const CONNECTIONS: u32 = 3;

/// Number of records of a round that are sent at full speed.
const UNHURRIED: u32 = 60;

/// Returns how often each fault is repeated.
pub(super) fn rounds() -> u32 {
    std::env::var("FLANKWATCH_FAULT_ROUNDS").map_or(ROUNDS, |rounds| rounds.parse().unwrap())
}

/// Returns the program under test.
pub(super) fn this_program() -> PathBuf {
    PathBuf::from(env!("CARGO_BIN_EXE_flankwatch"))
}

/// The servers of a cluster, and the settings of its processes.
pub(super) struct Site {
    folder: TempDir,
    settings: SharedSettings,
    pub(super) database: TestDatabase,
    /// The database server, if it belongs to the site.
    pub(super) postgres: Option<PostgresServer>,
    pub(super) nats: NatsServer,
    pub(super) objects: String,
    /// The program of the processes that are started from now on.
    pub(super) program: PathBuf,
    started: u32,
}

impl Site {
    pub(super) fn start() -> Self {
        Self::on(database(), None, None)
    }

    /// Starts a site with its own database server, which can be stopped.
    pub(super) fn with_own_postgres() -> Self {
        Self::with_own_servers(None)
    }

    /// Starts a site with its own database server and a queue on its own disk.
    pub(super) fn with_queue_on(disk: &SmallDisk) -> Self {
        Self::with_own_servers(Some(disk))
    }

    fn with_own_servers(queue_disk: Option<&SmallDisk>) -> Self {
        let postgres = PostgresServer::start();
        Self::on(TestDatabase::on(postgres.url()), Some(postgres), queue_disk)
    }

    fn on(database: TestDatabase, postgres: Option<PostgresServer>, queue_disk: Option<&SmallDisk>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let nats = NatsServer::start(queue_disk.map_or(folder.path(), SmallDisk::folder));
        let settings = database.settings(folder.path());
        let objects = format!("folder = {:?}", folder.path().join("objects"));
        let program = this_program();
        Self { settings, database, postgres, nats, objects, program, folder, started: 0 }
    }

    /// Returns the address of the database server.
    pub(super) fn database_server(&self) -> SocketAddr {
        let url = &self.settings.database_url;
        let host = url.split("://").nth(1).unwrap().split('/').next().unwrap();
        let host = host.rsplit('@').next().unwrap();
        host.parse().unwrap()
    }

    /// Writes a settings file; `database` is a proxy between the process and the database.
    pub(super) fn config(&self, database: Option<&Proxy>) -> PathBuf {
        let mut url = self.settings.database_url.clone();
        if let Some(proxy) = database {
            url = url.replace(&self.database_server().to_string(), &proxy.address().to_string());
        }
        let path = self.folder.path().join(if database.is_some() { "cut.toml" } else { "cluster.toml" });
        let text = format!(
            "[cluster]\nname = \"faults\"\n[cluster.database]\nurl = {url:?}\nconnect_timeout_s = 2\n\
             [cluster.nats]\nurls = [{:?}]\nack_wait_s = 2\n[cluster.objects]\n{}\n",
            self.nats.url(),
            self.objects
        );
        std::fs::write(&path, text).unwrap();
        path
    }

    /// Returns the folder of the raw recordings.
    pub(super) fn objects_folder(&self) -> PathBuf {
        self.folder.path().join("objects")
    }

    pub(super) fn own_folder(&mut self) -> PathBuf {
        self.started += 1;
        self.folder.path().join(self.started.to_string())
    }

    pub(super) fn api(&mut self, config: &Path) -> Program {
        let folder = self.own_folder();
        Program::api(&self.program, config, &folder)
    }

    pub(super) fn worker_at(&mut self, config: &Path, days: i32) -> Program {
        let folder = self.own_folder();
        Program::worker_at(&self.program, config, &folder, days)
    }

    pub(super) fn worker(&mut self, config: &Path) -> Program {
        let folder = self.own_folder();
        Program::worker(&self.program, config, &folder)
    }
}

/// Records sent during a fault, with the acknowledged ones.
#[derive(Default)]
pub(super) struct Uploads {
    next: AtomicU32,
    acknowledged: Mutex<BTreeMap<u32, String>>,
}

impl Uploads {
    /// Sends over several connections, to the clients in turn, while `fault` runs.
    pub(super) fn during(&self, clients: &[&Client], fault: impl FnOnce()) {
        let (is_over, first) = (AtomicBool::new(false), self.next.load(Ordering::Relaxed));
        std::thread::scope(|scope| {
            for _ in 0..CONNECTIONS {
                scope.spawn(|| {
                    while !is_over.load(Ordering::Relaxed) {
                        let n = self.next.fetch_add(1, Ordering::Relaxed);
                        if n > first + UNHURRIED {
                            // Slow faults are tested with fewer records.
                            std::thread::sleep(Duration::from_millis(500));
                        }
                        match clients[n as usize % clients.len()].try_upload("pump", &record("1", n)) {
                            Some((201, answer)) => {
                                let id = answer["id"].as_str().unwrap().to_owned();
                                self.acknowledged.lock().unwrap().insert(n, id);
                            }
                            // The node rejects it for now, or does not respond.
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

    /// Waits until every acknowledged record is stored.
    #[track_caller]
    pub(super) fn wait_until_stored(&self, client: &Client) {
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

    /// Sends all records again and compares the results with those of an undisturbed machine.
    #[track_caller]
    pub(super) fn compare(&self, client: &Client) {
        let sent = self.next.load(Ordering::Relaxed);
        let machine = OneMachine::start();
        let alone = machine.client();
        alone.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
        for n in 0..sent {
            client.upload("pump", &record("1", n));
            alone.upload("pump", &record("1", n));
        }
        client.wait_for_segments("pump", sent);
        let expected = alone.history("pump");
        client.wait_for("/v1/assets/pump/indicators?max_points=200000&channel=1", |rows| {
            rows["items"] == expected[1]
        });
        assert_eq!(client.history("pump"), expected);
        let acknowledged = self.acknowledged.lock().unwrap().len();
        eprintln!("{} rounds: {sent} records sent, {acknowledged} acknowledged, all there once", rounds());
    }
}
