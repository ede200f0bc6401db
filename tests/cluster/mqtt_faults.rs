//! Broker restarts and killed services: every message that a broker has accepted becomes one record in the
//! end.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use flankwatch::recording::{BlockEncoding, encode_block};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::broker::{Broker, LONGEST, Sender};
use crate::mqtt::{feed, metric, topic, wait_for_records};
use crate::program::Program;
use crate::running::{Service, plain_asset, record};

/// Default number of rounds.
const ROUNDS: u32 = 4;

fn rounds() -> u32 {
    std::env::var("FLANKWATCH_KILL_ROUNDS").map_or(ROUNDS, |rounds| rounds.parse().unwrap())
}

fn send(sender: &mut Sender, n: u32) {
    let block = encode_block(&record("1", n), BlockEncoding::Protobuf);
    sender.send(&topic("flankwatch", "pump", "1"), &block);
}

#[test]
#[ignore = "needs mosquitto"]
fn a_broker_restart_loses_nothing() {
    let mut broker = Broker::start();
    let service = Service::start();
    service.plain_asset("pump");
    let feed = feed(&service, broker.port, "flankwatch", "");
    service.wait_for("/readyz", |ready| ready["feeds"][0]["is_connected"] == true);
    let port = broker.port;
    let is_over = AtomicBool::new(false);
    let rounds = rounds();
    let sent = std::thread::scope(|scope| {
        // A device that sends a message until the broker acknowledges it.
        let sending = scope.spawn(|| {
            let mut sender = Sender::connect(port);
            let mut n = 0;
            while !is_over.load(Ordering::Relaxed) {
                send(&mut sender, n);
                n += 1;
                std::thread::sleep(Duration::from_millis(5));
            }
            n
        });
        for _ in 0..rounds {
            std::thread::sleep(Duration::from_millis(200));
            broker.end("-TERM");
            service.wait_for("/readyz", |ready| ready["feeds"][0]["is_connected"] == false);
            broker.launch();
            service.wait_for("/readyz", |ready| ready["feeds"][0]["is_connected"] == true);
        }
        is_over.store(true, Ordering::Relaxed);
        sending.join().unwrap()
    });
    assert!(sent > rounds, "{sent} sent");
    wait_for_records(&service, sent);
    let reconnects = metric(&service, "flankwatch_feed_reconnects_total{feed=\"mqtt\"}");
    assert!(reconnects >= f64::from(rounds), "{reconnects} in {rounds} rounds");
    // A killed broker loses what it did not write; a device that sends everything again creates no
    // duplicates.
    broker.end("-KILL");
    broker.launch();
    service.wait_for("/readyz", |ready| ready["feeds"][0]["is_connected"] == true);
    let mut sender = Sender::connect(port);
    for n in 0..=sent {
        send(&mut sender, n);
    }
    wait_for_records(&service, sent + 1);
    service.run(feed.stop(LONGEST));
}

#[test]
#[ignore = "needs mosquitto"]
fn a_service_killed_before_it_acknowledges_loses_nothing() {
    let broker = Broker::start();
    let folder = tempfile::tempdir().unwrap();
    let url = format!("mqtt://127.0.0.1:{}", broker.port);
    let start = || Program::start_with(folder.path(), &["--mqtt", &url]);
    let connected = |program: &Program| program.get("/readyz")["feeds"][0]["is_connected"] == true;
    let program = start();
    program.make(&plain_asset("pump"));
    let began = Instant::now();
    while !connected(&program) {
        assert!(began.elapsed() < LONGEST);
        std::thread::sleep(Duration::from_millis(20));
    }
    program.kill();
    let mut sender = Sender::connect(broker.port);
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let (mut sent, mut between) = (0, 0);
    let rounds = rounds();
    for _ in 0..rounds {
        // The messages wait in the session: the service is killed while it processes them.
        for _ in 0..40 {
            send(&mut sender, sent);
            sent += 1;
        }
        let program = start();
        std::thread::sleep(Duration::from_millis(random.random_range(10..250)));
        between += usize::from(!program.segments("pump").is_empty());
        program.kill();
    }
    let program = start();
    let began = Instant::now();
    let stored: BTreeMap<String, u32> = loop {
        let stored = program.segments("pump");
        if stored.len() >= sent as usize {
            break stored;
        }
        assert!(began.elapsed() < LONGEST, "{} of {sent}", stored.len());
        std::thread::sleep(Duration::from_millis(50));
    };
    assert_eq!(stored.len(), sent as usize);
    assert!(stored.values().all(|count| *count == 1));
    eprintln!(
        "{rounds} rounds: {sent} messages, all records; {between} rounds ended with some of them stored"
    );
    program.kill();
}
