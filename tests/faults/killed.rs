//! The program killed at random moments while it is written to: what it acknowledged is stored exactly once,
//! and nothing else changes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::program::Program;
use crate::running::asset_with_pair;

/// Default number of rounds; a hundred take minutes.
const ROUNDS: u32 = 4;

/// Number of concurrent upload connections.
const CONNECTIONS: u32 = 4;

/// Timeout for recomputing the histories of thousands of records on a busy machine.
const MAX_RECOMPUTATION: Duration = Duration::from_secs(600);

/// Returns the first record that differs between two histories.
fn first_difference(one: &[Value], other: &[Value]) -> Option<(Value, Value)> {
    let rows = |history: &[Value]| -> Vec<Value> {
        history.iter().flat_map(|rows| rows.as_array().cloned().unwrap_or_default()).collect()
    };
    let (one, other) = (rows(one), rows(other));
    let different = |(one, other): &(Value, Value)| one != other;
    one.into_iter().zip(other).find(different)
}

/// Returns the raw objects of a folder: files named by a hash, in folders of two characters.
fn raw_objects(folder: &Path) -> usize {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return 0;
    };
    let shards = entries.flatten().filter(|entry| entry.file_name().len() == 2);
    let objects = shards.flat_map(|shard| std::fs::read_dir(shard.path()).unwrap().flatten());
    objects.filter(|object| object.path().extension().is_none()).count()
}

/// Returns a segment's indicators without the one that depends on earlier records, which a late record
/// changes.
fn of_itself(segment: &Value) -> Value {
    let mut indicators = segment["indicators"].clone();
    indicators.as_object_mut().unwrap().remove("novelty");
    indicators
}

/// Runs `flankwatch verify` on a data folder and returns its output.
fn verified(folder: &Path) -> String {
    let mut verify = Command::new(env!("CARGO_BIN_EXE_flankwatch"));
    let output = verify.arg("verify").arg("--data-dir").arg(folder).output().unwrap();
    String::from_utf8(output.stdout).unwrap() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn acknowledged_records_survive_kills_at_random_moments() {
    let rounds = std::env::var("FLANKWATCH_KILL_ROUNDS").map_or(ROUNDS, |rounds| rounds.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(20_260_101);
    let next = AtomicU32::new(0);
    let acknowledged: Mutex<BTreeMap<u32, Value>> = Mutex::default();
    let (mut unacknowledged, mut repaired) = (0, 0);
    let first = Program::start(folder.path());
    for asset in ["killed", "undisturbed"] {
        first.make(&asset_with_pair(asset, 20.0));
    }
    let began = Instant::now();
    while first.get("/v1/assets/killed")["summary"]["library_state"] != "ready" {
        assert!(began.elapsed() < Duration::from_secs(300), "{}", first.log());
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
            // Killed first, so that requests are cut off, then the senders are stopped.
            let mut killed = Command::new("kill");
            killed.args(["-9", &running.id().to_string()]);
            assert!(killed.status().unwrap().success());
            gone.store(true, Ordering::Relaxed);
        });
        running.kill();
        // Before any cleanup, every object in the database exists and is intact.
        let output = verified(folder.path());
        let lacks = output.lines().find(|line| line.contains("missing") || line.contains("damaged"));
        assert!(lacks.is_none(), "round {round}: {output}");
        let after = Program::start(folder.path());
        let stored = after.segments("killed");
        let known = acknowledged.lock().unwrap();
        for (n, segment) in known.iter() {
            let id = segment["id"].as_str().unwrap();
            assert_eq!(stored.get(id), Some(&1), "round {round}: record {n} was acknowledged");
        }
        // Only sent records are stored, and no raw object stays without its record.
        assert!(stored.len() <= next.load(Ordering::Relaxed) as usize);
        unacknowledged = stored.len() - known.len();
        drop(known);
        let began = Instant::now();
        while raw_objects(&folder.path().join("raw")) != stored.len() {
            assert!(
                began.elapsed() < Duration::from_secs(30),
                "round {round}: {} raw objects of {} records",
                raw_objects(&folder.path().join("raw")),
                stored.len()
            );
            std::thread::sleep(Duration::from_millis(5));
        }
        repaired += usize::from(after.log().contains("quarantine"));
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
        // Very late records are folded in the background, and everything again when the ensemble is complete,
        // which is at different times for the two assets.
        let (killed, undisturbed) = (program.history("killed"), program.history("undisturbed"));
        if killed == undisturbed {
            break;
        }
        assert!(
            began.elapsed() < MAX_RECOMPUTATION,
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
         {repaired} starts that put something away"
    );
    program.kill();
    assert!(
        verified(folder.path()).starts_with(&format!("{} records", 2 * sent)),
        "{}",
        verified(folder.path())
    );
}
