//! The dashboard in a browser.
#![cfg(test)]

mod browser;
mod javascript;

#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/running.rs"]
mod running;
#[cfg(feature = "cluster")]
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/shared_store.rs"]
mod shared_store;
#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/tokens.rs"]
mod tokens;
