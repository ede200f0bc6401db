//! The work queue between processes on one store: API nodes accept and enqueue records, workers analyse, fold
//! and commit them.

use std::collections::HashSet;
use std::sync::Arc;

use futures_util::future::BoxFuture;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::error::ServiceError;
use crate::asset::AssetId;
use crate::store::RecordMetadata;

/// A record that is identified and whose raw bytes are stored: everything besides these bytes that its
/// analysis needs.
#[derive(Debug, Clone, PartialEq)]
pub struct QueuedRecord {
    /// What is stored beside its raw bytes.
    pub metadata: RecordMetadata,
    /// When its asset was created, which distinguishes it from a later asset of the same name.
    pub asset_created_at: Timestamp,
    /// How often it recently became a dead letter; the queue treats it as a new record each time it is sent
    /// again.
    pub dead_letters: u32,
}

/// The health of a dependency of the service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartHealth {
    /// The name of the dependency.
    pub part: &'static str,
    /// Why it cannot be used; `None` if it can.
    pub fault: Option<String>,
}

/// The state of the work queue and its workers.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct QueueOverview {
    /// Records that wait or are in progress.
    pub records: u64,
    /// Of these, those that a worker has received and not acknowledged.
    pub in_progress: u64,
    /// When the oldest of the records was enqueued.
    pub oldest_at: Option<Timestamp>,
    /// Acknowledged messages that the server still keeps.
    pub leftovers: u64,
    /// Records that could not be stored and became dead letters.
    pub dead_letters: u64,
    /// Partitions of the queue that none of the workers owns.
    pub partitions_unowned: u64,
    /// The workers that respond.
    pub workers: Vec<WorkerOverview>,
}

/// The status of a worker, as it reports it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkerOverview {
    /// Its unique name: the name of the machine and a random number.
    pub name: String,
    /// The version of the program.
    pub version: String,
    /// Records in progress.
    pub in_progress: u64,
    /// Maximum number of records in progress.
    pub at_once: u64,
    /// Records stored since its start.
    pub stored: u64,
    /// The partitions of the queue that it owns.
    #[serde(default)]
    pub partitions: Vec<u16>,
    /// Number of states of channels that it has read from the store since its start.
    #[serde(default)]
    pub states_read: u64,
}

/// The queue between API nodes and workers, which also notifies workers of changed assets.
pub trait WorkQueue: Send + Sync + 'static {
    /// Enqueues records; they are durable once this returns without an error.
    ///
    /// # Errors
    /// [`ServiceError::Busy`] if the queue cannot accept them now.
    fn enqueue<'a>(&'a self, records: &'a [QueuedRecord]) -> BoxFuture<'a, Result<(), ServiceError>>;

    /// The names of the raw objects of all records in the queue and among the dead letters.
    fn objects_waiting(&self) -> BoxFuture<'_, Result<HashSet<String>, ServiceError>>;

    /// Notifies the workers that an asset's description or its events changed. A worker that misses the
    /// notice detects the change later.
    fn notify_changed(&self, asset: &AssetId);

    /// The state of the queue and its workers. Waits a moment for the workers to respond.
    fn overview(&self) -> BoxFuture<'_, Result<QueueOverview, ServiceError>>;

    /// Checks the queue by writing to its server.
    fn health(&self) -> BoxFuture<'_, Vec<PartHealth>>;
}

/// The role of a process in the processing of records.
#[derive(Clone, Default)]
pub enum Role {
    /// Runs all steps, alone on its store.
    #[default]
    Standalone,
    /// Accepts and enqueues records.
    ApiNode(Arc<dyn WorkQueue>),
    /// Analyses, folds and commits queued records, and recomputes histories.
    Worker(Arc<dyn WorkQueue>),
}

impl Role {
    /// The queue between this process and others; `None` for a standalone process.
    pub fn queue(&self) -> Option<&Arc<dyn WorkQueue>> {
        match self {
            Self::Standalone => None,
            Self::ApiNode(queue) | Self::Worker(queue) => Some(queue),
        }
    }

    /// Whether this process only accepts and enqueues records.
    pub fn is_api_node(&self) -> bool {
        matches!(self, Self::ApiNode(_))
    }
}
