//! Raw objects, and those that nothing refers to.
//!
//! Between the storing of raw bytes and the commit of the rows that refer to them an object looks like one
//! that nothing needs. In this process a lock tells them apart. Another process of the store may be in
//! between as well, or a record may wait in the queue: every storing writes the object anew, so its age says
//! since when nobody has brought it, and one that nothing refers to goes once it is older than anything
//! waits.

use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;
use tokio::runtime::Handle;
use tokio::sync::{OwnedRwLockReadGuard, OwnedRwLockWriteGuard, RwLock};

use crate::service::clock::Clock;
use crate::service::error::ServiceError;
use crate::service::workers::{Workers, blocking};
use crate::store::{Store, StoreError};

/// The raw objects of a store.
pub(crate) struct RawObjects {
    store: Store,
    workers: Arc<Workers>,
    clock: Arc<dyn Clock>,
    /// Held for reading from before raw bytes are stored until their rows are committed; for writing while
    /// objects that nothing refers to are removed.
    uncommitted: Arc<RwLock<()>>,
}

/// Raw objects whose rows are still to be committed. Where that does not happen, those that nothing refers to
/// are removed when this is dropped: they count to no quota.
pub(crate) struct UncommittedObjects {
    objects: Arc<RawObjects>,
    names: Vec<String>,
    _lock: OwnedRwLockReadGuard<()>,
}

impl RawObjects {
    pub(crate) fn new(store: Store, workers: Arc<Workers>, clock: Arc<dyn Clock>) -> Self {
        Self {
            store,
            workers,
            clock,
            uncommitted: Arc::default(),
        }
    }

    /// Stores raw bytes under their names; they are on the disk once this returns.
    pub(crate) async fn put(&self, raws: Vec<(String, Bytes)>) -> Result<(), ServiceError> {
        let store = self.store.clone();
        Ok(blocking("store raw bytes", move || store.objects().put_all(&raws)).await??)
    }

    /// Keeps objects of these names, to be stored now or there already, from being removed until this is
    /// dropped.
    pub(crate) async fn uncommitted(self: &Arc<Self>, mut names: Vec<String>) -> UncommittedObjects {
        // Where other processes store as well, the upkeep removes what one of them has lost.
        if self.store.is_shared() {
            names.clear();
        }
        UncommittedObjects {
            names,
            _lock: Arc::clone(&self.uncommitted).read_owned().await,
            objects: Arc::clone(self),
        }
    }

    /// Waits until nobody is between storing raw bytes and committing their rows, and keeps everybody from
    /// beginning.
    pub(crate) async fn exclusive(&self) -> OwnedRwLockWriteGuard<()> {
        Arc::clone(&self.uncommitted).write_owned().await
    }

    /// Removes all objects that nothing refers to: what a process that was killed had stored without its
    /// results. Returns how many there were, and their bytes.
    pub(crate) async fn remove_orphans(&self) -> Result<(u64, u64), ServiceError> {
        let (mut count, mut bytes) = (0, 0);
        for shard in 0..=u8::MAX {
            let store = self.store.clone();
            let list = move || store.objects().list(shard);
            let mut listed = self.workers.run("list raw objects", list).await??;
            listed.retain(|object| is_old_enough(&self.store, &*self.clock, object.written_at));
            let names = listed.iter().map(|object| object.name.clone()).collect();
            let suspects = self.store.orphans_among(names).await?;
            if suspects.is_empty() {
                continue;
            }
            // What is being stored just now looks the same: asked again under the lock.
            let _exclusive = self.exclusive().await;
            let orphans = self.store.orphans_among(suspects).await?;
            count += orphans.len() as u64;
            bytes += listed
                .iter()
                .filter(|object| orphans.contains(&object.name))
                .map(|object| object.bytes)
                .sum::<u64>();
            self.remove(orphans).await?;
        }
        Ok((count, bytes))
    }

    /// Removes objects that nothing refers to; where other processes store as well, only those that none of
    /// them can have brought lately. The caller has the [`exclusive`](Self::exclusive) lock.
    pub(crate) async fn remove(&self, names: Vec<String>) -> Result<(), ServiceError> {
        let (store, clock) = (self.store.clone(), Arc::clone(&self.clock));
        let remove = move || {
            let objects = store.objects();
            for name in &names {
                // Asked again at the last moment: bringing an object again makes it new.
                if !store.is_shared() || objects.written_at(name)?.is_some_and(|time| is_old_enough(&store, &*clock, time)) {
                    objects.remove(name)?;
                }
            }
            Ok::<_, StoreError>(())
        };
        Ok(self.workers.run("remove raw recordings", remove).await??)
    }

    /// Removes those of these objects that nothing refers to; returns how many.
    async fn remove_uncommitted(&self, names: Vec<String>) -> Result<usize, ServiceError> {
        let _exclusive = self.exclusive().await;
        let orphans = self.store.orphans_among(names).await?;
        let count = orphans.len();
        self.remove(orphans).await?;
        Ok(count)
    }
}

/// Whether an object of this time may go where nothing refers to it. What was answered and waits for its
/// results is younger.
fn is_old_enough(store: &Store, clock: &dyn Clock, written_at: Timestamp) -> bool {
    let age = store.orphan_age();
    age.is_none_or(|age| age.is_zero() || clock.now().duration_since(written_at) >= age)
}

impl UncommittedObjects {
    /// Their rows are committed.
    pub(crate) fn are_committed(&mut self) {
        self.names.clear();
    }
}

impl Drop for UncommittedObjects {
    fn drop(&mut self) {
        if self.names.is_empty() {
            return;
        }
        // At the end of the process the next start does it.
        let Ok(runtime) = Handle::try_current() else { return };
        let (objects, names) = (Arc::clone(&self.objects), std::mem::take(&mut self.names));
        runtime.spawn(async move {
            match objects.remove_uncommitted(names).await {
                Ok(0) => {}
                Ok(objects) => tracing::info!(objects, "removed raw objects whose records could not be stored"),
                Err(error) => tracing::debug!(%error, "failed to remove raw objects whose records could not be stored"),
            }
        });
    }
}
