//! The only SQL and the only raw-object paths.
//!
//! A data folder holds `flankwatch.db` (what is derived: assets, segments, estimates), `raw/` (recordings as
//! they came, named by their hash, with notes of what makes records of them), `streams/` (samples that are
//! not records yet) and `lock`. Where processes share a store, PostgreSQL and a bucket take their places, and
//! there are no streams; statements and methods are the same. All methods speak in domain types; rows and
//! statements do not leave this room.

mod alarm_commit;
mod alarms;
mod assets;
mod audit;
mod backup;
mod channel_rows;
mod commit;
mod database;
mod dead_letters;
mod error;
mod exclusion;
mod fold_states;
mod generations;
mod identity;
mod integrity;
mod keyed_uploads;
mod latest_records;
mod library_builds;
mod maintenance;
mod notification_rows;
mod notifications;
mod objects;
mod raw;
mod recent_wear;
mod record_results;
mod removal;
mod replays;
mod resumable_uploads;
mod rows;
mod schema;
mod segments;
mod settings;
mod shared_sensors;
mod shelvings;
mod silences;
mod stream_copies;
mod stream_journal;
mod stream_levels;
mod tokens;
mod trend;
mod trend_blocks;
mod upkeep;
mod wear_rows;

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, OnceLock};

use jiff::{SignedDuration, Timestamp};

use database::Database;
use recent_wear::CurveCache;
use schema::Dialect;
use trend::TrendCache;

pub use alarm_commit::{AlarmNotice, FoldedAlarms, PlacedChange};
pub use alarms::{AlarmFilter, StoredAlarm, StoredAlarmChange};
pub use assets::{AnalysisKeys, Asset, ChannelKeys, ChannelSummary, DescriptionsMark};
pub use audit::{Audit, Finding};
pub use backup::{Copied, back_up, put_back};
pub use channel_rows::ChannelRows;
pub use commit::Commit;
pub use error::StoreError;
pub use fold_states::{FoldState, SEGMENTS_PER_STATE};
pub use generations::{AnalysisGeneration, MadeFrom, WearGeneration};
pub use keyed_uploads::KeyedUpload;
pub use latest_records::LatestRecord;
pub use maintenance::StoredEvent;
pub use notification_rows::{Attempt, Notified, PendingNotification};
pub use notifications::{Notification, NotificationKind, Recipient, Recipients};
pub use objects::{
    AssetNote, Disk, ListedObject, Objects, Quarantined, RecordNote, RemovalNote, StoreMark, SystemDisk,
};
pub use raw::GivenUp;
pub use record_results::RecordResults;
pub use removal::{RecordRange, RemovedRecords};
pub use resumable_uploads::{NewUpload, StoredUpload, UploadPiece, UploadProgress};
pub use segments::{Analysed, NewSegment, Order, RunResult, SegmentFilter, SegmentKey, StoredFeatures};
pub use settings::StoreSettings;
#[cfg(feature = "postgres")]
pub use settings::{BucketCredentials, BucketSettings, ObjectsSettings, SharedSettings};
pub use silences::Silence;
pub use stream_journal::{JournalEntry, StreamJournal};
pub use stream_levels::{StreamLevels, TimedLevel};
pub use tokens::{StoredToken, TokenStore, TokensVersion};
pub use trend::{Trend, WearPoint};

/// The store; a clone is another handle to the same one.
#[derive(Debug, Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    database: Database,
    objects: Objects,
    trends: TrendCache,
    curves: CurveCache,
    /// At which age an object that nothing refers to is removed, where others may be storing what refers to
    /// it.
    orphan_age: Option<SignedDuration>,
    /// Why nothing is removed from the objects.
    held: Mutex<Option<String>>,
    /// Something may have been written since the generation was raised.
    is_changed: AtomicBool,
    /// Who is notified of alarms.
    recipients: OnceLock<Arc<Recipients>>,
}

impl Store {
    /// Opens a store: a data folder, made where it is missing, or what processes share. To be called inside a
    /// runtime.
    ///
    /// Errors: the folder cannot be written, another process works on it, the database cannot be reached or
    /// is of a later version, or the objects are those of other processes.
    pub async fn open(settings: &StoreSettings) -> Result<Self, StoreError> {
        let store = Self::connect(settings).await?;
        store.compare_marks(true).await?;
        Ok(store)
    }

