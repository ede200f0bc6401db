//! Limits of the service, and its folders.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::library::EnsembleSettings;

/// Limits on the work of the service.
#[derive(Debug, Clone)]
pub struct WorkLimits {
    /// Number of worker threads.
    pub workers: usize,
    /// Number of threads that simulate libraries, which are not those of the records.
    pub simulation_threads: usize,
    /// Maximum number of requests with a record, waiting or being processed.
    pub requests_at_once: usize,
    /// Maximum number of bytes of records held by all requests together. The same number again applies to all
    /// whole recordings together, each of which holds at most its share or one record.
    pub bytes_at_once: usize,
    /// Maximum number of whole recordings (uploads of many records, replays) read at the same time.
    pub recordings_at_once: usize,
    /// Number of live streams sent at the same time.
    pub streams_at_once: usize,
    /// The ensemble of each asset's pair, simulated in the background in addition to its library.
    pub ensemble: EnsembleSettings,
    /// Quotas of raw bytes.
    pub quotas: RawQuotas,
    /// How old results are thinned; `None` to keep all of them.
    pub old_results: Option<OldResults>,
    /// How long unreferenced raw bytes stay in quarantine.
    pub quarantined_for: Duration,
    /// How far a record's start time may be ahead of the clock.
    pub start_time_ahead: Duration,
    /// On a shared store: how often each process looks for work that another one left undone.
    pub upkeep_interval: Duration,
}

impl Default for WorkLimits {
    fn default() -> Self {
        Self {
            workers: std::thread::available_parallelism().map_or(2, usize::from),
            simulation_threads: std::thread::available_parallelism().map_or(2, usize::from),
            requests_at_once: 64,
            bytes_at_once: 512 << 20,
            recordings_at_once: 4,
            streams_at_once: 64,
            ensemble: EnsembleSettings::default(),
            quotas: RawQuotas::default(),
            old_results: None,
            quarantined_for: Duration::from_secs(30 * 24 * 3600),
            start_time_ahead: Duration::from_secs(24 * 3600),
            upkeep_interval: Duration::from_secs(30),
        }
    }
}

/// Maximum numbers of bytes of raw recordings; `None` for no limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RawQuotas {
    /// For all assets together; an object of two assets counts for both.
    pub bytes: Option<u64>,
    /// For each asset.
    pub bytes_per_asset: Option<u64>,
}

/// How the results of old records are thinned, once their raw bytes are gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OldResults {
    /// Minimum age of an old record.
    pub age: Duration,
    /// Of the old records of a channel, one in each interval of this length is kept.
    pub interval: Duration,
}

/// The folders of the service.
#[derive(Debug, Clone)]
pub struct ServiceFolders {
    /// Simulated libraries.
    pub libraries: PathBuf,
    /// Recordings that may be replayed; read-only.
    pub recordings: PathBuf,
    /// Temporary files of uploads, from which they are processed.
    pub uploads: PathBuf,
    /// Samples of live streams that are not part of a record yet.
    pub streams: PathBuf,
}

impl ServiceFolders {
    /// The folders in a data folder.
    pub fn in_data_folder(folder: &Path) -> Self {
        Self {
            libraries: folder.join("libraries"),
            recordings: folder.join("recordings"),
            uploads: folder.join("uploads"),
            streams: folder.join("streams"),
        }
    }
}
