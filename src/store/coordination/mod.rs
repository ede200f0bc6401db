//! What processes that share a store agree on: who owns a part of the queue, builds a library, or takes
//! over the work of a process that died.

pub(super) mod dead_letters;
pub(super) mod library_builds;
pub(super) mod queue_partitions;
pub(super) mod upkeep;
