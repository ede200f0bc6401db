//! API nodes and workers of a cluster inside the test's process, each with its own connections; they share
//! only the servers.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use async_nats::jetstream;
use flankwatch::asset::AssetId;
use flankwatch::cluster::{Cluster, NatsSettings, RunningWorker, WorkerLimits};
use flankwatch::http::{Node, RunningService, ServiceConfig, start, start_node};
use flankwatch::library::{EnsembleSettings, GridSettings};
use flankwatch::service::{QueueOverview, Readiness, RecordOutcome, Role, Service, ServiceFolders};
use flankwatch::store::{Store, StoreSettings};
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::runtime::Runtime;

use super::client::Client;
use crate::running::ManualClock;
use crate::shared_store::TestDatabase;
use flankwatch_test_support::needed;

static CLUSTERS: AtomicU32 = AtomicU32::new(0);

/// Returns the NATS server of `FLANKWATCH_TEST_NATS`.
pub(super) fn nats() -> String {
    needed(
        std::env::var("FLANKWATCH_TEST_NATS").ok(),
        "FLANKWATCH_TEST_NATS, the address of a NATS server with JetStream,",
    )
}

/// Returns the database of `FLANKWATCH_TEST_DATABASE`.
pub(super) fn database() -> TestDatabase {
    needed(TestDatabase::named(), "FLANKWATCH_TEST_DATABASE, the address of a PostgreSQL database,")
}

/// Returns a unique cluster name.
pub(super) fn unused_name() -> String {
    format!("test_{}_{}", std::process::id(), CLUSTERS.fetch_add(1, Ordering::Relaxed))
}

/// A cluster.
pub(super) struct TestCluster {
    runtime: Runtime,
    database: TestDatabase,
    nats: NatsSettings,
    folder: TempDir,
    nodes: Vec<RunningService>,
    workers: Vec<(RunningWorker, Arc<Service>)>,
    started: u32,
}

/// Returns a coarse grid, which simulates quickly.
fn config(folder: &Path) -> ServiceConfig {
    let mut config = ServiceConfig::new(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), folder);
    config.http.grace = Duration::from_secs(30);
    config.work.workers = 1;
    // The clock stands still while records of later times come.
    config.work.start_time_ahead = Duration::from_secs(10 * 365 * 24 * 3600);
    config.work.upkeep_interval = Duration::from_millis(500);
    config.work.ensemble = EnsembleSettings::described_alone();
    config.grid = GridSettings { states: 4, seconds: 0.25, ..GridSettings::default() };
    config
}

/// Returns a runtime with two threads.
pub(super) fn runtime() -> Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

impl TestCluster {
    pub(super) fn start(nodes: usize, workers: usize) -> Self {
        let (url, database) = (nats(), database());
        let mut nats = NatsSettings::new(url, unused_name());
        nats.ack_wait = Duration::from_secs(2);
        let mut cluster = Self {
            runtime: runtime(),
            database,
            nats,
            folder: tempfile::tempdir().unwrap(),
            nodes: Vec::new(),
            workers: Vec::new(),
            started: 0,
        };
        (0..nodes).for_each(|_| cluster.start_node());
        (0..workers).for_each(|_| cluster.start_worker());
        cluster
    }

    async fn open(&self) -> (Cluster, Store) {
        let store = StoreSettings::Shared(self.settings());
        (Cluster::join(self.nats.clone()).await.unwrap(), Store::open(&store).await.unwrap())
    }

    /// Changes the store without notifying the cluster's processes.
    pub(super) fn behind_their_backs<T>(&self, work: impl AsyncFnOnce(&Store) -> T) -> T {
        self.runtime.block_on(async {
            let settings = StoreSettings::Shared(self.settings());
            let store = Store::open(&settings).await.unwrap();
            let done = work(&store).await;
            store.close().await;
            done
        })
    }

    /// Deletes the stream of events; the next process that starts creates it anew.
    pub(super) fn delete_events(&self) {
        self.runtime.block_on(async {
            let client = async_nats::connect(&self.nats.urls[0]).await.unwrap();
            let events = format!("{}_events", self.nats.name);
            jetstream::new(client).delete_stream(events).await.unwrap();
        });
    }

    fn own_folder(&mut self) -> std::path::PathBuf {
        self.started += 1;
        self.folder.path().join(self.started.to_string())
    }

