//! A resumable upload continues on any node.

use std::time::{Duration, Instant};

use flankwatch::signal::Record;
use serde_json::Value;

use super::client::Client;
use super::nodes::OneMachine;
use super::site::Site;
use crate::running::{mcap, plain_asset, record};

const TUS: (&str, &str) = ("tus-resumable", "1.0.0");

/// Starts an upload for the asset `pump` and returns its path.
fn begin(client: &Client, length: usize) -> String {
    let length = length.to_string();
    // "pump" in base64
    let headers = [TUS, ("upload-length", length.as_str()), ("upload-metadata", "asset cHVtcA==")];
    let (status, headers, answer) = client.try_send_with("POST", "/v1/uploads", &headers, b"").unwrap();
    assert_eq!(status, 201, "{answer}");
    headers["location"].to_str().unwrap().to_owned()
}

fn patch(client: &Client, path: &str, at: usize, bytes: &[u8]) -> u16 {
    let at = at.to_string();
    let headers = [TUS, ("upload-offset", at.as_str()), ("content-type", "application/offset+octet-stream")];
    client.try_send_with("PATCH", path, &headers, bytes).unwrap().0
}

fn offset(client: &Client, path: &str) -> usize {
    let (status, headers, _) = client.try_send_with("HEAD", path, &[TUS], b"").unwrap();
    assert_eq!(status, 200);
    headers["upload-offset"].to_str().unwrap().parse().unwrap()
}

fn records(count: u32) -> Vec<Record> {
    (0..count).map(|n| record("1", n)).collect()
}

/// Returns the results of one machine for the same recording, uploaded in one request.
fn plain_upload(recording: &[u8]) -> Vec<Value> {
    let machine = OneMachine::start();
    let alone = machine.client();
    alone.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let sent = alone.try_send("POST", "/v1/assets/pump/segments", "application/mcap", recording);
    assert_eq!(sent.unwrap().0, 201);
    alone.history("pump")
}

/// Waits until all records are stored, and compares them with those of a plain upload.
#[track_caller]
fn compare(client: &Client, recording: &[u8], count: usize) {
    client.wait_for_segments("pump", count);
    let expected = plain_upload(recording);
    client.wait_for("/v1/assets/pump/indicators?max_points=200000&channel=1", |rows| {
        rows["items"] == expected[1]
    });
    assert_eq!(client.history("pump"), expected);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn an_upload_resumes_on_another_node_after_its_own_was_killed() {
    let mut site = Site::start();
    let config = site.config(None);
    let (mut first, second) = (site.api(&config), site.api(&config));
    let _worker = site.worker(&config);
    first.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let recording = mcap(&records(40));
    let (a, b) = (recording.len() / 3, 2 * recording.len() / 3);
    let path = begin(&first.client, recording.len());
    assert_eq!(patch(&first.client, &path, 0, &recording[..a]), 204);
    first.process.kill();
    assert_eq!(offset(&second.client, &path), a);
    assert_eq!(patch(&second.client, &path, 0, &recording[..a]), 409);
    assert_eq!(patch(&second.client, &path, a, &recording[a..b]), 204);
    let third = site.api(&config);
    assert_eq!(offset(&third.client, &path), b);
    assert_eq!(patch(&third.client, &path, b, &recording[b..]), 204);
    let done = second.client.wait_for(&path, |upload| upload["state"] == "finished");
    assert_eq!((&done["result"]["queued"], &done["error"]), (&40.into(), &Value::Null), "{done}");
    compare(&second.client, &recording, 40);
    let kept = std::fs::read_dir(site.objects_folder().join("uploads")).unwrap().count();
    assert_eq!(kept, 0, "pieces of a finished upload");
    // Deleted on one node, the upload is gone on the other.
    let path = begin(&second.client, 10);
    assert_eq!(patch(&third.client, &path, 0, b"12345"), 204);
    assert_eq!(third.client.try_send_with("DELETE", &path, &[TUS], b"").unwrap().0, 204);
    assert_eq!(patch(&second.client, &path, 5, b"12345"), 404);
    let kept = std::fs::read_dir(site.objects_folder().join("uploads")).unwrap().count();
    assert_eq!(kept, 0, "pieces of an upload that was given up");
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn an_upload_whose_reader_was_killed_is_read_by_another_node() {
    let mut site = Site::start();
    let config = site.config(None);
    let (mut first, second) = (site.api(&config), site.api(&config));
    let _worker = site.worker(&config);
    first.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    // More than one part.
    let recording = mcap(&records(600));
    assert!(recording.len() > 4 << 20);
    let path = begin(&first.client, recording.len());
    assert_eq!(patch(&first.client, &path, 0, &recording), 204);
    first.process.kill();
    let began = Instant::now();
    let done = second.client.wait_for(&path, |upload| upload["state"] == "finished");
    assert!(began.elapsed() < Duration::from_secs(90), "{done}");
    assert_eq!(done["error"], Value::Null, "{done}");
    compare(&second.client, &recording, 600);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn two_nodes_that_receive_the_same_bytes_concurrently_store_them_once() {
    let mut site = Site::start();
    let config = site.config(None);
    let nodes = [site.api(&config), site.api(&config)];
    let _worker = site.worker(&config);
    nodes[0].client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let recording = mcap(&records(30));
    let path = begin(&nodes[0].client, recording.len());
    let step = recording.len() / 8;
    let mut at = 0;
    while at < recording.len() {
        let end = (at + step).min(recording.len());
        let (path, bytes) = (path.as_str(), &recording[at..end]);
        let statuses = std::thread::scope(|scope| {
            let both = nodes.each_ref().map(|node| scope.spawn(move || patch(&node.client, path, at, bytes)));
            both.map(|one| one.join().unwrap())
        });
        assert!(statuses.contains(&204), "{statuses:?}");
        assert!(statuses.iter().all(|status| [204, 409].contains(status)), "{statuses:?}");
        assert_eq!(offset(&nodes[1].client, path), end);
        at = end;
    }
    let done = nodes[0].client.wait_for(&path, |upload| upload["state"] == "finished");
    assert_eq!(done["error"], Value::Null, "{done}");
    compare(&nodes[1].client, &recording, 30);
}
