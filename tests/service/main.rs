//! The whole program: the service over HTTP, started on a free port with a folder and a clock of its own, and the commands.
#![cfg(test)]

mod access;
mod alarms;
mod architecture;
mod assets;
#[cfg(feature = "cluster")]
mod broker;
mod browser;
#[cfg(feature = "cluster")]
mod cluster;
mod command_line;
mod dashboard;
mod deploy;
mod deploy_tools;
mod durability;
mod dynamics;
mod envelopes;
mod evaluation;
mod events;
mod figures;
mod full_disk;
mod gear_indicators;
mod integrations;
mod killed;
mod libraries;
#[cfg(feature = "cluster")]
mod many_workers;
#[cfg(feature = "cluster")]
mod mqtt;
#[cfg(feature = "cluster")]
mod mqtt_faults;
mod openapi;
mod problems;
mod real_bearing;
mod real_gearbox;
mod real_novelty;
mod recomputing;
mod recordings;
mod resumable_uploads;
mod running;
mod segments;
#[cfg(feature = "cluster")]
mod shared_store;
mod trends;
mod two_stages;
mod uploads;
mod views;

use flankwatch_test_support as left_out;
