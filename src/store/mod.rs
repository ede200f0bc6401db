//! The only SQL and the only raw-object paths.
//!
//! A data folder holds `flankwatch.db` (what is derived: assets, segments, estimates), `raw/` (recordings as they came, named by
//! their hash) and `lock`. All methods speak in domain types; rows and statements do not leave this room.

mod alarm_commit;
mod alarms;
mod assets;
mod commit;
mod database;
mod error;
mod fold_states;
mod generations;
mod heard_through;
mod keyed_uploads;
mod maintenance;
mod objects;
mod raw;
mod replays;
mod rows;
mod schema;
mod segments;
mod shelvings;
mod trend;

use std::path::Path;
use std::sync::Arc;

use database::Database;
use trend::TrendShelf;

pub use alarm_commit::{AlarmNotice, FoldedAlarms, PlacedChange};
pub use alarms::{AlarmFilter, StoredAlarm, StoredAlarmChange};
pub use assets::{AnalysisKeys, Asset, ChannelKeys, ChannelSummary};
pub use commit::Commit;
pub use error::StoreError;
pub use fold_states::{FoldState, SEGMENTS_PER_STATE};
pub use generations::{AnalysisGeneration, WearGeneration};
pub use keyed_uploads::KeyedUpload;
pub use maintenance::StoredEvent;
pub use objects::Objects;
pub use raw::GivenUp;
pub use segments::{Analysed, NewSegment, Order, RunResult, SegmentFilter, SegmentKey, StoredFeatures};
pub use trend::{Trend, WearPoint};

/// The store of one data folder; a clone is another handle to the same one.
#[derive(Debug, Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    database: Database,
    objects: Objects,
    trends: TrendShelf,
}

impl Store {
    /// Opens a data folder, made where it is missing.
    ///
    /// Errors: the folder cannot be written, another process works on it, or its database is of a later version.
    pub async fn open(folder: &Path) -> Result<Self, StoreError> {
        let database = Database::open(folder).await?;
        let objects = Objects::open(folder.join("raw"))?;
        Ok(Self {
            inner: Arc::new(Inner {
                database,
                objects,
                trends: TrendShelf::default(),
            }),
        })
    }

    /// The raw recordings. Their methods block on the disk.
    pub fn objects(&self) -> &Objects {
        &self.inner.objects
    }

    /// Whether the database answers.
    pub async fn check(&self) -> Result<(), StoreError> {
        sqlx::query("SELECT COUNT(*) FROM migrations").fetch_one(self.read()).await?;
        Ok(())
    }

    /// Writes what is still in the log into the database and closes it.
    pub async fn close(&self) {
        self.inner.database.close().await;
    }

    fn read(&self) -> &sqlx::AnyPool {
        &self.inner.database.read
    }

    fn write(&self) -> &sqlx::AnyPool {
        &self.inner.database.write
    }
}
