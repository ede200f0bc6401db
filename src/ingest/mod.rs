//! Accept, validate, keep, process, announce: the path of a record through the service.
//!
//! ```text
//! bytes ─ decode ─▶ records ─ keep ─▶ raw objects, on disk ─ analyse ─▶ indicators, features ─ fold ─▶ wear ─ one transaction ─▶ announced
//! ```
//!
//! What has been answered is on the disk. A record that was stored before is answered with what was stored; one that comes late
//! changes the estimates after it to what they would have been. Time comes from the [`Clock`] that the service was started with.

mod accept;
mod alarms;
mod batch;
mod channels;
mod clock;
mod crew;
mod describing;
mod error;
mod feed;
mod fold;
mod group_commit;
mod hearing;
mod kept_raw;
mod keys;
mod libraries;
mod library_source;
mod live_event;
mod maintenance;
mod occurrences;
mod prepared;
mod read_ahead;
mod recall;
mod recomputations;
mod recompute;
mod replay;
mod replay_folder;
mod replay_run;
mod replays;
mod retention;
mod shelvings;
mod upkeep;
mod workers;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::{RwLock, Semaphore, broadcast};

use crate::asset::{AssetId, Segment};
use crate::library::{EnsembleSettings, GridSettings, LibraryShelf};
use crate::store::{AlarmNotice, Store, StoredEvent};

pub use accept::{Accepted, Given, RecordFormat};
pub use alarms::PersonsAction;
pub use batch::{BatchSummary, Refused};
pub use clock::{Clock, SystemClock};
pub use crew::{Crew, Later, Part, PartHealth, QueuedRecord, TakenOver};
pub use error::IngestError;
pub use feed::{Feed, FeedCount, Holding};
pub use libraries::{Libraries, Readiness};
pub use live_event::{LiveEvent, NumberedEvent};
pub use recall::{AskedBand, SegmentEnvelope};
pub use recomputations::{Recomputation, RecomputationState};
pub use replay::{Pace, Replay, ReplayRequest, ReplayState};
pub use retention::RawQuotas;
pub use workers::{Ticket, Workers, with_analyzer};

/// How much the service takes on at once.
#[derive(Debug, Clone)]
pub struct IngestLimits {
    /// Threads that compute.
    pub workers: usize,
    /// Requests that hold a record, waiting or being processed.
    pub requests_at_once: usize,
    /// Bytes of records that all requests together hold; and as many those of all whole recordings, each its share or one record.
    pub bytes_at_once: usize,
    /// Whole recordings (uploads of many records, replays) read at once.
    pub recordings_at_once: usize,
    /// How long a record waits for its asset's library.
    pub library_wait: Duration,
    /// What is simulated of each asset's pair besides its library, in the background.
    pub neighbours: EnsembleSettings,
    /// How many raw bytes are kept.
    pub quotas: RawQuotas,
    /// Where processes share a store: how often each looks at what another has left undone.
    pub looked_every: Duration,
}

impl Default for IngestLimits {
    fn default() -> Self {
        Self {
            workers: std::thread::available_parallelism().map_or(2, usize::from),
            requests_at_once: 64,
            bytes_at_once: 512 << 20,
            recordings_at_once: 4,
            library_wait: Duration::from_secs(120),
            neighbours: EnsembleSettings::default(),
            quotas: RawQuotas::default(),
            looked_every: Duration::from_secs(30),
        }
    }
}

/// Where the service finds and puts things.
#[derive(Debug, Clone)]
pub struct IngestFolders {
    /// Simulated libraries.
    pub libraries: PathBuf,
    /// Recordings that may be replayed; only read.
    pub recordings: PathBuf,
    /// Uploads that are read from a file while they are processed.
    pub uploads: PathBuf,
}

/// What happened, for those who follow it live.
#[derive(Debug, Clone)]
pub enum Announcement {
    /// An asset was made or its description changed.
    AssetChanged(AssetId),
    /// An asset was removed.
    AssetRemoved(AssetId),
    /// A record was analysed and stored.
    SegmentStored(Arc<Segment>),
    /// The estimates of a channel were computed again.
    HistoryFolded {
        /// The asset.
        asset: AssetId,
        /// The channel.
        channel: String,
    },
    /// A recomputation of a channel's history went on or ended.
    RecomputationChanged(Arc<Recomputation>),
    /// Something happened to an alarm.
    AlarmChanged(Arc<AlarmNotice>),
    /// Something done to a machine was told of, or taken back.
    MaintenanceChanged {
        /// The asset.
        asset: AssetId,
        /// The event.
        event: Arc<StoredEvent>,
        /// It was taken back.
        is_removed: bool,
    },
    /// A replay went on or ended.
    ReplayChanged(Arc<Replay>),
}

/// What went through the service since it started.
#[derive(Debug, Default)]
pub struct Tally {
    stored: AtomicU64,
    queued: AtomicU64,
    repeated: AtomicU64,
    refused: AtomicU64,
}

impl Tally {
    /// Records stored.
    pub fn stored(&self) -> u64 {
        self.stored.load(Ordering::Relaxed)
    }

    /// Records handed over to be analysed elsewhere.
    pub fn queued(&self) -> u64 {
        self.queued.load(Ordering::Relaxed)
    }

    /// Records that were stored before.
    pub fn repeated(&self) -> u64 {
        self.repeated.load(Ordering::Relaxed)
    }

    /// Records that could not be used.
    pub fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }
}

