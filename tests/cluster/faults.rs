//! Faults in a cluster: killed processes, restarted servers and cut connections lose nothing acknowledged,
//! count nothing twice and need no operator.
//!
//! `FLANKWATCH_FAULT_ROUNDS` sets how often each fault is repeated.

use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::postgres::Stop;
use super::processes::S3Server;
use super::site::{Site, Uploads, rounds};
use crate::proxy::{Proxy, Wire};
use crate::running::{plain_asset, record};

fn random() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(20_260_101)
}

fn a_moment(random: &mut ChaCha8Rng) {
    std::thread::sleep(Duration::from_millis(random.random_range(100..600)));
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
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let (api, worker) = (site.api(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for _ in 0..rounds() {
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            site.nats.kill();
            for program in [&api, &worker] {
                let health = program.wait_for_readiness(503);
                assert!(health["parts"]["queue_server"] != "ok", "{health}");
                assert_eq!(health["database"], "ok");
            }
            site.nats.start_again();
            for program in [&api, &worker] {
                program.wait_for_readiness(200);
            }
            a_moment(&mut random);
        });
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_database_outage_loses_nothing() {
    let mut site = Site::start();
    let proxy = Proxy::to(site.database_server());
    let (direct, cut) = (site.config(None), site.config(Some(&proxy)));
    let (uploads, mut random) = (Uploads::default(), random());
    let (api, worker) = (site.api(&direct), site.worker(&cut));
    // The API node loses the database as well.
    let beside = site.api(&cut);
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for round in 0..rounds() {
        // Alternately a server that is down and a pulled cable.
        let wire = if round % 2 == 0 { Wire::Closed } else { Wire::Silent };
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            proxy.set(wire);
            for program in [&worker, &beside] {
                let health = program.wait_for_readiness(503);
                assert!(health["database"] != "ok", "{health}");
                assert_eq!(health["parts"]["queue_server"], "ok", "{health}");
            }
            let (status, problem) = beside.client.try_upload("pump", &record("1", 0)).unwrap();
            assert_eq!(status, 503, "{problem}");
            proxy.set(Wire::Closed);
            proxy.set(Wire::Whole);
            for program in [&worker, &beside] {
                program.wait_for_readiness(200);
            }
            a_moment(&mut random);
        });
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
#[ignore = "needs PostgreSQL's programs and nats-server"]
fn a_database_server_restart_loses_nothing() {
    let mut site = Site::with_own_postgres();
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let (api, worker) = (site.api(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for round in 0..rounds() {
        // Alternately a fast shutdown and a crash, after which the server recovers.
        let stop = if round % 2 == 0 { Stop::Immediate } else { Stop::Fast };
        let server = site.postgres.as_mut().unwrap();
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            server.stop(stop);
            for program in [&api, &worker] {
                let health = program.wait_for_readiness(503);
                assert!(health["database"] != "ok", "{health}");
                assert_eq!(health["parts"]["queue_server"], "ok", "{health}");
            }
            server.start_again();
            for program in [&api, &worker] {
                program.wait_for_readiness(200);
            }
            a_moment(&mut random);
        });
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn a_broken_connection_between_worker_and_database_loses_nothing() {
    let mut site = Site::start();
    let proxy = Proxy::to(site.database_server());
    let (direct, cut) = (site.config(None), site.config(Some(&proxy)));
    let (uploads, mut random) = (Uploads::default(), random());
    let (api, worker) = (site.api(&direct), site.worker(&cut));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for _ in 0..rounds() {
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            // Nothing is forwarded and no connection closes: data arrives after the repair, in the middle of
            // transactions.
            proxy.set(Wire::Silent);
            let health = worker.wait_for_readiness(503);
            assert!(health["database"] != "ok", "{health}");
            proxy.set(Wire::Whole);
            worker.wait_for_readiness(200);
            a_moment(&mut random);
        });
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE, nats-server and moto_server"]
fn an_object_store_outage_loses_nothing() {
    let server = S3Server::start();
    let mut site = Site::start();
    let proxy = Proxy::to(server.address());
    site.objects = format!("bucket = \"records\"\nendpoint = \"http://{}\"", proxy.address());
    let (config, uploads, mut random) = (site.config(None), Uploads::default(), random());
    let (api, worker) = (site.api(&config), site.worker(&config));
    api.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);
    for _ in 0..rounds() {
        uploads.during(&[&api.client], || {
            a_moment(&mut random);
            proxy.set(Wire::Closed);
            for program in [&api, &worker] {
                let health = program.wait_for_readiness(503);
                assert!(health["parts"]["object_store"] != "ok", "{health}");
                assert_eq!(health["database"], "ok");
            }
            proxy.set(Wire::Whole);
            for program in [&api, &worker] {
                program.wait_for_readiness(200);
            }
            a_moment(&mut random);
        });
        uploads.wait_until_stored(&api.client);
    }
    uploads.compare(&api.client);
}
