//! All faults of a cluster at the same time: nothing acknowledged is lost, nothing is stored twice, and only
//! what is wrong with a message makes a dead letter.
//!
//! `FLANKWATCH_FAULT_ROUNDS` sets how often they are repeated.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flankwatch::recording::{BlockEncoding, encode_block};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;

use super::broker::{Broker, LONGEST, Listener, Sender, unique};
use super::postgres::Stop;
use super::processes::S3Server;
use super::queue::dead_letters;
use super::site::{Site, Uploads, rounds};
use super::small_disk::SmallDisk;
use crate::proxy::{Proxy, Wire};
use crate::running::{plain_asset, record};

/// Messages sent over MQTT in each round.
const MESSAGES: u32 = 10;

/// Records in a full queue: while a part is away it gets full.
const MAX_RECORDS: u32 = 30;

/// Size of the queue's disk, which is full until the queue's server starts again: NATS stops storing once a
/// write has failed.
const QUEUE_DISK_MB: u32 = 64;

/// The servers and connections that are away for a while.
#[derive(Debug, Clone, Copy)]
enum Part {
    Database,
    /// Only for one of the workers, and without a closed connection.
    DatabaseWire,
    Queue,
    Bucket,
    Broker,
}

/// The servers of a site that can be taken away.
struct Parts {
    site: Site,
    database_wire: Proxy,
    bucket_wire: Proxy,
    broker: Broker,
    queue_disk: SmallDisk,
}

impl Parts {
    fn take_away(&mut self, part: Part, round: u32) {
        match part {
            // Alternately a crash and a fast shutdown.
            Part::Database => {
                let how = if round.is_multiple_of(2) { Stop::Immediate } else { Stop::Fast };
                self.site.postgres.as_mut().unwrap().stop(how);
            }
            Part::DatabaseWire => self.database_wire.set(Wire::Silent),
            Part::Queue => self.site.nats.kill(),
            Part::Bucket => self.bucket_wire.set(Wire::Closed),
            Part::Broker => self.broker.end("-TERM"),
        }
    }

    fn bring_back(&mut self, part: Part) {
        match part {
            Part::Database => self.site.postgres.as_mut().unwrap().start_again(),
            Part::DatabaseWire => {
                self.database_wire.set(Wire::Closed);
                self.database_wire.set(Wire::Whole);
            }
            Part::Queue => {
                self.queue_disk.free();
                self.site.nats.start_again();
            }
            Part::Bucket => self.bucket_wire.set(Wire::Whole),
            Part::Broker => self.broker.launch(),
        }
    }
}

/// Puts a message into the queue that is no record, once there is room.
fn enqueue_poison(site: &Site) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let jetstream = async_nats::jetstream::new(async_nats::connect(site.nats.url()).await.unwrap());
        while jetstream.publish("faults.work", "no record".into()).await.unwrap().await.is_err() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
}

/// Settings with a small queue.
fn settings(site: &Site, database: Option<&Proxy>) -> PathBuf {
    let path = site.config(database);
    let text = std::fs::read_to_string(&path).unwrap();
    let limited = text.replace("ack_wait_s = 2", &format!("ack_wait_s = 2\nmax_records = {MAX_RECORDS}"));
    std::fs::write(&path, limited).unwrap();
    path
}

/// Settings of a node that also takes records over MQTT.
fn with_mqtt(config: &Path, broker: &Broker) -> PathBuf {
    let path = config.with_file_name("mqtt.toml");
    let text = format!(
        "[mqtt]\nurl = \"mqtt://127.0.0.1:{}\"\nclient_id = {:?}\nsession_expiry_s = 600\n{}",
        broker.port,
        unique("node"),
        std::fs::read_to_string(config).unwrap()
    );
    std::fs::write(&path, text).unwrap();
    path
}

fn a_moment(random: &mut ChaCha8Rng) {
    std::thread::sleep(Duration::from_millis(random.random_range(50..400)));
}

