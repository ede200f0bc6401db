//! Commands that run the service or a part of it.

pub(super) mod demo;
mod mqtt;
#[cfg(feature = "nats")]
mod node;
pub(super) mod serve;
pub(super) mod serve_error;
#[cfg(feature = "postgres")]
mod shared_store;
pub(super) mod work;
