//! The service over HTTP, on a free port with its own folder and clock, and the programs that work with it.
#![cfg(test)]

mod access;
mod alarms;
mod assets;
mod backups;
mod bearings;
mod channel_units;
mod client_commands;
mod clients;
mod corrections;
mod damaged_store;
mod dashboard;
mod deploy;
mod deploy_tools;
mod documented_commands;
mod durability;
mod envelopes;
mod events;
mod gear_indicators;
mod integrations;
mod live_view;
mod lost_database;
mod machine_metrics;
mod mail;
mod maintenance;
mod notifications;
mod openapi;
mod packages;
mod preview;
mod problems;
mod recomputing;
mod record_table;
mod recordings;
mod resumable_uploads;
mod schemathesis;
mod segments;
mod silence;
mod simulations;
mod sound_cards;
mod stream_beginnings;
mod stream_cuts;
mod stream_refusals;
mod stream_tachometers;
mod streams;
mod tables;
mod thinning;
mod token_pages;
mod trends;
mod two_stages;
mod uploads;
mod views;

#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/certificate.rs"]
mod certificate;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/command.rs"]
mod command;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/event_stream.rs"]
mod event_stream;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/program.rs"]
mod program;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/resumable_client.rs"]
mod resumable_client;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/running.rs"]
mod running;
#[cfg(feature = "cluster")]
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/shared_store.rs"]
mod shared_store;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/stream_socket.rs"]
mod stream_socket;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/tokens.rs"]
mod tokens;
