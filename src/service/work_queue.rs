//! Several processes on one store: API nodes take records and put them into a queue, workers analyse, fold
//! and commit them.

use std::collections::HashSet;
use std::sync::Arc;

use futures_util::future::BoxFuture;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::error::ServiceError;
use crate::asset::{AssetId, RawReference, SegmentId};
use crate::signal::OperatingPoint;
use crate::store::RecordNote;

/// A record that is decoded and identified, whose raw bytes are stored, and that is still to be analysed: all
/// that it takes besides its raw bytes.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct QueuedRecord {
    /// Identifier of the segment that it becomes.
    pub id: SegmentId,
    /// The asset it belongs to.
    pub asset_id: AssetId,
    /// When that asset was made: one of the same name that is made later is another.
    #[serde(skip)]
    pub asset_created_at: Timestamp,
    /// The measuring channel.
    pub channel: String,
    /// The time of the first sample.
    pub start_time: Timestamp,
    /// When the service took it.
    pub received_at: Timestamp,
    /// Unit of the samples.
    pub unit: String,
    /// Operating point as given with the record.
    pub operating_point: OperatingPoint,
    /// Wear depth in µm known from elsewhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_wear_um: Option<f64>,
    /// Where the raw bytes are.
    pub raw: RawReference,
    /// How often it was given up lately as one that cannot be stored: sent again it is another one to the
    /// queue.
    #[serde(skip)]
    pub given_up: u32,
}

impl From<&QueuedRecord> for RecordNote {
    fn from(record: &QueuedRecord) -> Self {
        Self {
            id: record.id.clone(),
            asset_id: record.asset_id.clone(),
            channel: record.channel.clone(),
            start_time: record.start_time,
            received_at: record.received_at,
            unit: record.unit.clone(),
            operating_point: record.operating_point,
            reference_wear_um: record.reference_wear_um,
            raw: record.raw.clone(),
        }
    }
}

impl QueuedRecord {
    /// A record as it is noted beside its raw bytes, for an asset that was made at a time.
    pub(crate) fn noted(note: RecordNote, asset_created_at: Timestamp) -> Self {
        Self {
            id: note.id,
            asset_id: note.asset_id,
            asset_created_at,
            channel: note.channel,
            start_time: note.start_time,
            received_at: note.received_at,
            unit: note.unit,
            operating_point: note.operating_point,
            reference_wear_um: note.reference_wear_um,
            raw: note.raw,
            given_up: 0,
        }
    }
}

/// How a part that the service needs is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartHealth {
    /// Which part.
    pub part: &'static str,
    /// Why it cannot be used; none where it can.
    pub fault: Option<String>,
}

/// What waits between API nodes and workers, and who works on it.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct QueueOverview {
    /// Records that wait or are worked on.
    pub records: u64,
    /// Of these, those that a worker has and has not acknowledged.
    pub in_work: u64,
    /// When the oldest of these came into the queue.
    pub oldest_at: Option<Timestamp>,
    /// Messages that are acknowledged and that the server still keeps: they are no work.
    pub leftovers: u64,
    /// Records that could not be stored.
    pub dead_letters: u64,
    /// The workers that answer.
    pub workers: Vec<WorkerOverview>,
}

/// A worker as it tells of itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkerOverview {
    /// Its name, which tells it from others: the machine's and a number by chance.
    pub name: String,
    /// The running version.
    pub version: String,
    /// Records that it works on.
    pub in_work: u64,
    /// Records that it works on at most.
    pub at_once: u64,
    /// Records that it stored since its start.
    pub stored: u64,
}

/// The queue between API nodes and workers, and the notice of changed assets.
pub trait WorkQueue: Send + Sync + 'static {
    /// Puts records into the queue; they are safe once this returns without an error.
    ///
    /// Error: [`ServiceError::Busy`] where they cannot be taken now.
    fn enqueue<'a>(&'a self, records: &'a [QueuedRecord]) -> BoxFuture<'a, Result<(), ServiceError>>;

    /// The names of the raw objects of all records that wait: in the queue, and among those that could not be
    /// stored.
    fn objects_waiting(&self) -> BoxFuture<'_, Result<HashSet<String>, ServiceError>>;

    /// Notifies the workers that an asset's description or what happened to it changed. A worker that misses
    /// the notice finds out by itself later.
    fn notify_changed(&self, asset: &AssetId);

    /// What waits and who works on it. Takes a moment, in which workers answer.
    fn overview(&self) -> BoxFuture<'_, Result<QueueOverview, ServiceError>>;

    /// Whether the queue works, found out by writing to its server.
    fn health(&self) -> BoxFuture<'_, Vec<PartHealth>>;
}

/// What a process does of a record's way.
#[derive(Clone, Default)]
pub enum Role {
    /// All of it, alone on its store.
    #[default]
    Standalone,
    /// Takes records and puts them into the queue.
    ApiNode(Arc<dyn WorkQueue>),
    /// Analyses, folds and commits records of the queue, and computes histories again.
    Worker(Arc<dyn WorkQueue>),
}

impl Role {
    /// The queue between this process and others; none where it is alone.
    pub fn queue(&self) -> Option<&Arc<dyn WorkQueue>> {
        match self {
            Self::Standalone => None,
            Self::ApiNode(queue) | Self::Worker(queue) => Some(queue),
        }
    }

    /// Whether records go into the queue here.
    pub fn is_api_node(&self) -> bool {
        matches!(self, Self::ApiNode(_))
    }
}
