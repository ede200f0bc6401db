//! Commands that administer a store, or the queue of a cluster.

pub(super) mod backup;
pub(super) mod cluster;
pub(super) mod dead_letters;
pub(super) mod quarantine;
pub(super) mod rebuild;
mod store_options;
pub(super) mod token;
pub(super) mod verify;
