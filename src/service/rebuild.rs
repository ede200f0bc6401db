//! Rebuilds the database from the raw recordings and the notes stored with them.

use std::collections::{BTreeMap, HashMap, HashSet};

use futures_util::{StreamExt, stream};
use jiff::Timestamp;

use super::error::ServiceError;
use super::parts::Service;
use super::work_queue::QueuedRecord;
use super::workers::blocking;
use crate::asset::{AssetId, SegmentId};
use crate::store::{AssetNote, Objects, RecordNote, StoreError, StoredEvent};

/// Records ingested concurrently: they share a transaction and its wait for the disk.
const AT_ONCE: usize = 8;

/// Maximum number of failures that are listed.
const MAX_FAILURES: usize = 20;

/// The result of a rebuild.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Rebuilt {
    /// Assets created.
    pub assets: u64,
    /// Records that were in the database already.
    pub known: u64,
    /// Records ingested.
    pub records: u64,
    /// Records whose raw bytes are no longer available.
    pub without_raw: u64,
    /// Records that users had removed, and that were skipped.
    pub removed: u64,
    /// Records of unknown assets.
    pub without_asset: u64,
    /// Records that could not be ingested.
    pub failed: u64,
    /// The first of these, each with the reason.
    pub failures: Vec<String>,
}

impl Service {
    /// Ingests every asset and record that is noted beside the raw recordings and missing in the database,
    /// records in the order of time. `on_progress` is called with the number of records done and the total.
    /// If none fails, the database then counts as the one that the raw recordings belong to.
    ///
    /// Records that users removed are skipped; `with_removed` they are ingested, and no longer noted as
    /// removed.
    pub async fn rebuild(
        &self,
        with_removed: bool,
        on_progress: impl Fn(usize, usize),
    ) -> Result<Rebuilt, ServiceError> {
        let mut rebuilt = Rebuilt::default();
        let mut assets = self.on_objects(Objects::asset_notes).await?;
        // Owners of a shared sensor come before the assets that share it.
        assets.sort_by_key(|note| note.spec.sensor.of.is_some());
        let mut excluded: HashSet<SegmentId> = HashSet::new();
        for note in assets {
            excluded.extend(note.excluded.iter().cloned());
            rebuilt.assets += u64::from(self.restore_asset(note).await?);
        }
        let removed = if with_removed { HashMap::new() } else { self.removal_times().await? };
        let notes = self.missing_records(&removed, &mut rebuilt).await?;
        let all = notes.len();
        let mut created: HashMap<AssetId, Option<Timestamp>> = HashMap::new();
        let mut missing = Vec::new();
        for note in notes {
            if !created.contains_key(&note.asset_id) {
                let asset = match self.store.asset(&note.asset_id).await {
                    Ok(asset) => Some(asset.created_at),
                    Err(StoreError::AssetUnknown(_)) => None,
                    Err(error) => return Err(error.into()),
                };
                created.insert(note.asset_id.clone(), asset);
            }
            match created.get(&note.asset_id).copied().flatten() {
                Some(created_at) => missing.push(QueuedRecord::from_note(note, created_at)),
                None => rebuilt.without_asset += 1,
            }
        }
        let ingested = stream::iter(&missing).map(|record| self.ingest(record));
        let mut ingested = ingested.buffered(AT_ONCE);
        let mut done = 0;
        while let Some(outcome) = ingested.next().await {
            done += 1;
            on_progress(done, all);
            match outcome {
                Ok(()) => rebuilt.records += 1,
                Err(ServiceError::Store(StoreError::ObjectMissing(_))) => rebuilt.without_raw += 1,
                Err(error) => {
                    rebuilt.failed += 1;
                    if rebuilt.failures.len() < MAX_FAILURES {
                        let record = &missing[done - 1];
                        rebuilt.failures.push(format!(
                            "record {} of {} at {}: {error}",
                            record.id, record.asset_id, record.start_time
                        ));
                    }
                }
            }
        }
        for record in missing.iter().filter(|record| excluded.contains(&record.id)) {
            if let Some(segment) = self.store.segment(&record.id).await? {
                self.exclusions.set_one(&segment, true).await?;
            }
        }
        if with_removed {
            let ids: Vec<SegmentId> = self.removal_times().await?.into_keys().collect();
            let stored = self.store.known_segments(&ids).await?;
            self.on_objects(move |objects| objects.note_restored(&stored, |_| true)).await?;
        }
        if rebuilt.failed == 0 {
            self.store.accept_objects().await?;
        }
        Ok(rebuilt)
    }

    /// Restores an asset and its maintenance events; returns whether it was missing.
    async fn restore_asset(&self, note: AssetNote) -> Result<bool, ServiceError> {
        let id = note.spec.id.clone();
        match self.store.insert_asset(&note.spec, None, note.created_at).await {
            Ok(_) => {}
            Err(StoreError::AssetExists(_)) => return Ok(false),
            Err(error) => return Err(error.into()),
        }
        let mut commit = self.store.begin().await?;
        for event in note.maintenance {
            commit.add_maintenance(&id, &StoredEvent::new(event)?).await?;
        }
        commit.finish().await?;
        Ok(true)
    }

    async fn ingest(&self, record: &QueuedRecord) -> Result<(), ServiceError> {
        let name = record.raw.sha256.clone();
        if self.on_objects(move |objects| objects.written_at(&name)).await?.is_none() {
            return Err(StoreError::ObjectMissing(record.raw.sha256.clone()).into());
        }
        loop {
            let mut ticket = self.workers.admit()?;
            ticket.grow(usize::try_from(record.raw.bytes).unwrap_or(usize::MAX))?;
            match self.pipeline.process(record, ticket).await {
                // The store is unavailable.
                Err(ServiceError::Busy { .. }) => tokio::time::sleep(std::time::Duration::from_secs(1)).await,
                processed => return processed.map(|_| ()),
            }
        }
    }

    /// The time of the last removal of each removed record.
    async fn removal_times(&self) -> Result<HashMap<SegmentId, Timestamp>, ServiceError> {
        let mut removed = HashMap::new();
        for note in self.on_objects(Objects::removals).await? {
            for segment in note.segments {
                let at = removed.entry(segment).or_insert(note.removed_at);
                *at = note.removed_at.max(*at);
            }
        }
        Ok(removed)
    }

    /// The notes of records that the database does not have, by asset and in the order of time.
    async fn missing_records(
        &self,
        removed: &HashMap<SegmentId, Timestamp>,
        rebuilt: &mut Rebuilt,
    ) -> Result<Vec<RecordNote>, ServiceError> {
        let mut missing: BTreeMap<(AssetId, Timestamp, SegmentId), RecordNote> = BTreeMap::new();
        for shard in self.on_objects(Objects::shards).await? {
            let mut notes = self.on_objects(move |objects| objects.notes(shard)).await?;
            let ids: Vec<SegmentId> = notes.iter().map(|note| note.id.clone()).collect();
            let known: HashSet<SegmentId> = self.store.known_segments(&ids).await?;
            rebuilt.known += known.len() as u64;
            notes.retain(|note| !known.contains(&note.id));
            for note in notes {
                if removed.get(&note.id).is_some_and(|at| note.received_at <= *at) {
                    rebuilt.removed += 1;
                    continue;
                }
                missing.insert((note.asset_id.clone(), note.start_time, note.id.clone()), note);
            }
        }
        Ok(missing.into_values().collect())
    }

    async fn on_objects<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Objects) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let store = self.store.clone();
        Ok(blocking("read the notes of records", move || work(store.objects())).await??)
    }
}
