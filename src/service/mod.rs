//! The service: its parts, each with what it depends on, and how they are put together.
//!
//! | part | does |
//! | --- | --- |
//! | [`Pipeline`] | takes records: decode, identify, store raw, analyse, fold, commit, announce |
//! | [`History`] | folds records into their channel's history, late ones too, and computes histories again |
//! | [`Simulations`] | has the libraries simulated, and gives each asset its estimator |
//! | [`Replays`] | takes recordings from a folder through the pipeline |
//! | [`Streams`] | keeps live streams in journals and cuts records out of them |
//! | [`StoredRecords`] | reads stored records again, with their spectra |
//! | [`Assets`], [`Alarms`], [`Maintenance`], [`Removals`], [`Exclusions`] | change what people describe and do |
//! | `Retention`, `CatchUp`, `Upkeep` | work in the background |
//!
//! Time comes from the [`Clock`] that the service is started with.
//!
//! # Lock order
//!
//! Whoever holds one of these locks takes only those further down:
//!
//! 1. `Assets::describing`, `CatchUp::turn`, `Retention::turn`: one change of descriptions, one catching up,
//!    one application of the quotas at a time
//! 2. `RawObjects`: shared while raw bytes have no rows yet, exclusive while objects are removed
//! 3. the committer's turn: one transaction of segments, an operator's action or a maintenance event at a
//!    time
//! 4. a channel's slot; several in the order of asset and channel
//! 5. the transaction: rows of assets by name, then of channels by asset and name, then what hangs on them
//!
//! Locks of the standard library are held for some statements and never across an `await`.

mod alarms;
mod assets;
mod catch_up;
mod clock;
mod error;
mod events;
mod exclusion;
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
mod removal;
mod replay;
mod replays;
mod sensor_group;
mod silence;
mod simulations;
mod streams;
mod tally;
mod upkeep;
mod work_queue;
mod workers;

pub use alarms::{Alarms, OperatorAction};
pub use assets::Assets;
pub use clock::{Clock, SystemClock};
pub use error::ServiceError;
pub use events::{Announcer, LiveEvent, NumberedEvent, SegmentPlace};
pub use exclusion::Exclusions;
pub use feeds::{Feed, FeedCount, Feeds, Holding};
pub use history::History;
pub use joint_wear::JointWear;
pub use limits::{RawQuotas, ServiceFolders, WorkLimits};
pub use maintenance::Maintenance;
pub use parts::Service;
pub use pipeline::{Accepted, BatchSummary, Pipeline, Refused};
pub use precondition::{Precondition, description_tag};
pub use raw::UploadPieces;
pub use rebuild::Rebuilt;
pub use recomputation::{Recomputation, RecomputationState};
pub use record::{BandChoice, RecordFormat, SegmentEnvelope, StoredRecords, UploadMetadata};
pub use removal::Removals;
pub use replay::{Pace, Replay, ReplayRequest, ReplayState};
pub use replays::{ReplayFile, Replays};
pub use simulations::{Readiness, Simulation, SimulationProgress, SimulationStage, Simulations};
pub(crate) use streams::Pulses;
pub use streams::{
    CampaignStatus, LiveChannel, LiveFrame, LiveSpeedSource, LiveUpdate, StreamGap, StreamProgress,
    StreamSender, StreamStatus, StreamViewer, Streams,
};
pub use tally::Tally;
pub use work_queue::{PartHealth, QueueOverview, QueuedRecord, Role, WorkQueue, WorkerOverview};
pub use workers::{Ticket, Workers};
pub(crate) use workers::{blocking, detached};
