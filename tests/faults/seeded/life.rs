//! One process of a schedule: its start on a folder, and the copy of the folder that its end leaves.

use std::fs;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use flankwatch::asset::{AssetId, AssetSpec, Segment};
use flankwatch::http::{RunningService, ServiceConfig, start_on};
use flankwatch::library::EnsembleSettings;
use flankwatch::service::{Clock, Role, Service, ServiceFolders};
use flankwatch::store::{Disk, SegmentFilter, Store};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use tokio::runtime::{Builder, Runtime};

use crate::forgetful_disk::ForgetfulDisk;
use crate::running::ManualClock;

/// Timeout for a start to finish the work of the process before, for a busy machine.
const MAX_WORK: Duration = Duration::from_secs(60);

/// One process on one folder.
pub(super) struct Life {
    runtime: Runtime,
    service: Arc<Service>,
    /// The service over HTTP.
    running: Option<RunningService>,
    pub(super) disk: Arc<ForgetfulDisk>,
    pub(super) clock: Arc<ManualClock>,
    folder: PathBuf,
}

impl Life {
    /// Starts a process, by a clock that stands still `minutes` after the first start. Resumable uploads need
    /// HTTP, whose start takes longer than everything else.
    pub(super) fn begin(folder: PathBuf, seed: u64, minutes: u32, is_on_http: bool) -> Self {
        // One thread is enough, unless a server has to run beside its client.
        let mut builder =
            if is_on_http { Builder::new_multi_thread() } else { Builder::new_current_thread() };
        let runtime = builder.worker_threads(1).enable_all().build().unwrap();
        let disk = Arc::new(ForgetfulDisk::new(seed, log_of(&folder)));
        let mut config = ServiceConfig::new(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), &folder);
        config.work.workers = 1;
        config.work.simulation_threads = 1;
        config.work.ensemble = EnsembleSettings::described_alone();
        config.work.start_time_ahead = Duration::from_secs(10 * 365 * 24 * 3600);
        let on: Arc<dyn Disk> = disk.clone();
        let clock = Arc::new(ManualClock::default());
        clock.advance(i64::from(minutes) * 60);
        let on_clock: Arc<dyn Clock> = clock.clone();
        let (service, running) = runtime.block_on(async {
            let store = Store::open_on(&folder, on).await.unwrap();
            if is_on_http {
                let running = start_on(config, store, on_clock).await.unwrap();
                return (Arc::clone(running.service()), Some(running));
            }
            let folders = ServiceFolders::in_data_folder(&folder);
            let service =
                Service::new(store, folders, &config.work, config.grid, on_clock, Role::Standalone).unwrap();
            service.resume().await.unwrap();
            (service, None)
        });
        Self { runtime, service, running, disk, clock, folder }
    }

    pub(super) fn service(&self) -> &Arc<Service> {
        &self.service
    }

    pub(super) fn url(&self, path: &str) -> String {
        format!("{}{path}", self.running.as_ref().unwrap().url())
    }

    pub(super) fn block_on<T>(&self, work: impl Future<Output = T>) -> T {
        self.runtime.block_on(work)
    }

    pub(super) fn make_asset(&self, description: &Value) {
        let spec: AssetSpec = serde_json::from_value(description.clone()).unwrap();
        self.block_on(self.service().assets.create(&spec)).unwrap();
    }

    /// The stored records of an asset in the order of time.
    pub(super) fn stored(&self, asset: &str) -> Vec<Segment> {
        let (id, filter) = (AssetId::new(asset).unwrap(), SegmentFilter::default());
        let mut stored = self.block_on(self.service().store.segments(&id, &filter, 1000)).unwrap();
        stored.sort_by_key(|segment| segment.start_time);
        stored
    }

    /// Waits until `look` returns a value.
    pub(super) fn wait_for<T>(&self, what: &str, look: impl AsyncFn() -> Option<T>) -> T {
        let began = Instant::now();
        self.block_on(async {
            loop {
                if let Some(found) = look().await {
                    break found;
                }
                assert!(began.elapsed() < MAX_WORK, "waited too long for {what}");
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        })
    }

    /// Removes what a killed process left without a record, and expects `flankwatch verify` to find nothing.
    pub(super) fn sweep_and_verify(&self) {
        let audit = self.block_on(async {
            self.service.sweep().await.unwrap();
            self.service.store.audit(true, Duration::ZERO).await.unwrap()
        });
        assert!(audit.findings.is_empty(), "verify: {:?}", audit.findings);
    }

    /// Ends the process in order.
    pub(super) fn end(self) {
        match self.running {
            Some(running) => self.runtime.block_on(running.stop()).unwrap(),
            None => self.runtime.block_on(self.service.store.close()),
        }
        // Nothing is written to the folder of objects from here on.
        self.runtime.shutdown_timeout(MAX_WORK);
    }

    /// Ends the process, loses its database, and builds it anew from the raw recordings in another folder.
    pub(super) fn rebuild(self, to: PathBuf, assets: &[&str]) -> Self {
        for asset in assets {
            let id = AssetId::new(*asset).unwrap();
            self.wait_for("the metadata of an asset", async || {
                let excluded = self.service.store.excluded(&id).await.unwrap();
                let metadata = self.service.store.objects().asset_metadata(&id).unwrap();
                metadata.filter(|metadata| metadata.excluded == excluded)
            });
        }
        let raw = self.folder.join("raw");
        self.end();
        copy_folder(&raw, &to.join("raw"));
        let life = Self::begin(to, 0, 0, false);
        let rebuilt = life.block_on(life.service.rebuild(false, |_, _| {})).unwrap();
        assert_eq!(rebuilt.failed, 0, "{rebuilt:?}");
        life
    }

    /// Kills the process and copies what the disk kept to another folder.
    pub(super) fn kill(self, to: PathBuf, random: &mut ChaCha8Rng) -> PathBuf {
        self.disk.stop();
        for name in ["raw", "streams"] {
            let folder = self.folder.join(name);
            if folder.is_dir() {
                copy_folder(&folder, &to.join(name));
            }
        }
        self.disk.forget(&self.folder, &to);
        let database = self.folder.join("flankwatch.db");
        let log = loop {
            // Copied again if a checkpoint ran meanwhile.
            let before = self.head();
            fs::copy(&database, to.join("flankwatch.db")).unwrap();
            let log = read_log(&self.folder);
            if before == self.head() {
                break log;
            }
        };
        fs::write(log_of(&to), self.torn(log, random)).unwrap();
        self.runtime.shutdown_background();
        to
    }

    /// What a checkpoint changes: when the database was written, and the salt of its log, by which one log
    /// differs from the next in the same file.
    fn head(&self) -> (std::time::SystemTime, Vec<u8>) {
        let database = fs::metadata(self.folder.join("flankwatch.db")).unwrap();
        (database.modified().unwrap(), salt(&read_log(&self.folder)).to_vec())
    }

    /// The log as a crash leaves it: what was written after everything else stopped is there, in part, or
    /// not.
    fn torn(&self, mut log: Vec<u8>, random: &mut ChaCha8Rng) -> Vec<u8> {
        let at_end = self.disk.log_at_end();
        if salt(&log) != salt(&at_end) || log.len() <= at_end.len() {
            return log;
        }
        log.truncate(random.random_range(at_end.len()..=log.len()));
        for sector in log[at_end.len()..].chunks_mut(512) {
            if random.random_bool(0.05) {
                sector.fill(0);
            }
        }
        log
    }
}

fn log_of(folder: &Path) -> PathBuf {
    folder.join("flankwatch.db-wal")
}

fn read_log(folder: &Path) -> Vec<u8> {
    fs::read(log_of(folder)).unwrap_or_default()
}

fn salt(log: &[u8]) -> &[u8] {
    &log[..log.len().min(32)]
}

/// Copies a folder with everything in it.
fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let copy = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_folder(&entry.path(), &copy);
        } else {
            fs::copy(entry.path(), copy).unwrap();
        }
    }
}