#[test]
#[ignore = "needs PostgreSQL's programs, nats-server, moto_server, mosquitto, faketime and the right to mount"]
fn all_faults_at_once_lose_nothing() {
    let bucket = S3Server::start();
    let queue_disk = SmallDisk::mount(QUEUE_DISK_MB);
    let mut site = Site::with_queue_on(&queue_disk);
    let database_wire = Proxy::to(site.database_server());
    let bucket_wire = Proxy::to(bucket.address());
    site.objects = format!("bucket = \"records\"\nendpoint = \"http://{}\"", bucket_wire.address());
    let (config, cut) = (settings(&site, None), settings(&site, Some(&database_wire)));
    let broker = Broker::start();
    let over_mqtt = with_mqtt(&config, &broker);
    let steady = site.api(&config);
    for (id, of) in [("pump", None), ("fan", None), ("pinion", Some("fan"))] {
        let mut asset = plain_asset(id);
        if let Some(of) = of {
            asset["sensor"]["of"] = json!(of);
        }
        steady.client.send_json("POST", "/v1/assets", &asset, 201);
    }
    let mut sender = Sender::connect(broker.port);
    let mut node = site.api(&over_mqtt);
    let mut workers = vec![site.worker(&config), site.worker(&cut)];
    let mut parts = Parts { site, database_wire, bucket_wire, broker, queue_disk };
    let (uploads, mut random) = (Uploads::default(), ChaCha8Rng::seed_from_u64(20_261_126));
    let block = |n: u32| encode_block(&record("1", n), BlockEncoding::Protobuf);
    for round in 0..rounds() {
        uploads.during(&[&steady.client], || {
            // Until these connections break.
            parts.database_wire.set(Wire::Slow);
            parts.bucket_wire.set(Wire::Slow);
            for n in round * MESSAGES..(round + 1) * MESSAGES {
                sender.send("flankwatch/fan/1/waveform", &block(n));
            }
            // A message for an asset that shares the sensor of another one is refused with the reason.
            let rejected = Listener::connect(parts.broker.port, "flankwatch/pinion/+/rejected");
            sender.send("flankwatch/pinion/1/waveform", &block(round));
            assert_eq!(rejected.wait_for(1)[0].1["status"], 409);
            enqueue_poison(&parts.site);
            parts.site.database.set_full(true);
            parts.queue_disk.fill();
            let days = if round.is_multiple_of(2) { 8 } else { -8 };
            let replaced = parts.site.worker_at(&config, days);
            workers.insert(1, replaced);
            a_moment(&mut random);
            // One of the workers, in turn, and the node that receives over MQTT.
            workers.remove(0).process.kill();
            node.process.kill();
            let mut away = [Part::Database, Part::DatabaseWire, Part::Queue, Part::Bucket, Part::Broker];
            away.shuffle(&mut random);
            for part in away {
                parts.take_away(part, round);
                a_moment(&mut random);
            }
            away.shuffle(&mut random);
            for part in away {
                parts.bring_back(part);
                a_moment(&mut random);
            }
            parts.site.database.set_full(false);
            node = parts.site.api(&over_mqtt);
        });
        workers.push(parts.site.worker(if round.is_multiple_of(2) { &cut } else { &config }));
        workers.truncate(3);
        for program in workers.iter().chain([&steady, &node]) {
            program.wait_for_readiness(200);
        }
        uploads.wait_until_stored(&steady.client);
    }
    let messages = rounds() * MESSAGES;
    for asset in ["fan", "pinion"] {
        steady.client.wait_for_segments(asset, messages);
    }
    let began = Instant::now();
    while dead_letters(&parts.site) < u64::from(rounds()) {
        assert!(began.elapsed() < LONGEST, "{} dead letters", dead_letters(&parts.site));
        std::thread::sleep(Duration::from_millis(100));
    }
    uploads.compare(&steady.client);
    assert_eq!(dead_letters(&parts.site), u64::from(rounds()));
}
