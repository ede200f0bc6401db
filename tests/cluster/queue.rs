//! The queue: when it is full, and what becomes of records that cannot be stored.

use std::path::Path;
use std::time::Duration;

use serde_json::json;

use super::processes::Program;
use super::site::Site;
use crate::running::{plain_asset, record};

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_full_queue_refuses_until_there_is_room() {
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
    assert_eq!(
        (status, problem["detail"].as_str().unwrap().contains("full")),
        (503, true),
        "{problem}"
    );
    let health = api.wait_for_readiness(503);
    assert!(health["parts"]["queue_server"].as_str().unwrap().contains("5 of 5"), "{health}");
    let _worker = site.worker(&config);
    api.client.upload("pump", &record("1", 5));
    api.client.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] == 6);
    api.wait_for_readiness(200);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_record_that_cannot_be_stored_goes_to_the_dead_letters_with_its_reason() {
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
    // What comes after it is not held up.
    let answer = api.client.upload("pump", &record("1", 1));
    assert_eq!(answer["state"], json!("queued"));
    api.client.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] == 1);
}

/// Waits for a dead letter that is about a segment.
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

/// Changes the bytes of everything that is kept.
fn damage(objects: &Path) -> usize {
    let mut damaged = 0;
    for folder in std::fs::read_dir(objects).unwrap().flatten() {
        if folder.file_name().len() != 2 {
            continue;
        }
        let objects = std::fs::read_dir(folder.path()).unwrap().flatten().map(|object| object.path());
        // Not the notes beside them.
        for object in objects.filter(|path| path.extension().is_none()) {
            std::fs::write(object, b"damaged").unwrap();
            damaged += 1;
        }
    }
    damaged
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_dead_letters_record_that_is_sent_again_is_stored() {
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
    // On a busy machine the first attempt may have been taken back.
    assert!(reason.contains(" times"), "{reason}");
    // The object is brought again with the record.
    for _ in 0..2 {
        assert_eq!(api.client.upload("pump", &record("1", 1))["id"], answer["id"]);
    }
    api.client.wait_for("/v1/assets/pump", |asset| asset["summary"]["segments"] == 1);
}
