//! Two API nodes and two workers give the same bits as one machine, in whatever order and however often
//! records are sent.

use std::collections::BTreeSet;
use std::time::Duration;

use flankwatch::signal::Record;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use super::nodes::{OneMachine, TestCluster, asset};
use crate::event_stream::EventStream;
use crate::running::{minute, record, samples};

/// Returns one record per minute, some of them loud enough for an alarm.
fn records(channel: &str, count: u32) -> Vec<Record> {
    let one = |n: u32| {
        if n % 7 != 3 {
            return record(channel, n);
        }
        let loud = samples(n).iter().map(|sample| 3.0 * sample).collect();
        Record::new(channel, minute(n.into()), 4000.0, "m/s2", loud).unwrap()
    };
    (0..count).map(one).collect()
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn two_nodes_and_two_workers_give_the_bits_of_one_machine() {
    let cluster = TestCluster::start(2, 2);
    let nodes = [cluster.client(0), cluster.client(1)];
    let alone = OneMachine::start();
    let alone = alone.client();
    for client in [&nodes[0], &alone] {
        client.send_json("POST", "/v1/assets", &asset("pump"), 201);
        client.wait_for("/v1/assets/pump", |asset| asset["summary"]["library_state"] == "ready");
    }
    cluster.wait_for_libraries("pump");
    let mut all: Vec<Record> = ["1", "2"].into_iter().flat_map(|channel| records(channel, 40)).collect();
    for record in &all {
        alone.upload("pump", record);
    }
    all.shuffle(&mut ChaCha8Rng::seed_from_u64(7));
    let redelivered = cluster.redeliver(|| {
        for (n, record) in all.iter().enumerate() {
            let answer = nodes[n % 2].upload("pump", record);
            assert!(answer["state"] == "queued" || answer["wear"].is_object(), "{answer}");
            if n % 3 == 0 {
                let again = nodes[(n + 1) % 2].upload("pump", record);
                assert_eq!(again["id"], answer["id"]);
            }
        }
    });
    assert!(redelivered >= all.len(), "{redelivered} messages");
    for node in &nodes {
        node.wait_for_segments("pump", all.len());
    }
    let began = std::time::Instant::now();
    while cluster.waiting() > 0 {
        assert!(began.elapsed() < Duration::from_secs(60), "{} records still wait", cluster.waiting());
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(cluster.stored_by(0) + cluster.stored_by(1), all.len() as u64);
    let (expected, alarms) = (alone.history("pump"), alone.alarms());
    assert!(!alarms.is_empty());
    for node in &nodes {
        // Late records cause recomputations in the background.
        node.wait_for("/v1/assets/pump/wear/history?channel=1&max_points=100000", |rows| {
            rows["items"] == expected[0]
        });
        assert_eq!(node.history("pump"), expected);
        assert_eq!(node.alarms(), alarms);
    }
    let again = nodes[1].upload("pump", &all[0]);
    assert!(again["wear"].is_object(), "a repeat is answered with what is stored: {again}");
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn every_node_shows_the_events_of_all_nodes_with_the_same_ids() {
    let mut cluster = TestCluster::start(2, 1);
    let nodes = [cluster.client(0), cluster.client(1)];
    let mut streams: Vec<EventStream> =
        nodes.iter().map(|node| EventStream::open_at(&node.url, "", None)).collect();
    nodes[0].send_json("POST", "/v1/assets", &asset("pump"), 201);
    nodes[1].wait_for("/v1/assets/pump", |asset| asset["summary"]["library_state"] == "ready");
    cluster.wait_for_libraries("pump");
    let all = records("1", 11);
    for (n, record) in all.iter().enumerate() {
        nodes[n % 2].upload("pump", record);
    }
    // The last event clears an alarm.
    let mut received: Vec<Vec<(String, String, Value)>> = vec![Vec::new(), Vec::new()];
    for (stream, received) in streams.iter_mut().zip(&mut received) {
        while received.iter().filter(|(kind, ..)| kind == "wear").count() < all.len() {
            let event = stream.next();
            received.push((event.kind, event.id, event.data));
        }
    }
    assert_eq!(received[0], received[1]);
    let alarms: Vec<String> =
        received[0].iter().filter(|(kind, ..)| kind == "alarm").map(|(.., data)| data.to_string()).collect();
    assert!(!alarms.is_empty());
    assert_eq!(alarms.iter().collect::<BTreeSet<_>>().len(), alarms.len(), "an alarm was told of twice");
    // Another node, and a newly started one, continue after the last event.
    let (_, id, _) = &received[0][2];
    cluster.start_node();
    for node in [&nodes[1], &cluster.client(2)] {
        let mut again = EventStream::open_at(&node.url, "", Some(id));
        let event = again.next();
        assert_eq!((event.kind, event.id, event.data), received[0][3].clone());
    }
    let acknowledged = nodes[1].alarms()[0]["id"].as_str().unwrap().to_owned();
    nodes[1].send_json(
        "POST",
        &format!("/v1/alarms/{acknowledged}/acknowledge"),
        &json!({ "by": "anna" }),
        200,
    );
    for stream in &mut streams {
        while stream.next().data["change"]["by"] != "anna" {}
    }
    nodes[0].wait_for(&format!("/v1/alarms/{acknowledged}"), |alarm| alarm["state"] != "unacknowledged");
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn a_changed_description_is_applied_by_a_worker() {
    let mut cluster = TestCluster::start(1, 1);
    let (node, alone) = (cluster.client(0), OneMachine::start());
    let alone = alone.client();
    let mut anew = asset("pump");
    anew["bands"] = json!([{ "name": "mesh", "band_hz": [200, 400] }]);
    alone.send_json("POST", "/v1/assets", &anew, 201);
    node.send_json("POST", "/v1/assets", &asset("pump"), 201);
    for client in [&node, &alone] {
        client.wait_for("/v1/assets/pump", |asset| asset["summary"]["library_state"] == "ready");
        cluster.wait_for_libraries("pump");
        for record in records("1", 20) {
            client.upload("pump", &record);
        }
        client.wait_for_segments("pump", 20);
    }
    // No worker is running; a later one applies the change.
    cluster.stop_worker();
    node.send_json("PUT", "/v1/assets/pump", &anew, 200);
    cluster.start_worker();
    let expected = alone.history("pump");
    let path = "/v1/assets/pump/indicators?max_points=200000&channel=1";
    node.wait_for(path, |rows| rows["items"] == expected[1]);
    assert_eq!(node.history("pump"), expected);
    node.wait_for("/v1/recomputations", |list| list["items"][0]["state"] == "finished");
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS at FLANKWATCH_TEST_NATS"]
fn running_nodes_follow_a_stream_of_events_that_was_created_anew() {
    let mut cluster = TestCluster::start(2, 0);
    let nodes = [cluster.client(0), cluster.client(1)];
    let mut streams: Vec<EventStream> =
        nodes.iter().map(|node| EventStream::open_at(&node.url, "", None)).collect();
    let create = |name: &str| nodes[0].send_json("POST", "/v1/assets", &asset(name), 201);
    let wait_for = |stream: &mut EventStream, name: &str| {
        while stream.next().data["asset_id"] != name {}
    };
    for name in ["a", "b", "c"] {
        create(name);
        streams.iter_mut().for_each(|stream| wait_for(stream, name));
    }
    cluster.delete_events();
    cluster.start_node();
    create("d");
    for stream in &mut streams {
        while stream.next().kind != "lost" {}
    }
    create("e");
    streams.iter_mut().for_each(|stream| wait_for(stream, "e"));
}
