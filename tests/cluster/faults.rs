//! Faults in a cluster: killed processes, restarted servers and cut connections lose nothing acknowledged,
//! count nothing twice and need no operator.
//!
//! `FLANKWATCH_FAULT_ROUNDS` sets how often each fault is repeated.

use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::client::Client;
use super::postgres::Stop;
use super::processes::{Program, S3Server};
use super::site::{Site, Uploads, rounds};
use crate::proxy::{Proxy, Wire};
use crate::running::{plain_asset, record};

fn random() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(20_260_101)
}

fn a_moment(random: &mut ChaCha8Rng) {
    std::thread::sleep(Duration::from_millis(random.random_range(100..600)));
}

/// Repeats a fault while a node receives records, and checks that all of them are stored once. The fault is
/// over when `fault` returns.
#[track_caller]
fn loses_nothing(api: &Client, mut fault: impl FnMut(u32)) {
    let (uploads, mut random) = (Uploads::default(), random());
    api.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for round in 0..rounds() {
        uploads.during(&[api], || {
            a_moment(&mut random);
            fault(round);
            a_moment(&mut random);
        });
        uploads.wait_until_stored(api);
    }
    uploads.compare(api);
}

const DATABASE: &str = "/database";
const QUEUE_SERVER: &str = "/parts/queue_server";
const OBJECT_STORE: &str = "/parts/object_store";

/// Waits until each program reports that one part is unavailable, and checks that another one is not.
#[track_caller]
fn wait_for_outage(programs: &[&Program], lost: &str, intact: &str) {
    for program in programs {
        let health = program.wait_for_readiness(503);
        assert!(health.pointer(lost).is_some_and(|state| state != "ok"), "{health}");
        assert!(health.pointer(intact).is_some_and(|state| state == "ok"), "{health}");
    }
}

fn wait_for_recovery(programs: &[&Program]) {
    for program in programs {
        program.wait_for_readiness(200);
    }
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_worker_killed_in_the_middle_loses_nothing() {
    let mut site = Site::start();
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let api = site.api(&config);
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    let mut workers = vec![site.worker(&config), site.worker(&config)];
    for _ in 0..rounds() {
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            workers.remove(0).process.kill();
            a_moment(&mut random);
        });
        workers.push(site.worker(&config));
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn an_api_node_killed_after_its_response_loses_nothing() {
    let mut site = Site::start();
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let steady = site.api(&config);
    steady.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for _ in 0..rounds() {
        let mut killed = site.api(&config);
        // No worker is running: acknowledged records are in the queue only.
        uploads.during(&[&killed.client, &steady.client], || {
            a_moment(&mut random);
            killed.process.kill();
        });
        let _worker = site.worker(&config);
        uploads.wait_until_stored(&steady.client);
    }
    let _worker = site.worker(&config);
    uploads.compare(&steady.client);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_killed_and_restarted_nats_server_loses_nothing() {
    let mut site = Site::start();
    let config = site.config(None);
    let (api, worker) = (site.api(&config), site.worker(&config));
    loses_nothing(&api.client, |_| {
        site.nats.kill();
        wait_for_outage(&[&api, &worker], QUEUE_SERVER, DATABASE);
        site.nats.start_again();
        wait_for_recovery(&[&api, &worker]);
    });
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_database_outage_loses_nothing() {
    let mut site = Site::start();
    let proxy = Proxy::to(site.database_server());
    let (direct, cut) = (site.config(None), site.config(Some(&proxy)));
    let (api, worker) = (site.api(&direct), site.worker(&cut));
    // The API node loses the database as well.
    let beside = site.api(&cut);
    loses_nothing(&api.client, |round| {
        // Alternately a server that is down and a pulled cable.
        proxy.set(if round % 2 == 0 { Wire::Closed } else { Wire::Silent });
        wait_for_outage(&[&worker, &beside], DATABASE, QUEUE_SERVER);
        let (status, problem) = beside.client.try_upload("pump", &record("1", 0)).unwrap();
        assert_eq!(status, 503, "{problem}");
        proxy.set(Wire::Closed);
        proxy.set(Wire::Whole);
        wait_for_recovery(&[&worker, &beside]);
    });
}

#[test]
#[ignore = "needs PostgreSQL's programs and nats-server"]
fn a_database_server_restart_loses_nothing() {
    let mut site = Site::with_own_postgres();
    let config = site.config(None);
    let (api, worker) = (site.api(&config), site.worker(&config));
    let server = site.postgres.as_mut().unwrap();
    loses_nothing(&api.client, |round| {
        // Alternately a fast shutdown and a crash, after which the server recovers.
        server.stop(if round % 2 == 0 { Stop::Immediate } else { Stop::Fast });
        wait_for_outage(&[&api, &worker], DATABASE, QUEUE_SERVER);
        server.start_again();
        wait_for_recovery(&[&api, &worker]);
    });
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_broken_connection_between_worker_and_database_loses_nothing() {
    let mut site = Site::start();
    let proxy = Proxy::to(site.database_server());
    let (direct, cut) = (site.config(None), site.config(Some(&proxy)));
    let (api, worker) = (site.api(&direct), site.worker(&cut));
    loses_nothing(&api.client, |_| {
        // Nothing is forwarded and no connection closes: data arrives after the repair, in the middle of
        // transactions.
        proxy.set(Wire::Silent);
        wait_for_outage(&[&worker], DATABASE, QUEUE_SERVER);
        proxy.set(Wire::Whole);
        wait_for_recovery(&[&worker]);
    });
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE, nats-server and moto_server"]
fn an_object_store_outage_loses_nothing() {
    let server = S3Server::start();
    let mut site = Site::start();
    let proxy = Proxy::to(server.address());
    site.objects = format!("bucket = \"records\"\nendpoint = \"http://{}\"", proxy.address());
    let config = site.config(None);
    let (api, worker) = (site.api(&config), site.worker(&config));
    loses_nothing(&api.client, |_| {
        proxy.set(Wire::Closed);
        wait_for_outage(&[&api, &worker], OBJECT_STORE, DATABASE);
        proxy.set(Wire::Whole);
        wait_for_recovery(&[&api, &worker]);
    });
}
