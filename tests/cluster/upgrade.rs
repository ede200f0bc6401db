//! All processes of a cluster are replaced under load, in the order that docs/cluster.md gives for an
//! upgrade.
//!
//! `FLANKWATCH_EARLIER_PROGRAM` is the program of an earlier version. Without it, the processes are replaced
//! by those of the same version.

use std::path::PathBuf;

use super::processes::{Process, Program};
use super::site::{Site, Uploads, rounds, this_program};
use crate::running::plain_asset;

/// Stops a process as an operator does, and starts another one in its place.
fn replace(stopped: &mut Process, start: impl FnOnce() -> Program) -> Program {
    stopped.signal("TERM");
    let program = start();
    program.wait_for_readiness(200);
    program
}

#[test]
#[ignore = "needs PostgreSQL at FLANKWATCH_TEST_DATABASE and nats-server"]
fn an_upgrade_under_load_loses_nothing() {
    let earlier = std::env::var_os("FLANKWATCH_EARLIER_PROGRAM").map_or_else(this_program, PathBuf::from);
    for _ in 0..rounds() {
        let (mut site, uploads) = (Site::start(), Uploads::default());
        let config = site.config(None);
        site.program.clone_from(&earlier);
        let (mut one, mut two) = (site.api(&config), site.api(&config));
        let mut workers = vec![site.worker(&config), site.worker(&config)];
        one.client.send_json("POST", "/v1/assets", &plain_asset("pump"), 201);

        site.program = this_program();
        uploads.during(&[&one.client, &two.client], || {
            for worker in &mut workers {
                *worker = replace(&mut worker.process, || site.worker(&config));
            }
        });
        let mut new_one = None;
        uploads.during(&[&one.client, &two.client], || {
            new_one = Some(replace(&mut one.process, || site.api(&config)));
        });
        let new_one = new_one.unwrap();
        let mut new_two = None;
        uploads.during(&[&new_one.client, &two.client], || {
            new_two = Some(replace(&mut two.process, || site.api(&config)));
        });
        uploads.wait_until_stored(&new_two.unwrap().client);
        uploads.compare(&new_one.client);
    }
}