    pub(super) fn start_node(&mut self) {
        let folder = self.own_folder();
        let node = self.runtime.block_on(async {
            let (cluster, store) = self.open().await;
            let events = cluster.subscribe().await;
            let node = Node { store, queue: cluster.queue_of_node(), events };
            let running = start_node(config(&folder), node, Arc::new(ManualClock::default())).await.unwrap();
            cluster.publish_events(running.service());
            running
        });
        self.nodes.push(node);
    }

    pub(super) fn start_worker(&mut self) {
        let folder = self.own_folder();
        let worker = self.runtime.block_on(async {
            let (cluster, store) = self.open().await;
            let config = config(&folder);
            let folders = ServiceFolders {
                libraries: folder.join("libraries"),
                recordings: folder.join("recordings"),
                uploads: folder.join("uploads"),
                streams: folder.join("streams"),
            };
            let role = Role::Worker(cluster.queue_of_worker());
            let clock = Arc::new(ManualClock::default());
            let service = Service::new(store, folders, &config.work, config.grid, clock, role).unwrap();
            cluster.publish_events(&service);
            let limits = WorkerLimits { at_once: 6, ..WorkerLimits::default() };
            (cluster.start_worker(service.clone(), limits), service)
        });
        self.workers.push(worker);
    }

    /// Starts a process that does upkeep but takes no records from the queue; its clock is ahead by some
    /// days.
    pub(super) fn keeper(&mut self, orphan_age: Duration, days_ahead: i64) -> Arc<Service> {
        let folder = self.own_folder();
        self.runtime.block_on(async {
            let mut settings = self.settings();
            settings.orphan_age = orphan_age;
            let cluster = Cluster::join(self.nats.clone()).await.unwrap();
            let store = Store::open(&StoreSettings::Shared(settings)).await.unwrap();
            let config = config(&folder);
            let folders = ServiceFolders {
                libraries: folder.join("libraries"),
                recordings: folder.join("recordings"),
                uploads: folder.join("uploads"),
                streams: folder.join("streams"),
            };
            let role = Role::Worker(cluster.queue_of_worker());
            let clock =
                Arc::new(move || jiff::Timestamp::now() + jiff::SignedDuration::from_hours(24 * days_ahead));
            let service = Service::new(store, folders, &config.work, config.grid, clock, role).unwrap();
            service.resume().await.unwrap();
            service
        })
    }

    /// Returns the settings of the store.
    pub(super) fn settings(&self) -> flankwatch::store::SharedSettings {
        self.database.settings(&self.objects_folder())
    }

    /// Returns the folder of the objects, if they are in one.
    pub(super) fn objects_folder(&self) -> std::path::PathBuf {
        self.folder.path().join("shared")
    }

    pub(super) fn stop_worker(&mut self) {
        let (worker, service) = self.workers.pop().unwrap();
        self.runtime.block_on(async {
            worker.stop().await;
            service.store.close().await;
        });
    }

    pub(super) fn client(&self, node: usize) -> Client {
        Client::new(self.nodes[node].url())
    }

