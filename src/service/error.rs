//! Errors of the service layer.

use std::borrow::Cow;
use std::path::PathBuf;

use thiserror::Error;

use crate::asset::{AssetId, SegmentId};
use crate::estimate::AlarmError;
use crate::recording::RecordingError;
use crate::store::StoreError;

/// Why the service could not carry out a request.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// A limit on concurrent work is reached; the same request can succeed later.
    #[error("{what}: try again in {retry_after_s} s")]
    Busy {
        /// Which limit is reached.
        what: &'static str,
        /// Seconds after which to try again.
        retry_after_s: u32,
    },
    /// The bytes cannot be decoded as a record.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// A channel has too many records before its last inspection for estimates in hindsight.
    #[error("the channel has more than {0} records before the inspection, the maximum for this computation")]
    TooManyRecords(usize),
    /// A field has an invalid value.
    #[error("{field} is {value}, expected {expected}")]
    Field {
        /// Which field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What was expected.
        expected: Cow<'static, str>,
    },
    /// The same bytes are stored for the same channel and time with another value of a field.
    #[error("{field} is {value}, but the record is stored with {stored}: delete it before you send it again")]
    StoredWith {
        /// Which field.
        field: &'static str,
        /// Its value.
        value: String,
        /// The value in the stored record.
        stored: String,
    },
    /// The asset's description changed repeatedly while a record was analysed.
    #[error("the description of asset {0} changed while the record was analysed: try again")]
    DescriptionChanged(AssetId),
    /// The first record of a channel, in another unit, was stored while this one was analysed.
    #[error(
        "the first record of channel {channel:?} is in {unit}, and was stored at the same time: try again"
    )]
    UnitChosen {
        /// The channel.
        channel: String,
        /// Its unit from then on.
        unit: String,
    },
    /// An asset does not meet the precondition of a request.
    #[error("asset {0} has changed: its description does not match the precondition of the request")]
    Precondition(AssetId),
    /// The asset has no sensor of its own; its records are those of another asset.
    #[error("asset {asset} shares the sensor of {of}: send its records to {of}")]
    SensorOfOther {
        /// The asset.
        asset: AssetId,
        /// The asset that owns the sensor.
        of: AssetId,
    },
    /// Other assets share the sensor of this one.
    #[error(
        "the sensor of asset {asset} is shared by {others}: delete these assets first, or assign them another sensor"
    )]
    SensorShared {
        /// The asset.
        asset: AssetId,
        /// The assets that share its sensor, separated by commas.
        others: String,
    },
    /// The raw bytes of a record were deleted by the retention.
    #[error(
        "the raw recording of segment {0} is no longer available: it was the oldest when the quota was exceeded; its results are kept"
    )]
    RawDeleted(SegmentId),
    /// The raw bytes of a queued record give another segment than the one that was queued.
    #[error("the raw bytes belong to segment {found}, expected the queued segment {expected}")]
    QueuedRecordMismatch {
        /// The segment derived from the raw bytes.
        found: SegmentId,
        /// The segment that was queued.
        expected: SegmentId,
    },
    /// A store operation failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A recording in the replay folder cannot be used.
    #[error("recording {file:?} {reason}")]
    ReplayFile {
        /// The name as given in the request.
        file: String,
        /// Why the recording cannot be used.
        reason: &'static str,
    },
    /// A file operation failed.
    #[error("failed to {action} {path}: {source}", path = path.display())]
    File {
        /// The operation, for example `"create the folder"`.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// There is no such live stream.
    #[error("asset {asset} has no stream {name:?}")]
    StreamUnknown {
        /// The asset.
        asset: AssetId,
        /// The requested name.
        name: String,
    },
    /// A live stream has another format than the one requested.
    #[error(
        "{field} is {value}, expected {expected} as in stream {name:?} of asset {asset}: \
         send the same format, or use another name"
    )]
    StreamFormat {
        /// The asset.
        asset: AssetId,
        /// The stream.
        name: String,
        /// The field of the format that differs.
        field: &'static str,
        /// The requested value.
        value: Box<str>,
        /// The stream's value.
        expected: Box<str>,
    },
    /// A live stream belongs to an earlier asset of the same name, and removals are suspended.
    #[error(
        "stream {name:?} belongs to an earlier asset {asset}, which the database may have lost: \
         run `flankwatch rebuild`, or use another name"
    )]
    StreamHeld {
        /// The asset.
        asset: AssetId,
        /// The stream.
        name: String,
    },
    /// A chunk has stored indices and a later time: the sender's count has restarted.
    #[error("first_index is {first}, expected {expected}")]
    StreamRestarted {
        /// The index of its first sample.
        first: u64,
        /// What was expected.
        expected: String,
    },
    /// Another connection has taken over a live stream.
    #[error("another connection now sends this stream, or the stream was removed")]
    StreamTaken,
    /// There is no such replay.
    #[error("replay {0:?} not found")]
    ReplayUnknown(String),
    /// There is no such alarm.
    #[error("alarm {0:?} not found")]
    AlarmUnknown(String),
    /// The action is not possible in the current state of the alarm.
    #[error(transparent)]
    Alarm(#[from] AlarmError),
    /// There is no such maintenance event.
    #[error("maintenance event {0:?} not found")]
    MaintenanceUnknown(String),
    /// The threads of a pool cannot be started.
    #[error("failed to start {name} threads: {source}")]
    Threads {
        /// The name of the pool.
        name: &'static str,
        /// The error of the operating system.
        source: rayon::ThreadPoolBuildError,
    },
    /// A worker stopped before its task was done: a bug.
    #[error("a worker stopped before it could {0}")]
    WorkerLost(&'static str),
}

impl ServiceError {
    /// Whether the raw bytes of a record are no longer available. Its results still are: a response on many
    /// records omits what needs the bytes.
    pub fn is_raw_unavailable(&self) -> bool {
        matches!(
            self,
            Self::RawDeleted(_)
                | Self::Store(StoreError::ObjectMissing(_) | StoreError::ObjectDamaged { .. })
        )
    }
}
