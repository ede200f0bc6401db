//! System calls that fail at random below SQLite and the raw objects: what was acknowledged is stored exactly
//! once, and the service recovers when the disk does.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use flankwatch::recording::{BlockEncoding, encode_block};
use flankwatch_test_support::needed;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::program::Program;
use crate::running::{plain_asset, record};

/// Default number of rounds.
const ROUNDS: u64 = 6;

/// Records sent in each round while calls fail.
const RECORDS: u32 = 40;

/// The calls that fail, as libfiu names them. `write` is not among them: the asynchronous runtime cannot go
/// on without its own pipes.
const CALLS: [&str; 9] = [
    "posix/io/rw/pread",
    "posix/io/rw/pwrite",
    "posix/io/rw/pread/reduce",
    "posix/io/rw/pwrite/reduce",
    "posix/io/rw/ftruncate",
    "posix/io/sync/fsync",
    "posix/io/sync/fdatasync",
    "posix/io/dir/rename",
    "posix/io/dir/unlink",
];

/// Where Debian's package `fiu-utils` has its libraries.
const LIBFIU: &str = "/usr/lib/fiu";

/// Timeout for taking records again once calls succeed.
const MAX_RECOVERY: Duration = Duration::from_secs(120);

/// Starts the program with libfiu below it; no call fails yet.
fn start(folder: &Path, control: &Path) -> Program {
    let libraries = ["fiu_run_preload.so", "fiu_posix_preload.so"]
        .map(|name| PathBuf::from(LIBFIU).join(name))
        .map(|path| needed(path.is_file().then_some(path), "libfiu (apt-get install fiu-utils)"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_flankwatch"));
    command.env("LD_PRELOAD", std::env::join_paths(libraries).unwrap()).env("FIU_CTRL_FIFO", control);
    Program::start_by(command, folder, &[])
}

/// Sends a command to the libfiu of a running program.
fn control(program: &Program, control: &Path, command: &str) {
    let id = program.id().to_string();
    let output = Command::new("fiu-ctrl").arg("-f").arg(control).args(["-c", command, &id]).output().unwrap();
    assert!(output.status.success(), "{command}: {output:?}");
}

/// Sends a record; returns its identifier if it was acknowledged.
fn upload(program: &Program, n: u32) -> Option<String> {
    let block = encode_block(&record("1", n), BlockEncoding::Protobuf);
    let headers = [("content-type", "application/x-protobuf")];
    let mut answer = program.send("POST", "/v1/assets/pump/segments", &headers, &block);
    let status = answer.status().as_u16();
    let text = answer.body_mut().read_to_string().unwrap();
    if status == 201 {
        let segment: Value = serde_json::from_str(&text).unwrap();
        return Some(segment["id"].as_str().unwrap().to_owned());
    }
    assert!([500, 503, 507].contains(&status), "{status}: {text}");
    None
}

#[test]
#[ignore = "needs libfiu (apt-get install fiu-utils)"]
fn acknowledged_records_survive_failing_system_calls() {
    let rounds = std::env::var("FLANKWATCH_CALL_ROUNDS").map_or(ROUNDS, |rounds| rounds.parse().unwrap());
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("data");
    let pipes = place.path().join("control");
    let mut acknowledged = BTreeSet::new();
    let (mut n, mut refused) = (0, 0);
    for round in 0..rounds {
        let mut random = ChaCha8Rng::seed_from_u64(round);
        let program = start(&folder, &pipes);
        if round == 0 {
            program.make(&plain_asset("pump"));
        }
        let failing: Vec<&str> =
            (0..random.random_range(1..=3)).map(|_| *CALLS.choose(&mut random).unwrap()).collect();
        for call in &failing {
            let probability = 10_f64.powf(random.random_range(-2.5..-1.0));
            control(&program, &pipes, &format!("enable_random name={call},probability={probability}"));
        }
        for _ in 0..RECORDS {
            match upload(&program, n) {
                Some(id) => assert!(acknowledged.insert(id), "round {round}: acknowledged twice"),
                None => refused += 1,
            }
            n += 1;
        }
        for call in &failing {
            control(&program, &pipes, &format!("disable name={call}"));
        }
        // The same process takes records again.
        let began = Instant::now();
        loop {
            let id = upload(&program, n);
            n += 1;
            if let Some(id) = id {
                acknowledged.insert(id);
                break;
            }
            assert!(began.elapsed() < MAX_RECOVERY, "round {round}, {failing:?}: {}", program.log());
            std::thread::sleep(Duration::from_millis(100));
        }
        let check = |program: &Program| {
            let stored = program.segments("pump");
            for id in &acknowledged {
                assert_eq!(
                    stored.get(id),
                    Some(&1),
                    "round {round}, {failing:?}: record {id} was acknowledged"
                );
            }
        };
        check(&program);
        program.kill();
        let program = Program::start(&folder);
        check(&program);
        program.kill();
        let mut verify = Command::new(env!("CARGO_BIN_EXE_flankwatch"));
        let output = verify.args(["verify", "--data-dir"]).arg(&folder).output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout);
        let lacks = text.lines().find(|line| line.contains("missing") || line.contains("damaged"));
        assert!(lacks.is_none(), "round {round}, {failing:?}: {text}");
    }
    println!("{n} records sent, {refused} refused, {} acknowledged, none lost", acknowledged.len());
    assert!(refused > 0 && acknowledged.len() > rounds as usize);
}
