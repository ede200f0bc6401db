//! Audit of a store: compares rows with objects and lists inconsistencies.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use super::database::rows::get;
use super::database::{Database, integrity};
use super::{Objects, Store, StoreError, StoreSettings, SystemDisk};
use crate::asset::SegmentId;

/// Rows read in one query.
const ROWS_PER_QUERY: i64 = 500;

/// Maximum number of findings that are listed; further ones are only counted.
const MAX_FINDINGS: usize = 1000;

/// The contents of a store, and its inconsistencies.
#[derive(Debug, Clone, Default)]
pub struct Audit {
    /// Number of records.
    pub records: u64,
    /// Number of raw objects that records reference.
    pub objects: u64,
    /// Total size of these objects in bytes.
    pub bytes: u64,
    /// Number of raw objects in quarantine.
    pub quarantined: u64,
    /// Number of unreferenced raw objects of a shared store that are too young for quarantine: they may
    /// belong to records that wait in the queue.
    pub unreferenced: u64,
    /// The findings, at most the first thousand.
    pub findings: Vec<Finding>,
    /// Number of all findings.
    pub found: u64,
}

/// An inconsistency of a store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Finding {
    /// The database file is damaged.
    Database(String),
    /// The database and the objects belong to different stores or generations.
    Marks(String),
    /// A record cannot be read.
    Record {
        /// The segment of the record.
        segment: SegmentId,
        /// Why it cannot be read.
        why: String,
    },
    /// A record references an object that does not exist.
    Missing(String),
    /// An object's bytes are not those that were stored.
    Damaged(String),
    /// An object is not referenced.
    Orphan(String),
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Database(what) => write!(f, "database: {what}"),
            Self::Marks(what) => write!(f, "store: {what}"),
            Self::Record { segment, why } => write!(f, "record {segment}: {why}"),
            Self::Missing(name) => write!(f, "object {name}: missing"),
            Self::Damaged(name) => write!(f, "object {name}: damaged"),
            Self::Orphan(name) => write!(f, "object {name}: no record refers to it"),
        }
    }
}

impl Audit {
    fn add(&mut self, finding: Finding) {
        self.found += 1;
        if self.findings.len() < MAX_FINDINGS {
            self.findings.push(finding);
        }
    }
}

impl Store {
    /// Opens a store for reading, also while a service uses it. Nothing is written to a data folder except
    /// the files that SQLite needs beside the database to read it.
    ///
    /// # Errors
    /// Those of [`open`](Self::open); the database does not exist.
    pub async fn open_to_read(settings: &StoreSettings) -> Result<Self, StoreError> {
        match settings {
            StoreSettings::Folder(folder) => {
                let database = Database::open_folder_to_read(folder).await?;
                let objects = Objects::open_to_read(folder.join("raw"));
                Ok(Self::of(database, objects, Arc::new(SystemDisk), None))
            }
            #[cfg(feature = "postgres")]
            shared @ StoreSettings::Shared(_) => Self::open(shared).await,
        }
    }

    /// Compares rows and objects; `with_hashes` also reads the bytes of every object and checks their hashes.
    /// An object is unreferenced if it still has no row after `patience`.
    pub async fn audit(&self, with_hashes: bool, patience: Duration) -> Result<Audit, StoreError> {
        let mut audit = Audit::default();
        if let Some(path) = &self.inner.database.path {
            for what in integrity::findings_of(path).await? {
                audit.add(Finding::Database(what));
            }
        }
        if let Some(why) = self.marks_differ().await? {
            audit.add(Finding::Marks(why));
        }
        self.audit_records(&mut audit).await?;
        self.audit_objects(with_hashes, &mut audit).await?;
        self.audit_orphans(patience, &mut audit).await?;
        audit.quarantined = self.on_objects(Objects::quarantined).await?.len() as u64;
        Ok(audit)
    }

    async fn audit_records(&self, audit: &mut Audit) -> Result<(), StoreError> {
        let mut after = String::new();
        loop {
            let rows = sqlx::query("SELECT id FROM segments WHERE id > $1 ORDER BY id LIMIT $2")
                .bind(after.as_str())
                .bind(ROWS_PER_QUERY)
                .fetch_all(self.read())
                .await?;
            let Some(last) = rows.last() else { return Ok(()) };
            after = get(last, "id")?;
            for row in &rows {
                let segment = SegmentId(get(row, "id")?);
                let found = self.segment(&segment).await;
                // A running service may have deleted it in the meantime.
                if matches!(found, Ok(None))
                    && self.known_segments(std::slice::from_ref(&segment)).await?.is_empty()
                {
                    continue;
                }
                audit.records += 1;
                let why = match found {
                    Ok(Some(_)) => continue,
                    Ok(None) => "its analysis or estimate is missing".to_owned(),
                    Err(error) => error.to_string(),
                };
                audit.add(Finding::Record { segment, why });
            }
        }
    }

    async fn audit_objects(&self, with_hashes: bool, audit: &mut Audit) -> Result<(), StoreError> {
        let mut after = String::new();
        loop {
            let rows = sqlx::query(
                "SELECT sha256, MAX(bytes) AS bytes FROM raw_objects WHERE sha256 > $1 GROUP BY sha256 ORDER BY sha256 LIMIT $2",
            )
            .bind(after.as_str())
            .bind(ROWS_PER_QUERY)
            .fetch_all(self.read())
            .await?;
            let Some(last) = rows.last() else { return Ok(()) };
            after = get(last, "sha256")?;
            for row in &rows {
                let name: String = get(row, "sha256")?;
                let bytes = u64::try_from(get::<i64>(row, "bytes")?).unwrap_or(0);
                audit.objects += 1;
                audit.bytes += bytes;
                let look = name.clone();
                let looked_at = self.on_objects(move |objects| match with_hashes {
                    true => objects.get(&look).map(|_| ()),
                    false => objects.check_size(&look, bytes),
                });
                let finding = match looked_at.await {
                    Ok(()) => continue,
                    Err(StoreError::ObjectMissing(name)) => Finding::Missing(name),
                    Err(StoreError::ObjectDamaged { expected, .. }) => Finding::Damaged(expected),
                    Err(error) => return Err(error),
                };
                // The retention may have deleted it in the meantime.
                if self.orphans_among(vec![name]).await?.is_empty() {
                    audit.add(finding);
                }
            }
        }
    }

    async fn audit_orphans(&self, patience: Duration, audit: &mut Audit) -> Result<(), StoreError> {
        let mut suspects = Vec::new();
        for shard in self.on_objects(Objects::shards).await? {
            let listed = self.on_objects(move |objects| objects.list(shard)).await?;
            suspects
                .extend(self.orphans_among(listed.into_iter().map(|object| object.name).collect()).await?);
        }
        if suspects.is_empty() {
            return Ok(());
        }
        // Objects that a running service is storing get their rows in a moment.
        tokio::time::sleep(patience).await;
        let now = self.on_objects(Objects::time).await?;
        for name in self.orphans_among(suspects).await? {
            let checked = name.clone();
            match self.on_objects(move |objects| objects.written_at(&checked)).await? {
                Some(written_at)
                    if self.orphan_age().is_some_and(|age| now.duration_since(written_at) < age) =>
                {
                    audit.unreferenced += 1;
                }
                Some(_) => audit.add(Finding::Orphan(name)),
                None => {}
            }
        }
        Ok(())
    }
}
