//! Schedules drawn from a seed: records, and resumable uploads or a live stream are sent, and records deleted
//! and excluded, while disk operations fail and the process is killed in the middle of one of them; unsynced
//! writes are partly lost. After each restart the state is compared with what was acknowledged, and with
//! `flankwatch verify`.

mod life;
mod records;
mod stream;
mod uploads;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;
use std::{fs, io};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;

use life::Life;
use records::{KnownRecords, SentRecords};
use stream::KnownStream;
use uploads::KnownUploads;

/// Default number of schedules.
const SCHEDULES: u64 = 100;

/// Number of schedules after which the progress is printed.
const PROGRESS: u64 = 1000;

/// Number of processes of a schedule; all but the last one are killed.
const LIVES: u32 = 3;

/// Part of the schedules that have resumable uploads; the others have a stream.
const UPLOADING: f64 = 0.25;

/// Part of the schedules that end with a lost database.
const REBUILT: f64 = 0.1;

/// What was acknowledged in a schedule.
struct Known<'a> {
    records: KnownRecords<'a>,
    stream: KnownStream,
    uploads: KnownUploads,
}

impl Known<'_> {
    /// Waits until the work that the previous process left is done, and compares the state with what was
    /// acknowledged.
    fn check(&mut self, life: &Life) {
        self.uploads.check(life);
        self.stream.check(life);
        life.sweep_and_verify();
        self.records.check(life);
    }

    /// Loses the database, and compares the one that is built anew from the raw recordings.
    fn check_rebuilt(&self, life: Life, to: PathBuf) {
        let counts = |life: &Life| [stream::ASSET, uploads::ASSET].map(|asset| life.stored(asset).len());
        let before = counts(&life);
        let life = life.rebuild(to, &records::ASSETS);
        assert_eq!(counts(&life), before);
        self.records.check_rebuilt(&life);
        life.sweep_and_verify();
        life.end();
    }
}

/// The files of a data folder by their relative paths.
type Files = BTreeMap<PathBuf, Vec<u8>>;

/// A data folder with all assets, made once, so that schedules need not migrate a database.
fn make_template(sent: &SentRecords) -> Files {
    let made = folder();
    let life = Life::begin(made.path().to_path_buf(), 0, 0, true);
    for spec in sent.assets().chain([stream::asset(), uploads::asset()]) {
        life.make_asset(&spec);
    }
    life.end();
    // A connection that was being opened closes the database in a thread of its own, and may remove its log.
    let mut last = Files::new();
    loop {
        match read_files(made.path(), Path::new("")) {
            Ok(files) if files == last => return files,
            files => last = files.unwrap_or_default(),
        }
    }
}

/// Reads the files in a folder and in the folders below it.
fn read_files(root: &Path, path: &Path) -> io::Result<Files> {
    let mut files = Files::new();
    for entry in fs::read_dir(root.join(path))? {
        let entry = entry?;
        let path = path.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            files.extend(read_files(root, &path)?);
        } else {
            files.insert(path, fs::read(entry.path())?);
        }
    }
    Ok(files)
}

fn write_files(files: &Files, root: &Path) {
    for (path, bytes) in files {
        let path = root.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
}

fn run(seed: u64, template: &Files, sent: &SentRecords, folder: &Path) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut known = Known {
        records: KnownRecords::new(sent),
        stream: KnownStream::default(),
        uploads: KnownUploads::default(),
    };
    let has_uploads = random.random_bool(UPLOADING);
    let mut place = folder.join("0");
    write_files(template, &place);
    for n in 0..LIVES {
        let life = Life::begin(place, random.random(), n, has_uploads);
        known.check(&life);
        if n + 1 == LIVES {
            if random.random_bool(REBUILT) {
                known.check_rebuilt(life, folder.join("anew"));
            }
            break;
        }
        life.disk.fail(if random.random_bool(0.5) { 0.0 } else { random.random_range(0.0..0.1) });
        life.disk.stop_after(random.random_range(1..80));
        for _ in 0..random.random_range(1..12) {
            match random.random_range(0..10) {
                0..=5 => known.records.make(&life, &mut random),
                6..=9 if has_uploads => known.uploads.send(&life, &mut random),
                _ => known.stream.send(&life, &mut random),
            }
            life.clock.advance(1);
            if life.disk.is_stopped() {
                break;
            }
        }
        known.stream.end_of_life();
        place = life.kill(folder.join((n + 1).to_string()), &mut random);
    }
}

fn variable(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|value| value.parse().unwrap())
}

/// A folder in memory, if there is a file system for it.
fn folder() -> TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

/// Keeps this thread, and the threads that it starts, on one of the processor's cores: they wait for each
/// other all the time, and waking a thread on another core takes longer than the work between two waits.
#[cfg(target_os = "linux")]
fn stay_on_core(n: usize) {
    use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
    let allowed = sched_getaffinity(None).unwrap();
    let mut core = CpuSet::new();
    core.set((0..CpuSet::MAX_CPU).filter(|core| allowed.is_set(*core)).nth(n).unwrap());
    sched_setaffinity(None, &core).unwrap();
}

#[cfg(not(target_os = "linux"))]
fn stay_on_core(_: usize) {}

/// `FLANKWATCH_FAULT_SCHEDULES` sets the number of schedules, `FLANKWATCH_FAULT_SEED` the first seed.
#[test]
fn every_schedule_keeps_acknowledged_data() {
    let schedules = variable("FLANKWATCH_FAULT_SCHEDULES").unwrap_or(SCHEDULES);
    let first = variable("FLANKWATCH_FAULT_SEED").unwrap_or(1);
    let next = AtomicU64::new(first);
    let sent = SentRecords::new();
    let template = make_template(&sent);
    let began = Instant::now();
    std::thread::scope(|scope| {
        let (next, sent, template) = (&next, &sent, &template);
        for core in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(move || {
                stay_on_core(core);
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + schedules {
                        break;
                    }
                    if seed > first && (seed - first).is_multiple_of(PROGRESS) {
                        eprintln!("{} schedules in {:.0} s", seed - first, began.elapsed().as_secs_f64());
                    }
                    let folder = folder();
                    let run = || run(seed, template, sent, folder.path());
                    if catch_unwind(AssertUnwindSafe(run)).is_err() {
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
