//! The service: the parts that work on records, and [`Service`], which connects them.
//!
//! | part | purpose |
//! | --- | --- |
//! | [`Pipeline`] | processes records: decode, identify, store raw, analyse, fold, commit, publish |
//! | [`History`] | folds records, late ones too, into their channel's history, and recomputes histories |
//! | [`Simulations`] | simulates the libraries, and provides the estimator of each asset |
//! | [`Replays`] | sends recordings from a folder through the pipeline |
//! | [`Streams`] | stores live streams in journals and cuts records out of them |
//! | [`StoredRecords`] | reads stored records and computes their spectra |
//! | [`Assets`], [`Alarms`], [`Maintenance`], [`Removals`], [`Exclusions`] | apply changes made by users |
//! | `Retention`, `Backfill`, `Upkeep` | run in the background |
//!
//! The time comes from the [`Clock`] with which the service is started.
//!
//! # Lock order
//!
//! The holder of one of these locks acquires only locks further down:
//!
//! 1. `Assets::describing`, `Backfill::running`, `Retention::enforcing`: one change of descriptions, one
//!    backfill, one application of the quotas at a time
//! 2. `RawObjects`: shared while raw bytes have no rows yet, exclusive while objects are removed
//! 3. `CommitQueue::committing`: one transaction of segments, operator action or maintenance event at a time
//! 4. a channel's cache; several in the order of asset and channel
//! 5. the transaction: rows of assets by name, then of channels by asset and name, then dependent rows
//! 6. `RawObjects::writing_metadata`: the metadata of one asset at a time
//!
//! Locks of the standard library are held for a few statements and never across an `await`.

mod alarms;
mod assets;
mod backfill;
mod background;
mod client_limiter;
mod clock;
mod conflicts;
mod error;
mod events;
mod exclusion;
mod failure_cause;
mod feeds;
mod history;
mod joint_alarms;
mod joint_wear;
mod keys;
mod limits;
mod maintenance;
mod parts;
mod pipeline;
mod precondition;
mod raw;
mod rebuild;
mod recomputation;
mod record;
mod record_counts;
mod removal;
mod replay;
mod replays;
mod sensor_group;
mod silence;
mod simulations;
mod streams;
mod thinner;
mod upkeep;
mod work_queue;
mod workers;

pub use alarms::{Alarms, OperatorAction};
pub use assets::Assets;
pub(crate) use background::while_leased;
pub(crate) use client_limiter::{Client, ClientLimiter, ClientPermit};
pub use clock::{Clock, SystemClock};
pub use error::ServiceError;
pub use events::{EventSender, LiveEvent, NumberedEvent, SegmentRef, SharedEvents};
pub use exclusion::Exclusions;
pub use failure_cause::FailureCause;
pub use feeds::{Feed, FeedCount, Feeds, HeldMessage};
pub use history::History;
pub use joint_wear::JointWear;
pub use limits::{OldResults, RawQuotas, ServiceFolders, WorkLimits};
pub use maintenance::Maintenance;
pub use parts::Service;
pub use pipeline::{Accepted, BatchSummary, Pipeline, Refused};
pub use precondition::{Precondition, description_tag};
pub use raw::UploadPieces;
pub use rebuild::Rebuilt;
pub use recomputation::{Recomputation, RecomputationState};
pub(crate) use record::ChannelUnits;
pub use record::{
    BandChoice, ChannelNames, LoadedRecord, RecordFormat, SampleFile, SampleFileKind, SegmentEnvelope,
    StoredRecords, UploadMetadata,
};
pub use record_counts::{RecordCounts, RecordOutcome};
pub use removal::Removals;
pub use replay::{Pace, Replay, ReplayRequest, ReplayState};
pub use replays::{ReplayFile, Replays};
pub use simulations::{Readiness, Simulation, SimulationProgress, SimulationStage, Simulations};
pub(crate) use streams::Pulses;
pub use streams::{
    CampaignStatus, LiveChannel, LiveFrame, LiveSpeedSource, LiveUpdate, StreamGap, StreamProgress,
    StreamSender, StreamStatus, StreamViewer, Streams,
};
pub use work_queue::{PartHealth, QueueOverview, QueuedRecord, Role, WorkQueue, WorkerOverview};
pub(crate) use workers::blocking;
pub use workers::{Ticket, Workers};
