//! The store: the database and the raw objects. It contains the only SQL and the only object paths.
//!
//! A data folder contains `flankwatch.db` (assets and derived data: segments, estimates), `raw/` (recordings
//! as received, named by their hash, with the metadata needed to decode them), `streams/` (samples that are
//! not part of a record yet) and `lock`. A store shared by several processes uses PostgreSQL and a bucket
//! instead, and keeps streams in rows; statements and methods are the same. All methods use domain types;
//! rows and statements do not leave this module.

mod alarms;
mod assets;
mod audit;
mod backup;
mod coordination;
mod database;
mod error;
mod history;
mod identity;
mod layouts;
mod maintenance;
mod notifications;
mod objects;
mod records;
mod replays;
mod settings;
mod shared_sensors;
mod streams;
mod tokens;
mod transaction;
mod uploads;

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, OnceLock};

use jiff::{SignedDuration, Timestamp};

use database::Database;
use database::schema::Dialect;
use database::watched::WatchedPool;
use history::recent_wear::CurveCache;
use history::trend::TrendCache;
use layouts::LayoutCache;

pub use alarms::silences::Silence;
pub use alarms::writing::{AlarmNotice, FoldedAlarms, PlacedChange};
pub use alarms::{AlarmFilter, StoredAlarm, StoredAlarmChange};
pub use assets::{AnalysisKeys, Asset, ChannelKeys, ChannelSummary, DescriptionsMark};
pub use audit::{Audit, Finding};
pub use backup::{Copied, back_up, restore_backup};
pub use coordination::queue_partitions::{PartitionOwners, WORKER_LEASE};
pub use database::integrity::FoundDamage;
pub use error::StoreError;
pub use history::channel_rows::ChannelRows;
pub use history::fold_states::{RECORDS_PER_STATE, StoredFoldState, is_stored};
pub use history::generations::{AnalysisGeneration, GenerationInputs, WearGeneration};
pub use history::trend::{Trend, WearPoint};
pub use maintenance::StoredEvent;
pub use notifications::delivery::{Attempt, PendingNotification, RecipientStatus};
pub use notifications::{Notification, NotificationKind, Recipient, Recipients};
pub use objects::{
    AssetMetadata, Disk, ListedObject, Objects, Quarantined, RecordMetadata, StoreMark, SystemDisk, Tombstone,
};
pub use records::latest::LatestRecord;
use records::latest::LatestRecordCache;
pub use records::raw::DeletedRaw;
pub use records::removal::{RecordRange, RemovedRecords};
pub use records::results::RecordResults;
pub use records::segments::{
    Analysed, NewSegment, Order, RunResult, SegmentFilter, SegmentKey, StoredFeatures,
};
pub use records::thinning::Thinning;
pub use settings::StoreSettings;
#[cfg(feature = "postgres")]
pub use settings::{BucketCredentials, BucketSettings, ObjectsSettings, SharedSettings};
pub use streams::entry::JournalEntry;
pub use streams::journal::StreamJournal;
pub use streams::levels::{StreamLevels, TimedLevel};
pub use streams::rows::{StreamAppend, StreamCheckpoint, StreamKey, StreamVersion};
pub use tokens::{Scope, Token, TokenStore, TokensVersion};
pub use transaction::Transaction;
pub use uploads::keyed::KeyedUpload;
pub use uploads::resumable::{NewUpload, ReadLease, StoredUpload, UploadPiece, UploadState};

/// A handle to the store; clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    database: Database,
    objects: Objects,
    /// The disk of stream journals.
    disk: Arc<dyn Disk>,
    trends: TrendCache,
    curves: CurveCache,
    latest_records: LatestRecordCache,
    layouts: Arc<LayoutCache>,
    /// Age at which an unreferenced object is removed; `None` unless other processes share the store, which
    /// may be about to commit a reference to it.
    orphan_age: Option<SignedDuration>,
    /// Why removals from the objects are suspended; `None` while they are allowed.
    removal_hold: Mutex<Option<String>>,
    /// Whether something may have been written since the generation was raised.
    is_changed: AtomicBool,
    /// Recipients of alarm notifications.
    recipients: OnceLock<Arc<Recipients>>,
}

impl Store {
    /// Opens a data folder, which is created if it does not exist, or a shared store. Must be called inside a
    /// Tokio runtime.
    ///
    /// # Errors
    /// The folder cannot be written or is used by another process; the database cannot be reached or has a
    /// newer version; the objects belong to another store.
    pub async fn open(settings: &StoreSettings) -> Result<Self, StoreError> {
        let store = Self::connect(settings).await?;
        store.compare_marks(true).await?;
        Ok(store)
    }

    /// Opens a data folder with its objects and stream journals on the given disk; the database stays on the
    /// system's disk.
    pub async fn open_on(folder: &Path, disk: Arc<dyn Disk>) -> Result<Self, StoreError> {
        let database = Database::open_folder(folder).await?;
        let objects = Objects::open_on(folder.join("raw"), Arc::clone(&disk))?;
        let store = Self::of(database, objects, disk, None);
        store.compare_marks(true).await?;
        Ok(store)
    }

