//! Schedules drawn from a seed: records are sent, repeated, deleted and excluded while disk operations fail
//! and the process is killed in the middle of one of them; unsynced writes are partly lost. After each
//! restart the state is compared with what was acknowledged, and with `flankwatch verify`.

use std::collections::BTreeMap;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use flankwatch::asset::{AssetId, AssetSpec, Segment, SegmentId};
use flankwatch::library::{EnsembleSettings, GridSettings};
use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch::service::{
    Accepted, RecordFormat, Role, Service, ServiceError, ServiceFolders, UploadMetadata, WorkLimits,
};
use flankwatch::store::{Disk, Finding, Objects, RecordRange, SegmentFilter, Store, StoreSettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::task::JoinSet;

use crate::forgetful_disk::ForgetfulDisk;
use crate::running::{ManualClock, plain_asset, record};

/// Default number of schedules.
const SCHEDULES: u64 = 100;

/// Number of processes of a schedule; all but the last one are killed.
const LIVES: u32 = 3;

const ASSETS: [&str; 2] = ["pump", "fan"];

/// Number of records per asset of a schedule.
const RECORDS: u32 = 8;

/// Timeout for a start to clean up after the process before, for a busy machine.
const MAX_SWEEP: Duration = Duration::from_secs(60);

/// The last response about a record.
#[derive(Debug, Clone, Default)]
struct Known {
    presence: Presence,
    id: Option<SegmentId>,
    is_excluded: Option<bool>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
enum Presence {
    #[default]
    Absent,
    Present,
    /// The last response was an error, or there was none.
    Unknown,
}

#[derive(Debug, Clone, Copy)]
enum Change {
    Upload,
    Delete,
    Exclude(bool),
}

type Key = (&'static str, u32);

/// One process on one folder.
struct Life {
    runtime: tokio::runtime::Runtime,
    service: Arc<Service>,
    disk: Arc<ForgetfulDisk>,
    folder: PathBuf,
}

fn bytes(n: u32) -> Bytes {
    encode_block(&record("1", n), BlockEncoding::Protobuf).into()
}

fn log_of(folder: &Path) -> Vec<u8> {
    fs::read(folder.join("flankwatch.db-wal")).unwrap_or_default()
}

/// The salt, by which one log differs from the next in the same file.
fn head(log: &[u8]) -> Vec<u8> {
    log.iter().take(32).copied().collect()
}

impl Life {
    fn begin(folder: PathBuf, seed: u64) -> Self {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let disk = Arc::new(ForgetfulDisk::new(seed, folder.join("flankwatch.db-wal")));
        let service = runtime.block_on(async {
            let on: Arc<dyn Disk> = disk.clone();
            let store = Store::open_on(&folder, on).await.unwrap();
            let folders = ServiceFolders {
                libraries: folder.join("libraries"),
                recordings: folder.join("recordings"),
                uploads: folder.join("uploads"),
                streams: folder.join("streams"),
            };
            let limits = WorkLimits {
                workers: 1,
                neighbours: EnsembleSettings::described_alone(),
                start_time_ahead: Duration::from_secs(10 * 365 * 24 * 3600),
                ..WorkLimits::default()
            };
            let clock = Arc::new(ManualClock::default());
            let grid = GridSettings::default();
            let service = Service::new(store, folders, &limits, grid, clock, Role::Standalone).unwrap();
            service.resume().await.unwrap();
            service
        });
        Self { runtime, service, disk, folder }
    }

    /// Waits until the cleanup is complete, and compares the state with the responses.
    fn check(&self, known: &mut BTreeMap<Key, Known>) {
        self.runtime.block_on(async {
            let began = Instant::now();
            loop {
                let audit = self.audit().await;
                let worse: Vec<&Finding> =
                    audit.iter().filter(|f| !matches!(f, Finding::Orphan(_))).collect();
                assert!(worse.is_empty(), "verify: {worse:?}");
                if audit.is_empty() {
                    break;
                }
                assert!(began.elapsed() < MAX_SWEEP, "still there: {audit:?}");
                tokio::task::yield_now().await;
            }
            for asset in ASSETS {
                let id = AssetId::new(asset).unwrap();
                let stored = self.service.store.segments(&id, &SegmentFilter::default(), 1000).await.unwrap();
                for n in 0..RECORDS {
                    let known = known.entry((asset, n)).or_default();
                    self.check_record(&stored, n, known);
                }
                assert!(stored.len() <= RECORDS as usize, "{asset}: more than was sent");
            }
        });
    }

    async fn audit(&self) -> Vec<Finding> {
        let settings = StoreSettings::from(self.folder.as_path());
        let store = Store::open_to_read(&settings).await.unwrap();
        let audit = store.audit(true, Duration::ZERO).await.unwrap();
        store.close().await;
        audit.findings
    }

    fn check_record(&self, stored: &[Segment], n: u32, known: &mut Known) {
        let sent = bytes(n);
        let name = Objects::name(&sent);
        let found: Vec<&Segment> = stored.iter().filter(|segment| segment.raw.sha256 == name).collect();
        assert!(found.len() <= 1, "record {n} is there {} times", found.len());
        match known.presence {
            Presence::Present => assert_eq!(found.len(), 1, "record {n} was acknowledged"),
            Presence::Absent => assert!(found.is_empty(), "record {n} was deleted, or never sent"),
            Presence::Unknown => {}
        }
        let Some(segment) = found.first() else {
            *known = Known::default();
            return;
        };
        assert_eq!(self.service.store.objects().get(&name).unwrap(), sent, "the bits of record {n}");
        if known.presence == Presence::Present {
            assert!(known.id.as_ref().is_none_or(|id| *id == segment.id), "record {n} has another name");
            let is_as_said = known.is_excluded.is_none_or(|is_excluded| is_excluded == segment.excluded);
            assert!(is_as_said, "record {n} is excluded: {}", segment.excluded);
        }
        // From here on the asset is acknowledged.
        *known = Known {
            presence: Presence::Present,
            id: Some(segment.id.clone()),
            is_excluded: Some(segment.excluded),
        };
    }

    /// Applies changes of different records concurrently, as far as the disk allows; returns their responses.
    fn make(&self, changes: &[(Key, Change)]) -> Vec<(Key, Change, Result<Option<SegmentId>, ServiceError>)> {
        let mut done = Vec::new();
        self.runtime.block_on(async {
            let mut under_way = JoinSet::new();
            for &(key, change) in changes {
                let service = Arc::clone(&self.service);
                under_way.spawn(async move { (key, change, make(&service, key, change).await) });
            }
            while let Some(ended) = under_way.join_next().await {
                // A response after the disk has stopped does not count.
                if self.disk.is_stopped() {
                    break;
                }
                done.push(ended.unwrap());
            }
        });
        done
    }

    /// Kills the process and copies what the disk kept to another folder.
    fn kill(self, to: PathBuf, random: &mut ChaCha8Rng) -> PathBuf {
        self.disk.stop();
        copy_folder(&self.folder.join("raw"), &to.join("raw"));
        self.disk.forget(&self.folder, &to);
        let database = self.folder.join("flankwatch.db");
        let log = loop {
            // Copied again if a checkpoint ran meanwhile.
            let before = (fs::metadata(&database).unwrap().modified().unwrap(), head(&log_of(&self.folder)));
            fs::copy(&database, to.join("flankwatch.db")).unwrap();
            let log = log_of(&self.folder);
            let after = (fs::metadata(&database).unwrap().modified().unwrap(), head(&log_of(&self.folder)));
            if before == after {
                break log;
            }
        };
        fs::write(to.join("flankwatch.db-wal"), self.torn(log, random)).unwrap();
        self.runtime.shutdown_background();
        to
    }

    /// The log as a crash leaves it: what was written after everything else stopped is there, in part, or
    /// not.
    fn torn(&self, mut log: Vec<u8>, random: &mut ChaCha8Rng) -> Vec<u8> {
        let at_end = self.disk.log_at_end();
        if head(&log) != head(&at_end) || log.len() <= at_end.len() {
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

async fn make(
    service: &Arc<Service>,
    (asset, n): Key,
    change: Change,
) -> Result<Option<SegmentId>, ServiceError> {
    let id = AssetId::new(asset).unwrap();
    let range = RecordRange { raw_sha256: Some(Objects::name(&bytes(n))), ..RecordRange::default() };
    match change {
        Change::Upload => {
            let ticket = service.workers.admit()?;
            let metadata = UploadMetadata::default();
            let accepted = service.pipeline.accept(&id, RecordFormat::Protobuf, bytes(n), metadata, ticket);
            Ok(accepted.await?.into_iter().next().map(|accepted| match accepted {
                Accepted::Stored(segment) | Accepted::Repeated(segment) => segment.id,
                Accepted::Queued(_) => panic!("there is no queue"),
            }))
        }
        Change::Delete => service.removals.remove(&id, &range).await.map(|_| None),
        Change::Exclude(is_excluded) => service.exclusions.set(&id, &range, is_excluded).await.map(|_| None),
    }
}

/// Returns what a response proves; `None` if it was an error or was not received.
fn learn(known: &mut Known, change: Change, answer: Option<Option<SegmentId>>) {
    match (change, answer) {
        (Change::Upload, Some(id)) => {
            if known.presence == Presence::Present {
                assert!(known.id.is_none() || known.id == id, "a repeat has another name: {known:?} {id:?}");
            } else {
                known.is_excluded = (known.presence == Presence::Absent).then_some(false);
            }
            (known.presence, known.id) = (Presence::Present, id);
        }
        (Change::Delete, Some(_)) => *known = Known::default(),
        (Change::Exclude(is_excluded), Some(_)) => known.is_excluded = Some(is_excluded),
        // A repeat of a stored record changes nothing.
        (Change::Upload, None) if known.presence == Presence::Present => {}
        (Change::Upload | Change::Delete, None) => known.presence = Presence::Unknown,
        (Change::Exclude(_), None) => known.is_excluded = None,
    }
}

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

/// Draws different records, each with an operation.
fn some_changes(random: &mut ChaCha8Rng) -> Vec<(Key, Change)> {
    let mut changes = BTreeMap::new();
    for _ in 0..random.random_range(1..=4) {
        let key = (ASSETS[random.random_range(0..ASSETS.len())], random.random_range(0..RECORDS));
        let change = match random.random_range(0..10) {
            0..=6 => Change::Upload,
            7 => Change::Delete,
            _ => Change::Exclude(random.random_bool(0.6)),
        };
        changes.insert(key, change);
    }
    changes.into_iter().collect()
}

fn run(seed: u64, folder: &Path) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut known = BTreeMap::new();
    let mut place = folder.join("0");
    for n in 0..LIVES {
        let life = Life::begin(place, random.random());
        if n == 0 {
            for asset in ASSETS {
                let spec: AssetSpec = serde_json::from_value(plain_asset(asset)).unwrap();
                life.runtime.block_on(life.service.assets.create(&spec)).unwrap();
            }
        }
        life.check(&mut known);
        if n + 1 == LIVES {
            break;
        }
        life.disk.fail(if random.random_bool(0.5) { 0.0 } else { random.random_range(0.0..0.1) });
        let at = random.random_range(1..60);
        life.disk.stop_after(at);
        for _ in 0..random.random_range(1..12) {
            let changes = some_changes(&mut random);
            let answers = life.make(&changes);
            for &(key, change) in &changes {
                let is_answered = answers.iter().any(|answer| answer.0 == key);
                if !is_answered {
                    learn(known.entry(key).or_default(), change, None);
                }
            }
            for (key, change, answer) in answers {
                learn(known.entry(key).or_default(), change, answer.ok());
            }
            if life.disk.is_stopped() {
                break;
            }
        }
        place = life.kill(folder.join((n + 1).to_string()), &mut random);
    }
}

fn variable(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|value| value.parse().unwrap())
}

/// `FLANKWATCH_FAULT_SCHEDULES` sets the number of schedules, `FLANKWATCH_FAULT_SEED` the first seed.
#[test]
fn every_schedule_keeps_acknowledged_data() {
    let schedules = variable("FLANKWATCH_FAULT_SCHEDULES").unwrap_or(SCHEDULES);
    let first = variable("FLANKWATCH_FAULT_SEED").unwrap_or(1);
    let next = AtomicU64::new(first);
    // Uses a file system in memory, if there is one.
    let memory = Path::new("/dev/shm");
    let began = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + schedules {
                        break;
                    }
                    let folder = if memory.is_dir() {
                        tempfile::tempdir_in(memory).unwrap()
                    } else {
                        tempfile::tempdir().unwrap()
                    };
                    if catch_unwind(AssertUnwindSafe(|| run(seed, folder.path()))).is_err() {
                        next.store(u64::MAX / 2, Ordering::Relaxed);
                        panic!(
                            "schedule {seed} failed; again: FLANKWATCH_FAULT_SCHEDULES=1 FLANKWATCH_FAULT_SEED={seed} \
                             cargo test --test faults seeded"
                        );
                    }
                }
            });
        }
    });
    eprintln!("{schedules} schedules from seed {first} in {:.0} s", began.elapsed().as_secs_f64());
}
