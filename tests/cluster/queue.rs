//! The queue: when it is full, and dead letters.

use std::path::Path;
use std::time::Duration;

use flankwatch::signal::Record;
use serde_json::json;

use super::processes::Program;
use super::site::Site;
use crate::running::{minute, plain_asset, record};

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_full_queue_rejects_records_until_it_has_room() {
    let mut site = Site::start();
    let config = site.config(None);
    let text = std::fs::read_to_string(&config).unwrap();
    std::fs::write(&config, text.replace("ack_wait_s = 2", "ack_wait_s = 2\nmax_records = 5")).unwrap();
    let api = site.api(&config);
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for n in 0..5 {
        assert_eq!(api.client.try_upload("pump", &record("1", n)).unwrap().0, 201);
    }
    let (status, problem) = api.client.try_upload("pump", &record("1", 5)).unwrap();
    assert_eq!((status, problem["detail"].as_str().unwrap().contains("full")), (503, true), "{problem}");
    let health = api.wait_for_readiness(503);
    assert!(health["parts"]["queue_server"].as_str().unwrap().contains("5 of 5"), "{health}");
    let _worker = site.worker(&config);
    api.client.upload("pump", &record("1", 5));
    api.client.wait_for_segments("pump", 6);
    api.wait_for_readiness(200);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_record_that_cannot_be_stored_becomes_a_dead_letter_with_its_reason() {
    let mut site = Site::start();
    let config = site.config(None);
    let (api, worker) = (site.api(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let (reason, payload) = runtime.block_on(async {
        let client = async_nats::connect(site.nats.url()).await.unwrap();
        let jetstream = async_nats::jetstream::new(client);
        let sent = jetstream.publish("faults.work", "no record".into()).await.unwrap();
        sent.await.unwrap();
        let stream = jetstream.get_stream("faults_dead").await.unwrap();
        for _ in 0..200 {
            if let Ok(letter) = stream.get_last_raw_message_by_subject("faults.dead").await {
                let reason = letter.headers.get("Flankwatch-Reason").unwrap().to_string();
                return (reason, letter.payload);
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("no dead letter: {}", worker.process.log());
    });
    assert!(reason.contains("cannot be read"), "{reason}");
    assert_eq!(&payload[..], b"no record");
    // Later records are not blocked.
    let answer = api.client.upload("pump", &record("1", 1));
    assert_eq!(answer["state"], json!("queued"));
    api.client.wait_for_segments("pump", 1);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn queued_records_get_the_unit_of_their_channel() {
    let mut site = Site::start();
    let config = site.config(None);
    let api = site.api(&config);
    let mut spec = plain_asset("pump");
    spec["sensor"] = json!({});
    api.client.send_json("POST", "/v1/assets", &spec, 201);
    for (n, unit, scale) in [(0, "m/s2", 1.0), (1, "g", 1.0 / 9.806_65), (2, "mm/s2", 1000.0)] {
        let samples = record("1", n).samples().iter().map(|sample| sample * scale).collect();
        let in_unit = Record::new("1", minute(n.into()), 4000.0, unit, samples).unwrap();
        assert_eq!(api.client.try_upload("pump", &in_unit).unwrap().0, 201);
    }
    let _worker = site.worker(&config);
    api.client.wait_for_segments("pump", 3);
    // Whichever is stored first determines the unit.
    let segments = api.client.get("/v1/assets/pump/segments");
    let items = segments["items"].as_array().unwrap();
    assert!(items.iter().all(|item| item["unit"] == items[0]["unit"]), "{segments}");
}

/// Waits for a dead letter of a segment and returns its reason.
fn wait_for_dead_letter(site: &Site, worker: &Program, segment: &str) -> String {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let client = async_nats::connect(site.nats.url()).await.unwrap();
        let jetstream = async_nats::jetstream::new(client);
        for _ in 0..1200 {
            if let Ok(stream) = jetstream.get_stream("faults_dead").await
                && let Ok(letter) = stream.get_last_raw_message_by_subject("faults.dead").await
            {
                let reason = letter.headers.get("Flankwatch-Reason").unwrap().to_string();
                let payload = String::from_utf8_lossy(&letter.payload);
                if payload.contains(segment) {
                    return reason;
                }
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("no dead letter: {}", worker.process.log());
    })
}

/// Damages every raw object; returns their number.
fn damage(objects: &Path) -> usize {
    let mut damaged = 0;
    for folder in std::fs::read_dir(objects).unwrap().flatten() {
        if folder.file_name().len() != 2 {
            continue;
        }
        let objects = std::fs::read_dir(folder.path()).unwrap().flatten().map(|object| object.path());
        // Skips the metadata files beside the objects.
        for object in objects.filter(|path| path.extension().is_none()) {
            std::fs::write(object, b"damaged").unwrap();
            damaged += 1;
        }
    }
    damaged
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_dead_record_that_is_sent_again_is_stored() {
    let mut site = Site::start();
    let config = site.config(None);
    let text = std::fs::read_to_string(&config).unwrap();
    std::fs::write(&config, format!("{text}[cluster.worker]\nmax_deliveries = 1\n")).unwrap();
    let api = site.api(&config);
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let answer = api.client.upload("pump", &record("1", 1));
    assert_eq!(damage(&site.objects_folder()), 1);
    let worker = site.worker(&config);
    let segment = answer["id"].as_str().unwrap();
    let reason = wait_for_dead_letter(&site, &worker, segment);
    // On a busy machine the first delivery may have expired.
    assert!(reason.contains(" times"), "{reason}");
    // The repeated upload stores the object again.
    for _ in 0..2 {
        assert_eq!(api.client.upload("pump", &record("1", 1))["id"], answer["id"]);
    }
    api.client.wait_for_segments("pump", 1);
}

/// Waits until a worker has logged that it retries `count` records.
#[track_caller]
fn wait_until_held(worker: &Program, count: usize) {
    let began = std::time::Instant::now();
    while worker.process.log().matches("failed to store a record; retrying").count() < count {
        assert!(began.elapsed() < Duration::from_secs(60), "the worker does not retry {count} records");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Returns the number of dead letters.
pub(super) fn dead_letters(site: &Site) -> u64 {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let jetstream = async_nats::jetstream::new(async_nats::connect(site.nats.url()).await.unwrap());
        let stream = jetstream.get_stream("faults_dead").await.unwrap();
        stream.cached_info().state.messages
    })
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn records_wait_while_the_databases_disk_is_full_even_if_workers_die() {
    let mut site = Site::start();
    let config = site.config(None);
    let text = std::fs::read_to_string(&config).unwrap();
    let limits = "[cluster.worker]\nmax_deliveries = 2\nat_once = 2\n";
    std::fs::write(&config, format!("{text}{limits}")).unwrap();
    let (api, mut worker) = (site.api(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    site.database.set_full(true);
    for n in 0..4 {
        api.client.upload("pump", &record(&n.to_string(), n));
    }
    // The worker holds two records, and the others wait for their turn.
    wait_until_held(&worker, 2);
    // A stopped worker returns its records and a killed one leaves them; each time the disk is the cause.
    for kill in [false, true, true, true] {
        if kill {
            worker.process.kill();
        } else {
            worker.process.signal("TERM");
        }
        worker = site.worker(&config);
        wait_until_held(&worker, 2);
    }
    assert_eq!(api.client.get("/v1/assets/pump")["summary"]["segments"], 0);
    site.database.set_full(false);
    api.client.wait_for_segments("pump", 4);
    assert_eq!(dead_letters(&site), 0);
}

/// Runs a command on the cluster and returns its output.
#[track_caller]
fn command(config: &Path, arguments: &[&str]) -> String {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_flankwatch"))
        .args(arguments)
        .arg("--config")
        .arg(config)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {text}");
    String::from_utf8(output.stdout).unwrap()
}

pub(super) fn json_of(config: &Path, arguments: &[&str]) -> serde_json::Value {
    serde_json::from_str(&command(config, &[arguments, &["--format", "json"]].concat())).unwrap()
}

/// Returns the value of a worker's metric.
fn metric(worker: &Program, name: &str) -> f64 {
    let (status, page) = worker.client.try_send("GET", "/metrics", "text/plain", b"").unwrap();
    assert_eq!(status, 200, "{page}");
    let page = page.as_str().unwrap().to_owned();
    let line = page.lines().find(|line| line.starts_with(&format!("{name} ")));
    let line = line.unwrap_or_else(|| panic!("no {name} in {page}"));
    line.rsplit(' ').next().unwrap().parse().unwrap()
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn operators_inspect_the_queue_and_retry_or_drop_dead_letters() {
    let mut site = Site::start();
    let config = site.config(None);
    let api = site.api(&config);
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for n in 0..3 {
        api.client.upload("pump", &record("1", n));
    }
    let status = json_of(&config, &["cluster", "status"]);
    assert_eq!((&status["records"], &status["workers"]), (&json!(3), &json!([])), "{status}");
    assert!(status["oldest_at"].is_string(), "{status}");
    assert_eq!(damage(&site.objects_folder()), 3);
    let worker = site.worker(&config);
    let began = std::time::Instant::now();
    while json_of(&config, &["cluster", "status"])["dead_letters"] != 3 {
        assert!(
            began.elapsed() < Duration::from_secs(60),
            "not among the dead letters: {}",
            worker.process.log()
        );
        std::thread::sleep(Duration::from_millis(200));
    }
    let letters = json_of(&config, &["dead-letters", "list"])["items"].as_array().unwrap().clone();
    assert_eq!(letters.len(), 3);
    for letter in &letters {
        assert_eq!(letter["record"]["asset_id"], "pump");
        // The last error, and how often it was tried.
        let reason = letter["reason"].as_str().unwrap();
        assert!(reason.contains("damaged") && reason.contains("tried 5 times"), "{reason}");
    }
    let number = letters[0]["number"].to_string();
    assert!(command(&config, &["dead-letters", "show", &number]).contains("asset       pump"));
    assert!(command(&config, &["dead-letters", "list"]).contains("tried 5 times"), "whole where it is piped");
    // One object is repaired, so that its record is stored after a retry.
    let mended = letters[0]["record"]["start_time"].as_str().unwrap();
    let n = (0..3).find(|n| record("1", *n).start_time().to_string() == mended).unwrap();
    api.client.upload("pump", &record("1", n));
    api.client.wait_for_segments("pump", 1);
    assert_eq!(
        json_of(&config, &["dead-letters", "retry", &number])["retried"],
        json!([letters[0]["number"]])
    );
    assert!(command(&config, &["dead-letters", "drop", "--all"]).starts_with("2 dead letters"));
    assert_eq!(json_of(&config, &["dead-letters", "list"])["items"], json!([]));
    let began = std::time::Instant::now();
    while metric(&worker, "flankwatch_dead_letters") > 0.0
        || metric(&worker, "flankwatch_queue_records") > 0.0
    {
        assert!(began.elapsed() < Duration::from_secs(30), "still there");
        std::thread::sleep(Duration::from_millis(200));
    }
    assert_eq!(metric(&worker, "flankwatch_workers_alive"), 1.0);
    assert_eq!(metric(&worker, "flankwatch_queue_leftover_messages"), 0.0);
    let status = command(&config, &["cluster", "status"]);
    assert!(status.contains("workers               1"), "{status}");
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn an_unreachable_queue_leaves_reads_ready() {
    let mut site = Site::start();
    let config = site.config(None);
    let api = site.api(&config);
    api.wait_for_readiness(200);
    site.nats.kill();
    let health = api.wait_for_readiness(503);
    assert_ne!(health["parts"]["queue_server"], "ok", "{health}");
    let health = api.client.get("/readyz?for=reading");
    assert_eq!((&health["status"], &health["for"]), (&json!("ok"), &json!("reading")));
    site.nats.start_again();
    api.wait_for_readiness(200);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_read_only_database_is_not_ready_for_records() {
    let mut site = Site::start();
    let config = site.config(None);
    let api = site.api(&config);
    api.wait_for_readiness(200);
    site.database.set_read_only(true);
    let health = api.wait_for_readiness(503);
    assert!(health["database"].as_str().unwrap().contains("read"), "{health}");
    assert_eq!(api.client.get("/readyz?for=reading")["status"], "ok");
    site.database.set_read_only(false);
    api.wait_for_readiness(200);
}
