//! What remains after kills, failing disks and full disks.
#![cfg(test)]

mod failing_calls;
mod failing_database;
mod forgetful_disk;
mod full_disk;
mod killed;
mod seeded;
mod streams;

#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/program.rs"]
mod program;
#[path = "../support/proxy.rs"]
mod proxy;
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
