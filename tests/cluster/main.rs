//! Several processes as one service: API nodes and workers with NATS JetStream and PostgreSQL; records over
//! MQTT.
#![cfg(test)]

mod all_faults;
mod broker;
mod client;
mod concurrent_changes;
mod documented_start;
mod faults;
mod many_workers;
mod mqtt;
mod mqtt_faults;
mod mqtt_streams;
mod nodes;
mod partitions;
mod postgres;
mod processes;
mod queue;
mod resumable;
mod same_bits;
mod site;
mod small_disk;
mod stream_faults;
mod streams;
mod tokens;
mod upgrade;
mod upkeep;
mod workers;

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
#[path = "../support/proxy.rs"]
mod proxy;
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
