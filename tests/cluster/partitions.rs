//! Partitions of the queue: one worker takes the records of a channel, and another one takes over.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use async_nats::jetstream::consumer::{PullConsumer, pull};
use async_nats::jetstream::stream::{Config, RetentionPolicy};
use futures_util::StreamExt;

use super::client::Client;
use super::nodes::{OneMachine, TestCluster};
use super::site::Site;
use crate::running::{plain_asset, record};

const CHANNELS: u32 = 12;

/// Sends one record of each channel.
fn send_all(client: &Client, n: u32) {
    for channel in 1..=CHANNELS {
        client.upload("pump", &record(&channel.to_string(), n));
    }
}

/// Sends one record of each channel for each `n`, each after the previous one of its channel is stored.
fn send_in_turn(client: &Client, rounds: std::ops::Range<u32>) {
    for n in rounds {
        send_all(client, n);
        client.wait_for_segments("pump", (n + 1) * CHANNELS);
    }
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS 2.11 at FLANKWATCH_TEST_NATS"]
fn a_channel_is_stored_by_one_worker_which_reads_its_state_once() {
    let mut cluster = TestCluster::start(1, 2);
    let client = cluster.client(0);
    client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    cluster.wait_for_partitions(&[32, 32]);
    send_in_turn(&client, 0..10);
    let stored = [cluster.stored_by(0), cluster.stored_by(1)];
    assert_eq!(stored[0] + stored[1], u64::from(10 * CHANNELS));
    // Both have channels, and all records of each.
    assert!(stored.iter().all(|stored| *stored > 0 && stored % 10 == 0), "{stored:?}");
    // A state is read only for records that another worker has stored.
    assert_eq!(cluster.states_read_by(0) + cluster.states_read_by(1), 0);

    // The worker that stops is replaced at once, before its lease would expire.
    let stopped = Instant::now();
    cluster.stop_worker();
    cluster.wait_for_partitions(&[64]);
    assert!(stopped.elapsed() < Duration::from_secs(8), "after {:?}", stopped.elapsed());
    send_in_turn(&client, 10..20);
    assert_eq!(cluster.states_read_by(0), stored[1] / 10, "once for each channel taken over");

    cluster.start_worker();
    cluster.wait_for_partitions(&[32, 32]);
    cluster.start_worker();
    cluster.wait_for_partitions(&[21, 21, 22]);
    send_in_turn(&client, 20..22);
    let machine = OneMachine::start();
    machine.client().send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    (0..22).for_each(|n| send_all(&machine.client(), n));
    assert_eq!(client.history("pump"), machine.client().history("pump"));
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server 2.11"]
fn the_partitions_of_a_killed_worker_are_taken_over() {
    let mut site = Site::start();
    let config = site.config(None);
    let api = site.api(&config);
    let (survivor, mut killed) = (site.worker(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let owned = |workers: usize| {
        let status = super::queue::json_of(&config, &["cluster", "status"]);
        let owned =
            status["workers"].as_array().unwrap().iter().map(|one| one["partitions"].as_array().unwrap());
        let distinct: BTreeSet<u64> = owned.flatten().map(|number| number.as_u64().unwrap()).collect();
        assert_eq!(status["partitions_unowned"], 64 - distinct.len());
        (status["workers"].as_array().unwrap().len() == workers).then_some(distinct.len())
    };
    let wait_for_all = |workers| {
        let began = Instant::now();
        while owned(workers) != Some(64) {
            assert!(began.elapsed() < Duration::from_secs(40), "partitions without an owner");
            std::thread::sleep(Duration::from_millis(200));
        }
    };
    wait_for_all(2);
    (0..5).for_each(|n| send_all(&api.client, n));
    killed.process.kill();
    (5..10).for_each(|n| send_all(&api.client, n));
    assert_ne!(owned(1), Some(64), "its lease has not expired");
    wait_for_all(1);
    api.client.wait_for_segments("pump", 10 * CHANNELS);
    let machine = OneMachine::start();
    machine.client().send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    (0..10).for_each(|n| send_all(&machine.client(), n));
    // Late records cause recomputations in the background.
    let expected = machine.client().history("pump");
    let began = Instant::now();
    while api.client.history("pump") != expected {
        assert!(began.elapsed() < Duration::from_secs(60), "other results: {}", survivor.process.log());
        std::thread::sleep(Duration::from_millis(100));
    }
    assert_eq!(super::queue::json_of(&config, &["cluster", "status"])["dead_letters"], 0);
}

/// Gets the consumer of a version without partitions, as its workers create it: of all records.
async fn earlier_consumer(jetstream: &async_nats::jetstream::Context, name: &str) -> PullConsumer {
    let config = pull::Config {
        durable_name: Some("workers".to_owned()),
        ack_wait: Duration::from_secs(2),
        max_deliver: -1,
        max_ack_pending: -1,
        ..pull::Config::default()
    };
    jetstream.create_consumer_on_stream(config, format!("{name}_work")).await.unwrap()
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and NATS 2.11 at FLANKWATCH_TEST_NATS"]
fn records_of_a_version_without_partitions_are_stored() {
    let mut cluster = TestCluster::start(0, 0);
    cluster.on_server(async |jetstream, name| {
        let config = Config {
            name: format!("{name}_work"),
            subjects: vec![format!("{name}.work")],
            retention: RetentionPolicy::WorkQueue,
            ..Config::default()
        };
        jetstream.create_stream(config).await.unwrap();
        earlier_consumer(&jetstream, name).await;
    });
    cluster.start_node();
    let client = cluster.client(0);
    client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    (0..3).for_each(|n| send_all(&client, n));
    // An earlier worker was killed with some of the records, and an earlier node has sent some.
    cluster.on_server(async |jetstream, name| {
        let consumer = earlier_consumer(&jetstream, name).await;
        let mut messages = consumer.fetch().max_messages(10).messages().await.unwrap();
        let mut count = 0;
        while let Some(message) = messages.next().await {
            let payload = message.unwrap().payload.clone();
            jetstream.publish(format!("{name}.work"), payload).await.unwrap().await.unwrap();
            count += 1;
        }
        assert_eq!(count, 10);
    });
    cluster.start_worker();
    client.wait_for_segments("pump", 3 * CHANNELS);
    // An earlier worker that connects again makes the consumer one of all records.
    cluster.on_server(async |jetstream, name| {
        earlier_consumer(&jetstream, name).await;
    });
    (3..6).for_each(|n| send_all(&client, n));
    client.wait_for_segments("pump", 6 * CHANNELS);
    cluster.start_worker();
    cluster.wait_for_partitions(&[32, 32]);
    let filter = cluster.on_server(async |jetstream, name| {
        let stream = jetstream.get_stream(format!("{name}_work")).await.unwrap();
        stream.consumer_info("workers").await.unwrap().config.filter_subject
    });
    assert!(filter.ends_with(".work"), "{filter}");
    let began = Instant::now();
    while cluster.waiting() > 0 {
        assert!(began.elapsed() < Duration::from_secs(60), "{} records still wait", cluster.waiting());
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(cluster.stored_by(0) + cluster.stored_by(1), u64::from(6 * CHANNELS));
    let overview = cluster.overview();
    assert_eq!((overview.records, overview.in_progress, overview.leftovers), (0, 0, 0), "{overview:?}");
}