    /// Opens a store to rebuild its database, whichever store the objects belong to.
    pub async fn open_to_rebuild(settings: &StoreSettings) -> Result<Self, StoreError> {
        let store = Self::connect(settings).await?;
        store.compare_marks(false).await?;
        Ok(store)
    }

    async fn connect(settings: &StoreSettings) -> Result<Self, StoreError> {
        let (database, objects, orphan_age) = match settings {
            StoreSettings::Folder(folder) => {
                (Database::open_folder(folder).await?, Objects::open(folder.join("raw"))?, None)
            }
            #[cfg(feature = "postgres")]
            StoreSettings::Shared(shared) => {
                let objects = Objects::open_shared(&shared.objects)?;
                let age = SignedDuration::try_from(shared.orphan_age).unwrap_or(SignedDuration::MAX);
                (Database::connect(shared).await?, objects, Some(age))
            }
        };
        Ok(Self::of(database, objects, Arc::new(SystemDisk), orphan_age))
    }

    fn of(
        database: Database,
        objects: Objects,
        disk: Arc<dyn Disk>,
        orphan_age: Option<SignedDuration>,
    ) -> Self {
        Self {
            inner: Arc::new(Inner {
                database,
                objects,
                disk,
                trends: TrendCache::default(),
                curves: CurveCache::default(),
                latest_records: LatestRecordCache::default(),
                layouts: Arc::default(),
                orphan_age,
                removal_hold: Mutex::default(),
                is_changed: AtomicBool::default(),
                recipients: OnceLock::new(),
            }),
        }
    }

    /// Age at which an unreferenced object is removed; `None` if this process is alone on the store and knows
    /// which objects are unreferenced.
    pub fn orphan_age(&self) -> Option<SignedDuration> {
        self.inner.orphan_age
    }

    /// The raw objects. Their methods block on the disk or the network.
    pub fn objects(&self) -> &Objects {
        &self.inner.objects
    }

    /// The disk of stream journals.
    pub(crate) fn disk(&self) -> Arc<dyn Disk> {
        Arc::clone(&self.inner.disk)
    }

    /// Checks that the database responds and that no damage of it is known.
    pub async fn check(&self) -> Result<(), StoreError> {
        self.check_whole()?;
        sqlx::query("SELECT COUNT(*) FROM _sqlx_migrations").fetch_one(self.read()).await?;
        Ok(())
    }

    /// Checks that the database is writable, by committing a small change.
    pub async fn check_writable(&self, local: Timestamp) -> Result<(), StoreError> {
        sqlx::query(
            "INSERT INTO counters (name, value) VALUES ('write_probe_ns', $1) ON CONFLICT (name) DO UPDATE SET value = excluded.value",
        )
        .bind(database::rows::to_ns(local)?)
        .execute(self.write()?)
        .await?;
        Ok(())
    }

    /// The known damage of the database, after which nothing is written to it; `None` if no damage is known.
    pub fn damage(&self) -> Option<String> {
        self.inner.database.damage.get()
    }

    /// Records damage of the database file that a statement reported. Damage of its pages counts until a
    /// check of the file shows that there is none. Must be called inside a Tokio runtime.
    pub fn report_damage(&self, found: &FoundDamage) {
        let Database { damage, path, .. } = &self.inner.database;
        damage.report(found, path.as_deref());
    }

    /// Opens the raw objects of a store without its database. Must be called inside a Tokio runtime.
    pub fn open_objects(settings: &StoreSettings) -> Result<Objects, StoreError> {
        match settings {
            StoreSettings::Folder(folder) => Ok(Objects::open_to_read(folder.join("raw"))),
            #[cfg(feature = "postgres")]
            StoreSettings::Shared(shared) => Objects::open_shared(&shared.objects),
        }
    }

    /// Returns an error if the database is known to be damaged.
    fn check_whole(&self) -> Result<(), StoreError> {
        let path = self.inner.database.path.as_deref().unwrap_or(Path::new("flankwatch.db"));
        match self.damage() {
            Some(what) => Err(database::integrity::damaged(path, what.to_owned())),
            None => Ok(()),
        }
    }

    /// Checkpoints the write-ahead log and closes the database.
    pub async fn close(&self) {
        self.inner.database.close().await;
    }

    /// Sets the recipients of alarm notifications. To be called once, before anything is written.
    pub fn notify(&self, recipients: Recipients) {
        if self.inner.recipients.set(Arc::new(recipients)).is_err() {
            tracing::warn!("ignored a second list of alarm recipients: they are set once");
        }
    }

    fn recipients(&self) -> Arc<Recipients> {
        self.inner.recipients.get().map(Arc::clone).unwrap_or_default()
    }

    /// Whether other processes use the store as well.
    pub fn is_shared(&self) -> bool {
        self.inner.orphan_age.is_some()
    }

    fn dialect(&self) -> Dialect {
        self.inner.database.dialect
    }

    fn read(&self) -> &WatchedPool {
        &self.inner.database.read
    }

    fn layouts(&self) -> &LayoutCache {
        &self.inner.layouts
    }

    /// The connection of writers.
    ///
    /// # Errors
    /// [`StoreError::DatabaseDamaged`] if the database is known to be damaged.
    fn write(&self) -> Result<&WatchedPool, StoreError> {
        self.check_whole()?;
        Ok(&self.inner.database.write)
    }
}
