//! `flankwatch stream` during kills of it and of its server, and on a link that is cut: the stored samples
//! are those that it read, by index, bit for bit.

use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{asset, frames, free_address, rounds, start_at, stored};
use crate::program::Program;
use crate::proxy::{Proxy, Wire};

/// Samples of a block, which is sent when it is complete.
const BLOCK: u64 = 1000;

#[test]
fn a_sender_killed_at_random_moments_resumes_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2_122);
    let program = Program::start(&folder.path().join("data"));
    program.make(&asset());
    let path = folder.path().join("samples.raw");
    let mut file = std::fs::File::create(&path).unwrap();
    let send = |more: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_flankwatch"))
            .arg("stream")
            .arg(&path)
            .args(["--asset", "pump", "--url", program.url(), "--sample", "f32", "--rate", "4000"])
            .args(["--channels", "2", "--start-time", "1970-01-01T00:00:00Z"])
            .args(more)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    };
    let mut written = 0;
    for _ in 0..rounds() {
        let mut child = send(&["--follow"]);
        for _ in 0..4 {
            let count = random.random_range(1..8000);
            file.write_all(&frames(written, count)).unwrap();
            written += count;
            std::thread::sleep(Duration::from_millis(random.random_range(0..150)));
        }
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let end = (written / 2000 + 1) * 2000;
    file.write_all(&frames(written, end - written)).unwrap();
    assert!(send(&[]).wait().unwrap().success());
    assert!(
        stored(&program, end / 2000) == frames(0, end),
        "the stored samples are not those that were sent"
    );
    program.kill();
}

/// Starts `flankwatch stream` with raw samples from standard input.
fn sender(url: &str, spool: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_flankwatch"))
        .args(["stream", "-", "--asset", "pump", "--url", url, "--sample", "f32", "--rate", "4000"])
        .args(["--channels", "2", "--start-time", "1970-01-01T00:00:00Z", "--spool"])
        .arg(spool)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

#[test]
fn a_sender_resumes_when_its_server_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let spool = folder.path().join("spool");
    let data = folder.path().join("data");
    let address = free_address();
    let program = start_at(&data, &address);
    program.make(&asset());
    let mut child = sender(program.url(), &spool);
    let mut pipe = child.stdin.take().unwrap();
    pipe.write_all(&frames(0, 6000)).unwrap();
    wait_until_kept(&program, 6000);
    program.kill();
    // More than fits in memory.
    pipe.write_all(&frames(6000, 534_000)).unwrap();
    let program = start_at(&data, &address);
    wait_until_kept(&program, 540_000);
    drop(pipe);
    assert!(child.wait().unwrap().success());
    let left =
        std::fs::read_dir(&spool).unwrap().flatten().filter(|entry| entry.path().extension().is_some());
    assert_eq!(left.count(), 0);
    assert!(stored(&program, 270) == frames(0, 540_000), "the stored samples are not those that were sent");
    program.kill();
}

/// Waits until the service has every sample before an index.
fn wait_until_kept(program: &Program, next: u64) {
    let began = Instant::now();
    while program.get("/v1/assets/pump/streams")["items"][0]["next"] != next {
        assert!(began.elapsed() < Duration::from_secs(100), "{}", program.log());
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_sender_goes_on_after_each_kill_of_its_server_and_each_cut_of_its_link() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2_123);
    let (data, address) = (folder.path().join("data"), free_address());
    let mut program = start_at(&data, &address);
    program.make(&asset());
    let proxy = Proxy::to(address.parse().unwrap());
    let mut child = sender(&format!("http://{}", proxy.address()), &folder.path().join("spool"));
    let mut pipe = child.stdin.take().unwrap();
    let mut written = 0;
    let mut write = |count: u64| {
        pipe.write_all(&frames(written, count)).unwrap();
        written += count;
        written
    };
    let mut faults = [Some(Wire::Closed), Some(Wire::Silent), None].repeat(rounds() as usize);
    faults.shuffle(&mut random);
    for fault in faults {
        write(random.random_range(1..8000));
        std::thread::sleep(Duration::from_millis(random.random_range(0..50)));
        match fault {
            Some(wire) => proxy.set(wire),
            None => {
                program.kill();
                program = start_at(&data, &address);
            }
        }
        let next = write(random.random_range(1..8000));
        std::thread::sleep(Duration::from_millis(random.random_range(0..100)));
        // What was silent is refused when the link is back.
        proxy.set(Wire::Closed);
        proxy.set(Wire::Whole);
        wait_until_kept(&program, next / BLOCK * BLOCK);
    }
    let sent = write(0);
    let end = write(2000 - sent % 2000);
    drop(pipe);
    assert!(child.wait().unwrap().success());
    assert!(
        stored(&program, end / 2000) == frames(0, end),
        "the stored samples are not those that were sent"
    );
    assert_eq!(program.get("/v1/assets/pump/stream")["gaps"], 0);
    program.kill();
}