/// The path of records through the service; a clone is another handle to the same one.
#[derive(Clone)]
pub struct Ingest {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    part: Part,
    workers: Workers,
    libraries: Libraries,
    channels: channels::Channels,
    commits: group_commit::CommitQueue,
    recomputations: recomputations::Recomputations,
    quotas: RawQuotas,
    looked_every: Duration,
    retaining: tokio::sync::Mutex<()>,
    clock: Arc<dyn Clock>,
    folders: IngestFolders,
    announcements: broadcast::Sender<Announcement>,
    tally: Tally,
    feeds: feed::Feeds,
    replays: replays::Replays,
    recordings: Arc<Semaphore>,
    /// Held while descriptions are changed, since assets of one sensor depend on each other.
    describing: tokio::sync::Mutex<()>,
    /// Held while an asset gets what it lacks of the records of its sensor.
    catching_up: tokio::sync::Mutex<()>,
    /// Held for reading between keeping raw bytes and committing the rows that refer to them; for writing while objects that
    /// nothing refers to are removed.
    keeping: RwLock<()>,
}

impl Ingest {
    /// Starts the path on a store. To be called inside the runtime. `grid` says how libraries are simulated.
    ///
    /// Errors: a folder cannot be made, or no threads are to be had.
    pub fn new(
        store: Store,
        folders: IngestFolders,
        limits: &IngestLimits,
        grid: GridSettings,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, IngestError> {
        Self::with_part(store, folders, limits, grid, clock, Part::Whole)
    }

    /// The same for a process that does a part of the path, beside others on the same store.
    pub fn with_part(
        store: Store,
        folders: IngestFolders,
        limits: &IngestLimits,
        grid: GridSettings,
        clock: Arc<dyn Clock>,
        part: Part,
    ) -> Result<Self, IngestError> {
        replay_folder::prepare(&folders)?;
        let shelf = Arc::new(LibraryShelf::new(folders.libraries.clone()));
        let source = library_source::LibrarySource::new(shelf, &store, &clock, !matches!(part, Part::Entrance(_)));
        let (complete, completed) = tokio::sync::mpsc::unbounded_channel();
        let ingest = Self {
            inner: Arc::new(Inner {
                workers: Workers::new(limits)?,
                libraries: Libraries::new(source, grid, limits.neighbours, limits.library_wait, complete),
                channels: channels::Channels::default(),
                commits: group_commit::CommitQueue::default(),
                recomputations: recomputations::Recomputations::default(),
                quotas: limits.quotas,
                looked_every: limits.looked_every,
                retaining: tokio::sync::Mutex::default(),
                announcements: broadcast::channel(1024).0,
                tally: Tally::default(),
                feeds: feed::Feeds::default(),
                replays: replays::Replays::default(),
                recordings: Arc::new(Semaphore::new(limits.recordings_at_once)),
                describing: tokio::sync::Mutex::default(),
                catching_up: tokio::sync::Mutex::default(),
                keeping: RwLock::new(()),
                store,
                part,
                clock,
                folders,
            }),
        };
        if !ingest.is_entrance() {
            ingest.recompute_when_complete(completed);
        }
        Ok(ingest)
    }

    /// The store, for reading.
    pub fn store(&self) -> &Store {
        &self.inner.store
    }

    /// The threads that compute.
    pub fn workers(&self) -> &Workers {
        &self.inner.workers
    }

    /// The libraries of the assets.
    pub fn libraries(&self) -> &Libraries {
        &self.inner.libraries
    }

    /// What went through since the start.
    pub fn tally(&self) -> &Tally {
        &self.inner.tally
    }

    /// The time now, by the clock that the service was started with.
    pub fn now(&self) -> jiff::Timestamp {
        self.inner.clock.now()
    }

    /// Follows what happens from now on.
    pub fn follow(&self) -> broadcast::Receiver<Announcement> {
        self.inner.announcements.subscribe()
    }

    /// Goes on where the process before ended, in the background: starts the library of every asset, computes again what was computed
    /// under other settings, and removes raw objects that no record refers to. Where other processes work on the same store, it also looks
    /// after what they leave.
    ///
    /// Where records are handed over it does nothing: workers do.
    pub async fn resume(&self) -> Result<(), IngestError> {
        if self.is_entrance() {
            return Ok(());
        }
        let mut after: Option<String> = None;
        let (mut all, mut listeners) = (Vec::new(), Vec::new());
        loop {
            let assets = self.inner.store.assets(after.as_deref(), 500).await?;
            let Some(last) = assets.last() else { break };
            after = Some(last.spec.id.to_string());
            for asset in assets {
                self.inner.libraries.prepare(&asset.spec);
                if asset.spec.sensor.of.is_some() {
                    listeners.push(asset.spec.id.clone());
                }
                all.push(asset.spec.id);
            }
        }
        self.recompute_in_background(all);
        self.catch_up_in_background(listeners);
        self.end_shelvings_in_background();
        if self.inner.store.is_shared() {
            self.look_after_in_background();
            return Ok(());
        }
        self.resume_replays().await?;
        let ingest = self.clone();
        tokio::spawn(async move {
            match ingest.remove_orphans().await {
                Ok((0, _)) => {}
                Ok((objects, bytes)) => {
                    tracing::info!(objects, bytes, "removed raw objects of an earlier run that no record refers to");
                }
                Err(error) => tracing::warn!(%error, "raw objects that no record refers to not removed"),
            }
            ingest.retain_in_background();
        });
        Ok(())
    }

    fn announce(&self, announcement: Announcement) {
        // Nobody may be following.
        let _ = self.inner.announcements.send(announcement);
    }
}
