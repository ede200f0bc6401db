//! Raw objects, and the removal of unreferenced ones.
//!
//! Between the storage of raw bytes and the commit of the rows that reference them, an object looks
//! unreferenced. Within this process a lock distinguishes the two. On a shared store another process may be
//! between these steps too, or a record may wait in the queue: storing an object again resets its age, so an
//! unreferenced object is removed only once it is older than any record can wait.

mod metadata;

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use jiff::{SignedDuration, Timestamp};
use tokio::runtime::Handle;
use tokio::sync::{Mutex, OnceCell, OwnedRwLockReadGuard, OwnedRwLockWriteGuard, RwLock};

use crate::asset::Segment;
use crate::service::error::ServiceError;
use crate::service::work_queue::Role;
use crate::service::workers::{Workers, blocking};
use crate::store::{Objects, RecordMetadata, Store, StoreError};

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