    /// Waits until every worker has the library of an asset: earlier records would first be folded without
    /// it.
    pub(super) fn wait_for_libraries(&self, asset: &str) {
        let id = AssetId::new(asset).unwrap();
        let began = Instant::now();
        for (_, service) in &self.workers {
            let spec = self.runtime.block_on(service.store.asset(&id)).unwrap().spec;
            while !matches!(service.simulations.of(&spec).1.readiness, Readiness::Ready(_)) {
                assert!(began.elapsed() < Duration::from_secs(100), "a worker has no library of {asset}");
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }

    /// Returns the number of records that a worker stored.
    pub(super) fn stored_by(&self, worker: usize) -> u64 {
        self.workers[worker].1.record_counts.of(RecordOutcome::Stored)
    }

    /// Returns the number of states of channels that a worker read from the store.
    pub(super) fn states_read_by(&self, worker: usize) -> u64 {
        self.workers[worker].1.history.states_read()
    }

    /// Enqueues the payload of every message of the queue again, under other message IDs; every other one as
    /// a node of a version without partitions does.
    pub(super) fn redeliver(&self, run: impl FnOnce()) -> usize {
        let (url, subject) = (self.nats.urls[0].clone(), format!("{}.work", self.nats.name));
        let (client, mut messages) = self.runtime.block_on(async {
            let client = async_nats::connect(url).await.unwrap();
            let messages = client.subscribe(format!("{subject}.*")).await.unwrap();
            client.flush().await.unwrap();
            (client, messages)
        });
        run();
        self.runtime.block_on(async {
            let mut found = Vec::new();
            while let Ok(Some(message)) =
                tokio::time::timeout(Duration::from_millis(300), futures_util::StreamExt::next(&mut messages))
                    .await
            {
                found.push(message);
            }
            messages.unsubscribe().await.unwrap();
            for (n, message) in found.iter().enumerate() {
                let to = if n % 2 == 0 { message.subject.to_string() } else { subject.clone() };
                client.publish(to, message.payload.clone()).await.unwrap();
            }
            client.flush().await.unwrap();
            found.len()
        })
    }

    /// Returns the state of the queue and its workers.
    pub(super) fn overview(&self) -> QueueOverview {
        self.runtime
            .block_on(async { Cluster::connect(self.nats.clone()).await.unwrap().overview().await.unwrap() })
    }

    /// Waits until the workers own these numbers of partitions, in ascending order.
    #[track_caller]
    pub(super) fn wait_for_partitions(&self, expected: &[usize]) {
        let began = Instant::now();
        loop {
            let overview = self.overview();
            let mut owned: Vec<usize> = overview.workers.iter().map(|one| one.partitions.len()).collect();
            owned.sort_unstable();
            if owned == expected {
                assert_eq!(overview.partitions_unowned, 0);
                return;
            }
            assert!(began.elapsed() < Duration::from_secs(30), "still {owned:?}, expected {expected:?}");
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Runs `work` on the queue's server; it gets the name of the cluster.
    pub(super) fn on_server<T>(&self, work: impl AsyncFnOnce(jetstream::Context, &str) -> T) -> T {
        self.runtime.block_on(async {
            let client = async_nats::connect(&self.nats.urls[0]).await.unwrap();
            work(jetstream::new(client), &self.nats.name).await
        })
    }

    /// Returns the number of records in the queue, including those in work.
    pub(super) fn waiting(&self) -> u64 {
        self.runtime.block_on(async {
            let jetstream =
                async_nats::jetstream::new(async_nats::connect(&self.nats.urls[0]).await.unwrap());
            let stream = jetstream.get_stream(format!("{}_work", self.nats.name)).await.unwrap();
            stream.cached_info().state.messages
        })
    }
}

impl Drop for TestCluster {
    fn drop(&mut self) {
        let (workers, nodes) = (std::mem::take(&mut self.workers), std::mem::take(&mut self.nodes));
        self.runtime.block_on(async {
            for (worker, service) in workers {
                worker.stop().await;
                service.store.close().await;
            }
            for node in nodes {
                let _ = node.stop().await;
            }
            remove_streams(&self.nats.urls[0], &self.nats.name).await;
        });
    }
}

/// Deletes the streams of a cluster.
pub(super) async fn remove_streams(url: &str, name: &str) {
    let Ok(client) = async_nats::connect(url).await else {
        return;
    };
    let jetstream = async_nats::jetstream::new(client);
    for stream in ["work", "dead", "events", "attempts"] {
        let _ = jetstream.delete_stream(format!("{name}_{stream}")).await;
    }
}

/// A single machine with everything in its folder, as the reference.
pub(super) struct OneMachine {
    runtime: Runtime,
    running: Option<RunningService>,
    _folder: TempDir,
}

impl OneMachine {
    pub(super) fn start() -> Self {
        let (runtime, folder) = (runtime(), tempfile::tempdir().unwrap());
        let started = start(config(folder.path()), Arc::new(ManualClock::default()));
        let running = Some(runtime.block_on(started).unwrap());
        Self { runtime, running, _folder: folder }
    }

    pub(super) fn client(&self) -> Client {
        Client::new(self.running.as_ref().unwrap().url())
    }
}

impl Drop for OneMachine {
    fn drop(&mut self) {
        let running = self.running.take().unwrap();
        let _ = self.runtime.block_on(running.stop());
    }
}

/// Returns the description of an asset with a wear estimate and alarms.
pub(super) fn asset(id: &str) -> Value {
    json!({
        "id": id,
        "gear": {
            "teeth": [31, 62],
            "shaft_speed_hz": 10.0,
            "pair": {
                "name": "test pair",
                "geometry": { "teeth": [31, 62], "module_mm": 3.0, "face_width_mm": 20.0, "bore_radius_mm": [15.0, 30.0] },
                "operation": { "torque_nm": 60.0, "shaft_speed_hz": 10.0 },
            },
        },
        "baseline": { "records": 8 },
        "alarms": [
            { "quantity": { "indicator": "rms" }, "warning": 1.0, "danger": 1.5, "settings": { "raise": 1, "raise_of": 1, "clear": 1, "clear_of": 1 } },
            { "quantity": "novelty", "warning": 2 },
        ],
    })
}
