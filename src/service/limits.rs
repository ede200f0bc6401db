//! How much the service takes on, and where it finds and puts things.

use std::path::PathBuf;
use std::time::Duration;

use crate::library::EnsembleSettings;

/// How much the service takes on at once.
#[derive(Debug, Clone)]
pub struct WorkLimits {
    /// Threads that compute.
    pub workers: usize,
    /// Requests that hold a record, waiting or being processed.
    pub requests_at_once: usize,
    /// Bytes of records that all requests together hold; and as many those of all whole recordings, each its
    /// share or one record.
    pub bytes_at_once: usize,
    /// Whole recordings (uploads of many records, replays) read at once.
    pub recordings_at_once: usize,
    /// What is simulated of each asset's pair besides its library, in the background.
    pub neighbours: EnsembleSettings,
    /// How many raw bytes are kept.
    pub quotas: RawQuotas,
    /// How long raw bytes that nothing refers to are kept in quarantine.
    pub quarantined_for: Duration,
    /// How far a record's time may be ahead of the clock.
    pub start_time_ahead: Duration,
    /// Where processes share a store: how often each looks for work that another left undone.
    pub upkeep_interval: Duration,
}

impl Default for WorkLimits {
    fn default() -> Self {
        Self {
            workers: std::thread::available_parallelism().map_or(2, usize::from),
            requests_at_once: 64,
            bytes_at_once: 512 << 20,
            recordings_at_once: 4,
            neighbours: EnsembleSettings::default(),
            quotas: RawQuotas::default(),
            quarantined_for: Duration::from_secs(30 * 24 * 3600),
            start_time_ahead: Duration::from_secs(24 * 3600),
            upkeep_interval: Duration::from_secs(30),
        }
    }
}

/// How many bytes of raw recordings are kept; no bound where not given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RawQuotas {
    /// Of all assets together; an object that two assets have counts for both.
    pub bytes: Option<u64>,
    /// Of each asset.
    pub bytes_per_asset: Option<u64>,
}

/// Where the service finds and puts things.
#[derive(Debug, Clone)]
pub struct ServiceFolders {
    /// Simulated libraries.
    pub libraries: PathBuf,
    /// Recordings that may be replayed; only read.
    pub recordings: PathBuf,
    /// Uploads that are read from a file while they are processed.
    pub uploads: PathBuf,
    /// Samples of live streams that are not records yet.
    pub streams: PathBuf,
}
