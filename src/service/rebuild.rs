//! Rebuilds the database from the raw recordings and the metadata files stored with them.

use std::collections::{BTreeMap, HashMap, HashSet};

use futures_util::{StreamExt, stream};
use jiff::Timestamp;

use super::error::ServiceError;
use super::parts::Service;
use super::work_queue::QueuedRecord;
use super::workers::blocking;
use crate::asset::{AssetId, SegmentId};
use crate::store::{AssetMetadata, Objects, RecordMetadata, RecordRange, StoreError, StoredEvent};

/// Records looked up or removed in one transaction.
const IN_ONE_TRANSACTION: usize = 200;

/// Records ingested concurrently: they share a transaction and its wait for the disk.
const MAX_CONCURRENT: usize = 8;

/// Maximum number of failures that are listed.
const MAX_FAILURES: usize = 20;

/// The result of a rebuild.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Rebuilt {
    /// Assets created.
    pub assets: u64,
    /// Assets that existed, and got a later description, events or exclusions.
    pub updated: u64,
    /// Records of an older database that users had removed since, and that were removed again.
    pub removed_again: u64,
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

/// What a rebuild did about an asset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Restored {
    New,
    Updated,
    Unchanged,
}

/// The last removal of a record by users.
#[derive(Debug)]
struct Removal {
    at: Timestamp,
    /// When the record was last received, by its metadata files; those of an asset that shares a sensor have
    /// none.
    received: Option<Timestamp>,
}

impl Removal {
    /// Whether it includes a stored record that was received at a time: it was not sent again later.
    fn includes(&self, received_at: Timestamp) -> bool {
        self.received.unwrap_or(received_at).max(received_at) <= self.at
    }
}

