//! Why a record was not taken.

use std::path::PathBuf;

use thiserror::Error;

use crate::asset::{AssetId, SegmentId};
use crate::estimate::AlarmError;
use crate::recording::RecordingError;
use crate::store::StoreError;

/// Why the service did not do what it was asked.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// Too much work at once; the same request can succeed later.
    #[error("{what}: try again in {retry_after_s} s")]
    Busy {
        /// What there is too much of.
        what: &'static str,
        /// When to try again, in seconds.
        retry_after_s: u32,
    },
    /// The bytes are not a record.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// A field has a value that cannot be used.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Which field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: &'static str,
    },
    /// The asset's description changed again and again while a record was analysed.
    #[error("the description of asset {0} changed while the record was analysed: try again")]
    DescriptionChanged(AssetId),
    /// An asset is not as a change of it is conditional on.
    #[error("asset {0} was changed meanwhile: its description is not the one that the request is for")]
    Precondition(AssetId),
    /// Records of an asset come with those of another one.
    #[error("asset {asset} shares the sensor of {of}: send its records there")]
    SensorOfOther {
        /// The asset.
        asset: AssetId,
        /// The one that its records come for.
        of: AssetId,
    },
    /// Other assets share the sensor of this one.
    #[error(
        "the sensor of asset {asset} is shared by {others}: delete those first, or have them share another"
    )]
    SensorShared {
        /// The asset.
        asset: AssetId,
        /// Those that share it.
        others: String,
    },
    /// The raw bytes of a record were given up for others.
    #[error(
        "the raw recording of segment {0} is not kept any more: it was the oldest when the quota was reached; its results are"
    )]
    RawGivenUp(SegmentId),
    /// A record of the queue is not what its raw bytes say.
    #[error("the raw bytes are segment {found}, expected {expected}, which was queued")]
    QueuedOtherwise {
        /// What the bytes say.
        found: SegmentId,
        /// What was queued.
        expected: SegmentId,
    },
    /// The store refused or failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A recording in the replay folder cannot be had.
    #[error("recording {file:?} {reason}")]
    ReplayFile {
        /// The name as given.
        file: String,
        /// Why not.
        reason: &'static str,
    },
    /// The operating system refused a file operation.
    #[error("cannot {action} {path}: {source}", path = path.display())]
    File {
        /// What was tried.
        action: &'static str,
        /// On which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// There is no such live stream.
    #[error("asset {asset} has no stream {name:?}")]
    StreamUnknown {
        /// The asset.
        asset: AssetId,
        /// The name that was asked for.
        name: String,
    },
    /// A live stream is of another format.
    #[error(
        "the stream {name:?} of asset {asset} has another sample, sample_rate_hz, channels, scale, unit or channel_names: send \
         the same, or under another name"
    )]
    StreamFormat {
        /// The asset.
        asset: AssetId,
        /// The stream.
        name: String,
    },
    /// Another connection sends a live stream now.
    #[error("another connection sends this stream, or it was removed")]
    StreamTaken,
    /// Live streams are kept in the folder of one process.
    #[error("live streams are not taken in a cluster: send them to a service with a data folder of its own")]
    StreamsShared,
    /// There is no such replay.
    #[error("there is no replay {0:?}")]
    ReplayUnknown(String),
    /// There is no such alarm.
    #[error("there is no alarm {0:?}")]
    AlarmUnknown(String),
    /// An alarm is in a state in which an action cannot be done.
    #[error(transparent)]
    Alarm(#[from] AlarmError),
    /// There is no such maintenance event.
    #[error("there is no maintenance event {0:?}")]
    MaintenanceUnknown(String),
    /// A worker stopped in the middle of its task: a fault of the program.
    #[error("a worker stopped while it was to {0}")]
    WorkerLost(&'static str),
}

impl ServiceError {
    /// Whether a record's raw bytes are not to be had any more. Its results are; an answer on many records
    /// goes without what needs the bytes.
    pub fn is_without_raw(&self) -> bool {
        matches!(
            self,
            Self::RawGivenUp(_)
                | Self::Store(StoreError::ObjectMissing(_) | StoreError::ObjectDamaged { .. })
        )
    }
}
