//! Raw objects, and the removal of unreferenced ones.
//!
//! Between the storage of raw bytes and the commit of the rows that reference them, an object looks
//! unreferenced. Within this process a lock distinguishes the two. On a shared store another process may be
//! between these steps too, or a record may wait in the queue: storing an object again resets its age, so an
//! unreferenced object is removed only once it is older than any record can wait.

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use jiff::{SignedDuration, Timestamp};
use tokio::runtime::Handle;
use tokio::sync::{Mutex, OnceCell, OwnedRwLockReadGuard, OwnedRwLockWriteGuard, RwLock};

use crate::asset::{AssetId, Segment};
use crate::service::error::ServiceError;
use crate::service::work_queue::Role;
use crate::service::workers::{Workers, blocking};
use crate::store::{AssetMetadata, Objects, RecordMetadata, Store, StoreError, Tombstone};

/// Objects removed under one lock; commits run in between.
const DISPOSAL_BATCH: usize = 32;

/// The raw objects of a store.
pub(crate) struct RawObjects {
    store: Store,
    workers: Arc<Workers>,
    role: Role,
    /// How long an object stays in quarantine before it is removed.
    quarantined_for: Duration,
    /// Read-locked from before raw bytes are stored until their rows are committed; write-locked while
    /// unreferenced objects are removed.
    uncommitted: Arc<RwLock<()>>,
    /// Held while the metadata of an asset is written: a slower one would overwrite the metadata of a later
    /// change.
    writing_metadata: Mutex<()>,
}

/// The objects that records in the queue or among the dead letters reference, read when first needed.
pub(super) type WaitingObjects = OnceCell<HashSet<String>>;

/// Raw objects whose rows are not committed yet. If they are never committed, the unreferenced ones are
/// removed when this is dropped, because they count towards no quota.
pub(crate) struct UncommittedObjects {
    objects: Arc<RawObjects>,
    names: Vec<String>,
    _lock: OwnedRwLockReadGuard<()>,
}

impl RawObjects {
    pub(crate) fn new(store: Store, workers: Arc<Workers>, role: Role, quarantined_for: Duration) -> Self {
        Self {
            store,
            workers,
            role,
            quarantined_for,
            uncommitted: Arc::default(),
            writing_metadata: Mutex::default(),
        }
    }

    /// Stores raw bytes under their names, with the metadata files needed to decode `records` from them;
    /// durable once this returns.
    pub(crate) async fn put(
        &self,
        raws: Vec<(String, Bytes)>,
        records: Vec<RecordMetadata>,
    ) -> Result<(), ServiceError> {
        let store = self.store.clone();
        Ok(blocking("store raw bytes", move || store.objects().put_all(&raws, &records)).await??)
    }

    /// Stores the raw bytes of known records again if they were lost or damaged, but not if the retention
    /// deleted them.
    pub(crate) async fn repair(
        &self,
        known: &[Segment],
        raws: &[(String, Bytes)],
    ) -> Result<(), ServiceError> {
        let mut kept = Vec::new();
        for (name, bytes) in raws {
            let of = known.iter().find(|segment| segment.raw.sha256 == *name);
            if let Some(segment) = of
                && self.store.keeps_raw(&segment.asset_id, name).await?
            {
                kept.push((name.clone(), bytes.clone()));
            }
        }
        if kept.is_empty() {
            return Ok(());
        }
        let store = self.store.clone();
        let repair = move || {
            kept.retain(|(name, _)| store.objects().get(name).is_err_and(|error| error.is_object_error()));
            for (object, _) in &kept {
                tracing::warn!(object, "a raw object was lost or damaged and was received again; storing it");
            }
            store.objects().put_all(&kept, &[])
        };
        Ok(blocking("store raw bytes", repair).await??)
    }

    /// Writes the metadata of an asset beside the raw objects, or removes it if the asset is deleted.
    ///
    /// An existing metadata file is kept while removals are suspended, that is, if the objects may not belong
    /// to the database.
    pub(crate) async fn write_asset_metadata(&self, id: &AssetId) -> Result<(), ServiceError> {
        let _guard = self.writing_metadata.lock().await;
        let mut metadata = self.asset_metadata(id).await?;
        loop {
            self.put_asset_metadata(id, metadata.clone()).await?;
            // Another process may have changed the asset and written its metadata file a moment before this
            // one.
            let now = if self.store.is_shared() { self.asset_metadata(id).await? } else { return Ok(()) };
            if now == metadata {
                return Ok(());
            }
            metadata = now;
        }
    }