impl Service {
    /// Ingests every asset and record with metadata beside the raw recordings that is missing in the
    /// database, records in the order of time. Assets that exist get the later descriptions, events and
    /// exclusions of their metadata files. `on_progress` is called with the number of records done and the
    /// total. If none fails, the database then counts as the one that the raw recordings belong to. After an
    /// interruption or a failure a repeat completes the rest. Histories are recomputed after the next start.
    ///
    /// Records that users removed are skipped, and removed from a database that is older than the recordings;
    /// `with_removed` they are ingested, and no longer listed in a tombstone.
    pub async fn rebuild(
        &self,
        with_removed: bool,
        on_progress: impl Fn(usize, usize),
    ) -> Result<Rebuilt, ServiceError> {
        let mut rebuilt = Rebuilt::default();
        // The tombstones are newer than a database whose mark differs from that of the objects. In the
        // matching database, a record that is listed in a tombstone is one whose removal failed.
        let is_older = self.store.removal_hold().is_some();
        let mut assets = self.on_objects(Objects::all_asset_metadata).await?;
        // Owners of a shared sensor come before the assets that share it.
        assets.sort_by_key(|metadata| metadata.spec.sensor.of.is_some());
        let mut updated: HashSet<AssetId> = HashSet::new();
        for metadata in &assets {
            match self.restore_asset(metadata).await? {
                Restored::New => rebuilt.assets += 1,
                Restored::Updated => drop(updated.insert(metadata.spec.id.clone())),
                Restored::Unchanged => {}
            }
        }
        let mut removed = if with_removed { HashMap::new() } else { self.removal_times().await? };
        let records = self.missing_records(&mut removed, &mut rebuilt).await?;
        let all = records.len();
        let mut created: HashMap<AssetId, Option<Timestamp>> = HashMap::new();
        let mut missing = Vec::new();
        for metadata in records {
            if !created.contains_key(&metadata.asset_id) {
                let asset = match self.store.asset(&metadata.asset_id).await {
                    Ok(asset) => Some(asset.created_at),
                    Err(StoreError::AssetUnknown(_)) => None,
                    Err(error) => return Err(error.into()),
                };
                created.insert(metadata.asset_id.clone(), asset);
            }
            match created.get(&metadata.asset_id).copied().flatten() {
                Some(created_at) => {
                    missing.push(QueuedRecord { metadata, asset_created_at: created_at, dead_letters: 0 });
                }
                None => rebuilt.without_asset += 1,
            }
        }
        let ingested = stream::iter(&missing).map(|record| self.ingest(record));
        let mut ingested = ingested.buffered(MAX_CONCURRENT);
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
                        let record = &missing[done - 1].metadata;
                        rebuilt.failures.push(format!(
                            "record {} of {} at {}: {error}",
                            record.id, record.asset_id, record.start_time
                        ));
                    }
                }
            }
        }
        for metadata in &assets {
            if self.restore_exclusions(metadata).await? {
                updated.insert(metadata.spec.id.clone());
            }
        }
        rebuilt.updated = updated.len() as u64;
        let orphans = if is_older { self.remove_again(&removed, &mut rebuilt).await? } else { Vec::new() };
        if with_removed {
            let ids: Vec<SegmentId> = self.removal_times().await?.into_keys().collect();
            let stored = self.store.known_segments(&ids).await?;
            self.on_objects(move |objects| objects.withdraw_tombstones(&stored, |_| true)).await?;
        }
        if rebuilt.failed == 0 {
            self.store.accept_objects().await?;
            self.raw.quarantine(orphans).await?;
        }
        Ok(rebuilt)
    }

    /// Adds to the database what it is missing of an asset: the asset, a later description, events. An event
    /// that the metadata file does not have stays, because the database may have got it since.
    async fn restore_asset(&self, metadata: &AssetMetadata) -> Result<Restored, ServiceError> {
        let id = &metadata.spec.id;
        let (asset, mut restored) =
            match self.store.insert_asset(&metadata.spec, None, metadata.created_at).await {
                Ok(asset) => (asset, Restored::New),
                Err(StoreError::AssetExists(_)) => (self.store.asset(id).await?, Restored::Unchanged),
                Err(error) => return Err(error.into()),
            };
        let known = self.store.maintenance(id).await?;
        let events: Vec<_> = metadata.maintenance.iter().filter(|event| !known.contains(event)).collect();
        if restored == Restored::Unchanged && (metadata.updated_at > asset.updated_at || !events.is_empty()) {
            restored = Restored::Updated;
        }
        if metadata.updated_at > asset.updated_at {
            self.store.update_asset(&metadata.spec, None, metadata.updated_at).await?;
        }
        if events.is_empty() {
            return Ok(restored);
        }
        let mut transaction = self.store.begin().await?;
        for event in events {
            transaction.add_maintenance(id, &StoredEvent::new(event.clone())?).await?;
            for channel in self.store.channels(id).await? {
                transaction.fold_again_from(&channel, event.time).await?;
            }
        }
        transaction.commit().await?;
        Ok(restored)
    }

    /// Excludes the stored records that the metadata of an asset lists; returns whether one of them was not.
    async fn restore_exclusions(&self, metadata: &AssetMetadata) -> Result<bool, ServiceError> {
        let id = &metadata.spec.id;
        let known: HashSet<SegmentId> = self.store.excluded(id).await?.into_iter().collect();
        let missing: Vec<SegmentId> =
            metadata.excluded.iter().filter(|segment| !known.contains(segment)).cloned().collect();
        let mut changed = 0;
        for chunk in missing.chunks(IN_ONE_TRANSACTION) {
            for segment in self.store.segments_by_id(chunk).await? {
                changed += self.store.set_excluded(id, &RecordRange::of(&segment), true).await?;
            }
        }
        Ok(changed > 0)
    }

    /// Removes the records that were removed at these times, unless they were received later; returns the
    /// names of the raw objects that are no longer referenced.
    async fn remove_again(
        &self,
        removed: &HashMap<SegmentId, Removal>,
        rebuilt: &mut Rebuilt,
    ) -> Result<Vec<String>, ServiceError> {
        let mut of_assets: BTreeMap<AssetId, Vec<SegmentId>> = BTreeMap::new();
        let ids: Vec<&SegmentId> = removed.keys().collect();
        for chunk in ids.chunks(IN_ONE_TRANSACTION) {
            let chunk: Vec<SegmentId> = chunk.iter().copied().cloned().collect();
            for segment in self.store.segments_by_id(&chunk).await? {
                if removed.get(&segment.id).is_some_and(|removal| removal.includes(segment.received_at)) {
                    of_assets.entry(segment.asset_id).or_default().push(segment.id);
                }
            }
        }
        let mut orphans = Vec::new();
        for (asset, ids) in of_assets {
            for chunk in ids.chunks(IN_ONE_TRANSACTION) {
                let removed = self.store.remove_records(&asset, chunk).await?;
                rebuilt.removed_again += removed.segments.len() as u64;
                orphans.extend(removed.orphans);
            }
        }
        Ok(orphans)
    }

    async fn ingest(&self, record: &QueuedRecord) -> Result<(), ServiceError> {
        let raw = &record.metadata.raw;
        let name = raw.sha256.clone();
        if self.on_objects(move |objects| objects.written_at(&name)).await?.is_none() {
            return Err(StoreError::ObjectMissing(raw.sha256.clone()).into());
        }
        loop {
            let ticket = self.workers.wait_to_admit(raw.bytes).await?;
            match self.pipeline.process(record, ticket).await {
                // The store is unavailable.
                Err(ServiceError::Busy { .. }) => tokio::time::sleep(std::time::Duration::from_secs(1)).await,
                processed => return processed.map(|_| ()),
            }
        }
    }

    /// The last removal of each removed record.
    async fn removal_times(&self) -> Result<HashMap<SegmentId, Removal>, ServiceError> {
        let mut removed = HashMap::new();
        for tombstone in self.on_objects(Objects::tombstones).await? {
            for segment in tombstone.segments {
                let removal =
                    removed.entry(segment).or_insert(Removal { at: tombstone.removed_at, received: None });
                removal.at = tombstone.removed_at.max(removal.at);
            }
        }
        Ok(removed)
    }

    /// The metadata of records that the database does not have, by asset and in the order of time. Adds to
    /// the removals when their records were received.
    async fn missing_records(
        &self,
        removed: &mut HashMap<SegmentId, Removal>,
        rebuilt: &mut Rebuilt,
    ) -> Result<Vec<RecordMetadata>, ServiceError> {
        let mut missing: BTreeMap<(AssetId, Timestamp, SegmentId), RecordMetadata> = BTreeMap::new();
        for shard in self.on_objects(Objects::shards).await? {
            let mut records = self.on_objects(move |objects| objects.record_metadata(shard)).await?;
            let ids: Vec<SegmentId> = records.iter().map(|metadata| metadata.id.clone()).collect();
            let known: HashSet<SegmentId> = self.store.known_segments(&ids).await?;
            rebuilt.known += known.len() as u64;
            for metadata in &records {
                if let Some(removal) = removed.get_mut(&metadata.id) {
                    removal.received = removal.received.max(Some(metadata.received_at));
                }
            }
            records.retain(|metadata| !known.contains(&metadata.id));
            for metadata in records {
                if removed.get(&metadata.id).is_some_and(|removal| metadata.received_at <= removal.at) {
                    rebuilt.removed += 1;
                    continue;
                }
                missing
                    .insert((metadata.asset_id.clone(), metadata.start_time, metadata.id.clone()), metadata);
            }
        }
        Ok(missing.into_values().collect())
    }

    async fn on_objects<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Objects) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let store = self.store.clone();
        Ok(blocking("read the metadata of records", move || work(store.objects())).await??)
    }
}

#[cfg(test)]
mod tests;