    /// The same in a data folder whose objects are on another disk; the database is on the system's.
    pub async fn open_on(folder: &Path, disk: Arc<dyn Disk>) -> Result<Self, StoreError> {
        let database = Database::open_folder(folder).await?;
        let store = Self::of(database, Objects::open_on(folder.join("raw"), disk)?, None);
        store.compare_marks(true).await?;
        Ok(store)
    }

    /// The same, whichever store the objects are of: to make its database again.
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
        Ok(Self::of(database, objects, orphan_age))
    }

    fn of(database: Database, objects: Objects, orphan_age: Option<SignedDuration>) -> Self {
        Self {
            inner: Arc::new(Inner {
                database,
                objects,
                trends: TrendCache::default(),
                curves: CurveCache::default(),
                orphan_age,
                held: Mutex::default(),
                is_changed: AtomicBool::default(),
                recipients: OnceLock::new(),
            }),
        }
    }

    /// At which age an object that nothing refers to is removed; none where this process has the store to
    /// itself and can tell.
    pub fn orphan_age(&self) -> Option<SignedDuration> {
        self.inner.orphan_age
    }

    /// The raw recordings. Their methods block on the disk or the network.
    pub fn objects(&self) -> &Objects {
        &self.inner.objects
    }

    /// Whether the database answers and is whole, as far as is known.
    pub async fn check(&self) -> Result<(), StoreError> {
        self.check_whole()?;
        sqlx::query("SELECT COUNT(*) FROM _sqlx_migrations").fetch_one(self.read()).await?;
        Ok(())
    }

    /// Whether the database takes what is written to it, found out by a small committed change.
    pub async fn check_writable(&self, local: Timestamp) -> Result<(), StoreError> {
        self.check_whole()?;
        sqlx::query(
            "INSERT INTO counters (name, value) VALUES ('write_probe_ns', $1) ON CONFLICT (name) DO UPDATE SET value = excluded.value",
        )
        .bind(rows::to_ns(local)?)
        .execute(self.write())
        .await?;
        Ok(())
    }

    /// What is known to be damaged of the database; nothing is written to it any more.
    pub fn damage(&self) -> Option<&str> {
        self.inner.database.damage.get()
    }

    /// Notes what a statement says of the database's file.
    pub fn note_damage(&self, what: String) {
        self.inner.database.damage.note(what);
    }

    /// The raw objects of a store, without its database. To be called inside a runtime.
    pub fn open_objects(settings: &StoreSettings) -> Result<Objects, StoreError> {
        match settings {
            StoreSettings::Folder(folder) => Ok(Objects::open_to_read(folder.join("raw"))),
            #[cfg(feature = "postgres")]
            StoreSettings::Shared(shared) => Objects::open_shared(&shared.objects),
        }
    }

    /// Refuses to write to a damaged database.
    fn check_whole(&self) -> Result<(), StoreError> {
        let path = self.inner.database.path.as_deref().unwrap_or(Path::new("flankwatch.db"));
        match self.damage() {
            Some(what) => Err(integrity::damaged(path, what.to_owned())),
            None => Ok(()),
        }
    }

    /// Writes what is still in the log into the database and closes it.
    pub async fn close(&self) {
        self.inner.database.close().await;
    }

    /// Says who is notified of what happens to alarms from now on; before anything is written, and once.
    pub fn notify(&self, recipients: Recipients) {
        if self.inner.recipients.set(Arc::new(recipients)).is_err() {
            tracing::warn!("those who are notified of alarms stay those who were named first");
        }
    }

    fn recipients(&self) -> Arc<Recipients> {
        self.inner.recipients.get().map(Arc::clone).unwrap_or_default()
    }

    /// Whether other processes work on it as well.
    pub fn is_shared(&self) -> bool {
        self.inner.orphan_age.is_some()
    }

    fn dialect(&self) -> Dialect {
        self.inner.database.dialect
    }

    fn read(&self) -> &sqlx::AnyPool {
        &self.inner.database.read
    }

    fn write(&self) -> &sqlx::AnyPool {
        &self.inner.database.write
    }
}
