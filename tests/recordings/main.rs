//! Real recordings of gears and bearings, end to end.
#![cfg(test)]

mod bearing_novelty;
mod broken_tooth;
mod real_bearing;
mod real_gearbox;
mod record_lengths;
mod second_simulator;
mod wear_estimates;

#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/command.rs"]
mod command;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/running.rs"]
mod running;
#[cfg(feature = "cluster")]
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/shared_store.rs"]
mod shared_store;