    /// The metadata of an asset; `None` if it is deleted.
    async fn asset_metadata(&self, id: &AssetId) -> Result<Option<AssetMetadata>, ServiceError> {
        match self.store.asset(id).await {
            Ok(asset) => Ok(Some(AssetMetadata {
                spec: asset.spec,
                created_at: asset.created_at,
                updated_at: asset.updated_at,
                maintenance: self.store.maintenance(id).await?,
                excluded: self.store.excluded(id).await?,
            })),
            Err(StoreError::AssetUnknown(_)) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    async fn put_asset_metadata(
        &self,
        id: &AssetId,
        metadata: Option<AssetMetadata>,
    ) -> Result<(), ServiceError> {
        let (store, id) = (self.store.clone(), id.clone());
        let write = move || {
            let objects = store.objects();
            if store.removal_hold().is_some() && objects.asset_metadata(&id)?.is_some() {
                return Ok(());
            }
            match &metadata {
                Some(metadata) => objects.put_asset_metadata(metadata),
                None => objects.remove_asset_metadata(&id),
            }
        };
        Ok(blocking("write the metadata of an asset", write).await??)
    }

    /// Writes the metadata of an asset whose change is stored; after a failure the next start writes it.
    pub(crate) async fn update_asset_metadata(&self, id: &AssetId) {
        if let Err(error) = self.write_asset_metadata(id).await {
            tracing::warn!(asset = %id, %error, "failed to write the metadata of an asset beside its raw recordings");
        }
    }

    /// Removes the metadata of assets that were deleted by a process which ended before it removed them; on a
    /// shared store only metadata files that no process can have written recently.
    async fn remove_stale_asset_metadata(&self) -> Result<(), ServiceError> {
        let store = self.store.clone();
        let list = move || Ok::<_, StoreError>((store.objects().all_asset_metadata()?, Age::now(&store)?));
        let (all, age) = blocking("read the metadata of assets", list).await??;
        for metadata in
            all.iter().filter(|metadata| age.is_old_enough(metadata.created_at.max(metadata.updated_at)))
        {
            if let Err(StoreError::AssetUnknown(id)) = self.store.asset(&metadata.spec.id).await {
                tracing::info!(asset = %id, "removing the metadata of a deleted asset");
                self.write_asset_metadata(&id).await?;
            }
        }
        Ok(())
    }

    /// Writes a tombstone of removed records beside the raw objects, so that a rebuild skips them. On a
    /// shared store their dead-letter count is raised, so that the queue accepts them if they are sent again.
    pub(crate) async fn write_tombstone(&self, tombstone: Tombstone) -> Result<(), ServiceError> {
        if self.store.is_shared() {
            let letter = i64::try_from(tombstone.removed_at.as_nanosecond()).unwrap_or(i64::MAX);
            for segment in &tombstone.segments {
                self.store.count_dead_letter(segment, letter.wrapping_neg(), tombstone.removed_at).await?;
            }
        }
        let store = self.store.clone();
        Ok(blocking("write a tombstone", move || store.objects().put_tombstone(&tombstone)).await??)
    }

    /// Takes records that are stored out of the tombstones: their removal failed, or they were
    /// sent again. On a shared store only out of those old enough that no process is still removing the
    /// records. The caller holds the [`exclusive`](Self::exclusive) lock.
    pub(crate) async fn forget_failed_removals(&self) -> Result<(), ServiceError> {
        // An older database has records that were removed since.
        if self.store.removal_hold().is_some() {
            return Ok(());
        }
        let store = self.store.clone();
        let list = move || -> Result<_, StoreError> {
            let tombstones = store.objects().tombstones()?;
            Ok(tombstones.into_iter().flat_map(|tombstone| tombstone.segments).collect::<Vec<_>>())
        };
        let removed = blocking("read the tombstones", list).await??;
        let stored = self.store.known_segments(&removed).await?;
        if stored.is_empty() {
            return Ok(());
        }
        let store = self.store.clone();
        let forget = move || {
            let age = store.is_shared().then(|| Age::now(&store)).transpose()?;
            let is_old_enough = |removed_at| age.as_ref().is_none_or(|age| age.is_old_enough(removed_at));
            store.objects().withdraw_tombstones(&stored, is_old_enough)
        };
        Ok(blocking("write the tombstones", forget).await??)
    }

    /// Protects objects of these names, which may exist already or not, from removal until the returned guard
    /// is dropped.
    pub(crate) async fn uncommitted(self: &Arc<Self>, mut names: Vec<String>) -> UncommittedObjects {
        // On a shared store the upkeep removes unreferenced objects.
        if self.store.is_shared() {
            names.clear();
        }
        UncommittedObjects {
            names,
            _lock: Arc::clone(&self.uncommitted).read_owned().await,
            objects: Arc::clone(self),
        }
    }

    /// Waits until no raw bytes are waiting for the commit of their rows, and blocks new ones until the guard
    /// is dropped.
    pub(crate) async fn exclusive(&self) -> OwnedRwLockWriteGuard<()> {
        Arc::clone(&self.uncommitted).write_owned().await
    }

    /// Moves all unreferenced objects into quarantine, such as those that a killed process stored without
    /// results, and removes objects whose quarantine has expired, and metadata of deleted assets. Does
    /// nothing while removals are suspended.
    pub(crate) async fn sweep(&self) -> Result<(), ServiceError> {
        if self.store.check_marks().await?.is_some() {
            return Ok(());
        }
        {
            let _exclusive = self.exclusive().await;
            self.forget_failed_removals().await?;
        }
        let (objects, bytes) = self.quarantine_orphans().await?;
        if objects > 0 {
            tracing::info!(objects, bytes, "moved unreferenced raw objects into quarantine");
        }
        let (store, kept_for) = (self.store.clone(), self.quarantined_for);
        let remove = move || -> Result<_, StoreError> {
            let age = Age::now(&store)?;
            let removed = store.objects().remove_quarantined(kept_for, age.now)?;
            Ok((removed, store.objects().shards()?, age))
        };
        let ((objects, bytes), shards, age) = self.workers.run("empty the quarantine", remove).await??;
        for shard in shards {
            self.remove_orphaned_metadata(shard, Some(age)).await?;
        }
        if objects > 0 {
            tracing::info!(objects, bytes, "removed raw objects whose quarantine has expired");
        }
        self.remove_stale_asset_metadata().await
    }

    async fn quarantine_orphans(&self) -> Result<(u64, u64), ServiceError> {
        let (mut count, mut bytes) = (0, 0);
        let waiting = WaitingObjects::new();
        let store = self.store.clone();
        let shards = self.workers.run("list raw objects", move || store.objects().shards()).await??;
        for shard in shards {
            let store = self.store.clone();
            let list = move || -> Result<_, StoreError> {
                let mut listed = store.objects().list(shard)?;
                if !listed.is_empty() {
                    let age = Age::now(&store)?;
                    listed.retain(|object| age.is_old_enough(object.written_at));
                }
                Ok(listed)
            };
            let listed = self.workers.run("list raw objects", list).await??;
            let names = listed.iter().map(|object| object.name.clone()).collect();
            let suspects = self.store.orphans_among(names).await?;
            let moved = self.quarantine_known(suspects, &waiting).await?;
            count += moved.len() as u64;
            let moved = listed.iter().filter(|object| moved.contains(&object.name));
            bytes += moved.map(|object| object.bytes).sum::<u64>();
        }
        Ok((count, bytes))
    }

    /// The objects referenced by records in the queue or among the dead letters.
    async fn waiting(&self) -> Result<HashSet<String>, ServiceError> {
        match self.role.queue() {
            Some(queue) => queue.objects_waiting().await,
            None => Ok(HashSet::new()),
        }
    }

    /// Moves those of these objects into quarantine that are unreferenced.
    pub(crate) async fn quarantine(&self, names: Vec<String>) -> Result<(), ServiceError> {
        self.quarantine_known(names, &WaitingObjects::new()).await.map(drop)
    }

    async fn quarantine_known(
        &self,
        names: Vec<String>,
        waiting: &WaitingObjects,
    ) -> Result<Vec<String>, ServiceError> {
        if names.is_empty() {
            return Ok(names);
        }
        let store = self.store.clone();
        let now = blocking("read the clock of the object store", move || store.objects().time()).await??;
        self.dispose_of(names, waiting, move |objects, name| objects.quarantine(name, now)).await
    }

    /// Removes those of these objects that are unreferenced, and returns them.
    pub(super) async fn remove(
        &self,
        names: Vec<String>,
        waiting: &WaitingObjects,
    ) -> Result<Vec<String>, ServiceError> {
        if names.is_empty() {
            return Ok(names);
        }
        self.dispose_of(names, waiting, Objects::remove).await
    }

    /// Calls `away` for each of these objects that neither a row nor a waiting record references, and returns
    /// them; on a shared store only for objects that no process can have stored recently.
    async fn dispose_of(
        &self,
        names: Vec<String>,
        waiting: &WaitingObjects,
        away: impl Fn(&Objects, &str) -> Result<(), StoreError> + Clone + Send + 'static,
    ) -> Result<Vec<String>, ServiceError> {
        // Commits wait for the lock, and the scan of the queue takes long: it is made before, and only if
        // there are objects of that age. Those of records that are enqueued later are younger.
        let store = self.store.clone();
        let select = move || {
            // Reading the time writes a file, and the disk may be full: only if it is needed.
            let age = store.is_shared().then(|| Age::now(&store)).transpose()?;
            Ok::<_, StoreError>((old_enough(&store, names, age)?, age))
        };
        let (mut names, age) = self.workers.run("read the ages of raw recordings", select).await??;
        if names.is_empty() {
            return Ok(names);
        }
        let waiting = waiting.get_or_try_init(|| self.waiting()).await?;
        names.retain(|name| !waiting.contains(name));
        let mut disposed = Vec::new();
        for chunk in names.chunks(DISPOSAL_BATCH) {
            // Objects being stored at the moment look unreferenced too.
            let _exclusive = self.exclusive().await;
            let orphans = self.store.orphans_among(chunk.to_vec()).await?;
            let (store, away) = (self.store.clone(), away.clone());
            let dispose_of = move || {
                // Storing an object again resets its age.
                let orphans = old_enough(&store, orphans, age)?;
                orphans.iter().try_for_each(|name| away(store.objects(), name))?;
                Ok::<_, StoreError>(orphans)
            };
            disposed.extend(self.workers.run("remove raw recordings", dispose_of).await??);
        }
        Ok(disposed)
    }

    /// Removes the unreferenced ones of these objects; returns their number.
    async fn remove_uncommitted(&self, names: Vec<String>) -> Result<usize, ServiceError> {
        let removed = self.remove(names, &WaitingObjects::new()).await?;
        let shards: BTreeSet<u8> =
            removed.iter().filter_map(|name| u8::from_str_radix(name.get(..2)?, 16).ok()).collect();
        for shard in shards {
            self.remove_orphaned_metadata(shard, None).await?;
        }
        Ok(removed.len())
    }

    /// Removes the metadata files in a shard none of whose objects exists; with `age` only those that are old
    /// enough.
    async fn remove_orphaned_metadata(&self, shard: u8, age: Option<Age>) -> Result<(), ServiceError> {
        let is_old_enough = move |written_at| age.is_none_or(|age| age.is_old_enough(written_at));
        let store = self.store.clone();
        let list = move || store.objects().orphaned_metadata(shard, is_old_enough);
        let empty = self.workers.run("list metadata files", list).await??;
        if empty.is_empty() {
            return Ok(());
        }
        // The same record may be about to be stored again.
        let _exclusive = self.exclusive().await;
        let store = self.store.clone();
        let remove = move || store.objects().remove_orphaned_metadata(empty, is_old_enough);
        Ok(self.workers.run("remove metadata files", remove).await??)
    }
}

/// The minimum age of an unreferenced object before it may be removed. Objects of accepted records that wait
/// for their results are younger. Ages are by the clock of the object store, because the clock of a process
/// may be wrong.
#[derive(Debug, Clone, Copy)]
struct Age {
    now: Timestamp,
    /// `None` if this process is alone on the store and knows which objects are unreferenced.
    orphan_age: Option<SignedDuration>,
}

impl Age {
    fn now(store: &Store) -> Result<Self, StoreError> {
        Ok(Self { now: store.objects().time()?, orphan_age: store.orphan_age().filter(|age| !age.is_zero()) })
    }

    fn is_old_enough(&self, written_at: Timestamp) -> bool {
        self.orphan_age.is_none_or(|orphan_age| self.now.duration_since(written_at) >= orphan_age)
    }
}

/// Those of these objects that may be removed if they are unreferenced; with `age` only old ones.
fn old_enough(store: &Store, names: Vec<String>, age: Option<Age>) -> Result<Vec<String>, StoreError> {
    if store.removal_hold().is_some() {
        return Ok(Vec::new());
    }
    let Some(age) = age else { return Ok(names) };
    let mut old = Vec::new();
    for name in names {
        if store.objects().written_at(&name)?.is_some_and(|written_at| age.is_old_enough(written_at)) {
            old.push(name);
        }
    }
    Ok(old)
}

impl UncommittedObjects {
    /// Marks the rows of the objects as committed.
    pub(crate) fn are_committed(&mut self) {
        self.names.clear();
    }
}

impl Drop for UncommittedObjects {
    fn drop(&mut self) {
        if self.names.is_empty() {
            return;
        }
        // At the end of the process this is left to the next start.
        let Ok(runtime) = Handle::try_current() else {
            return;
        };
        let (objects, names) = (Arc::clone(&self.objects), std::mem::take(&mut self.names));
        runtime.spawn(async move {
            match objects.remove_uncommitted(names).await {
                Ok(0) => {}
                Ok(objects) => {
                    tracing::info!(objects, "removed raw objects whose records could not be stored")
                }
                Err(error) => {
                    tracing::debug!(%error, "failed to remove raw objects whose records could not be stored")
                }
            }
        });
    }
}

#[cfg(test)]
mod tests;
