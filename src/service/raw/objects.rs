//! Raw objects, and those that nothing refers to.
//!
//! Between the storing of raw bytes and the commit of the rows that refer to them an object looks like one
//! that nothing needs. In this process a lock tells them apart. Another process of the store may be in
//! between as well, or a record may wait in the queue: every storing writes the object anew, so its age says
//! since when nobody has brought it, and one that nothing refers to goes once it is older than anything
//! waits.

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use jiff::{SignedDuration, Timestamp};
use tokio::runtime::Handle;
use tokio::sync::{OwnedRwLockReadGuard, OwnedRwLockWriteGuard, RwLock};

use crate::asset::{AssetId, Segment};
use crate::service::error::ServiceError;
use crate::service::work_queue::Role;
use crate::service::workers::{Workers, blocking};
use crate::store::{AssetNote, RecordNote, RemovalNote, Store, StoreError};

/// The raw objects of a store.
pub(crate) struct RawObjects {
    store: Store,
    workers: Arc<Workers>,
    role: Role,
    /// How long an object is in quarantine before it is removed.
    quarantined_for: Duration,
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
    pub(crate) fn new(store: Store, workers: Arc<Workers>, role: Role, quarantined_for: Duration) -> Self {
        Self { store, workers, role, quarantined_for, uncommitted: Arc::default() }
    }

    /// Stores raw bytes under their names, and what makes `records` of them; they are on the disk once this
    /// returns.
    pub(crate) async fn put(
        &self,
        raws: Vec<(String, Bytes)>,
        records: Vec<RecordNote>,
    ) -> Result<(), ServiceError> {
        let store = self.store.clone();
        Ok(blocking("store raw bytes", move || store.objects().put_all(&raws, &records)).await??)
    }

    /// Stores raw bytes of records that are stored already where they were lost or damaged; not those that
    /// were given up.
    pub(crate) async fn mend(&self, known: &[Segment], raws: &[(String, Bytes)]) -> Result<(), ServiceError> {
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
        let mend = move || {
            kept.retain(|(name, _)| store.objects().get(name).is_err_and(|error| error.is_of_object()));
            for (object, _) in &kept {
                tracing::warn!(
                    object,
                    "a raw recording was lost or damaged, and came again: it is stored anew"
                );
            }
            store.objects().put_all(&kept, &[])
        };
        Ok(blocking("store raw bytes", mend).await??)
    }

    /// Notes beside the raw objects what people said of an asset, or that it is gone.
    ///
    /// Where the objects are not those that the database knows, what is noted already stays.
    pub(crate) async fn note_asset(&self, id: &AssetId) -> Result<(), ServiceError> {
        let note = match self.store.asset(id).await {
            Ok(asset) => Some(AssetNote {
                spec: asset.spec,
                created_at: asset.created_at,
                maintenance: self.store.maintenance(id).await?,
                excluded: self.store.excluded(id).await?,
            }),
            Err(StoreError::AssetUnknown(_)) => None,
            Err(error) => return Err(error.into()),
        };
        let (store, id) = (self.store.clone(), id.clone());
        let write = move || {
            let objects = store.objects();
            if store.held().is_some() && objects.asset_note(&id)?.is_some() {
                return Ok(());
            }
            match &note {
                Some(note) => objects.put_asset_note(note),
                None => objects.remove_asset_note(&id),
            }
        };
        Ok(blocking("note an asset", write).await??)
    }

    /// The same for an asset whose change is stored: where it cannot be noted now, the next start does it.
    pub(crate) async fn note_changed_asset(&self, id: &AssetId) {
        if let Err(error) = self.note_asset(id).await {
            tracing::warn!(asset = %id, %error, "failed to note an asset beside its raw recordings");
        }
    }

    /// Notes beside the raw objects that records were removed: nothing makes them again. Sent again, they are
    /// others to a queue.
    pub(crate) async fn note_removal(&self, removal: RemovalNote) -> Result<(), ServiceError> {
        if self.store.is_shared() {
            let letter = i64::try_from(removal.removed_at.as_nanosecond()).unwrap_or(i64::MAX);
            for segment in &removal.segments {
                self.store.count_dead_letter(segment, letter.wrapping_neg(), removal.removed_at).await?;
            }
        }
        let store = self.store.clone();
        Ok(blocking("note a removal", move || store.objects().put_removal(&removal)).await??)
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

    /// Puts all objects that nothing refers to into quarantine: what a process that was killed had stored
    /// without its results. Removes what was there for long enough. Nothing is moved or removed where the
    /// objects are not those that the database knows.
    pub(crate) async fn sweep(&self) -> Result<(), ServiceError> {
        if self.store.check_marks().await?.is_some() {
            return Ok(());
        }
        let (objects, bytes) = self.quarantine_orphans().await?;
        if objects > 0 {
            tracing::info!(objects, bytes, "moved raw objects that no record refers to into quarantine");
        }
        let (store, kept_for) = (self.store.clone(), self.quarantined_for);
        let remove = move || {
            let objects = store.objects();
            let removed = objects.remove_quarantined(kept_for, objects.time()?)?;
            let kept = objects.quarantined()?.into_iter().map(|quarantined| quarantined.name).collect();
            (0..=u8::MAX).try_for_each(|shard| objects.remove_empty_notes(shard, &kept))?;
            Ok::<_, StoreError>(removed)
        };
        let (objects, bytes) = self.workers.run("empty the quarantine", remove).await??;
        if objects > 0 {
            tracing::info!(objects, bytes, "removed raw objects that were in quarantine for long enough");
        }
        Ok(())
    }

    async fn quarantine_orphans(&self) -> Result<(u64, u64), ServiceError> {
        let (mut count, mut bytes) = (0, 0);
        let mut waiting: Option<HashSet<String>> = None;
        for shard in 0..=u8::MAX {
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
            if suspects.is_empty() {
                continue;
            }
            if waiting.is_none() {
                waiting = Some(self.waiting().await?);
            }
            // What is being stored just now looks the same: asked again under the lock.
            let _exclusive = self.exclusive().await;
            let mut orphans = self.store.orphans_among(suspects).await?;
            orphans.retain(|name| waiting.as_ref().is_none_or(|waiting| !waiting.contains(name)));
            count += orphans.len() as u64;
            bytes += listed
                .iter()
                .filter(|object| orphans.contains(&object.name))
                .map(|object| object.bytes)
                .sum::<u64>();
            self.put_away(orphans).await?;
        }
        Ok((count, bytes))
    }

    /// What records refer to that are in the queue or among the dead letters.
    async fn waiting(&self) -> Result<HashSet<String>, ServiceError> {
        match self.role.queue() {
            Some(queue) => queue.objects_waiting().await,
            None => Ok(HashSet::new()),
        }
    }

    /// Moves objects that nothing refers to into quarantine. The caller has the
    /// [`exclusive`](Self::exclusive) lock.
    pub(crate) async fn quarantine(&self, names: Vec<String>) -> Result<(), ServiceError> {
        let unneeded = self.without_waiting(names).await?;
        self.put_away(unneeded).await
    }

    /// Removes objects that nothing refers to. The caller has the [`exclusive`](Self::exclusive) lock.
    pub(crate) async fn remove(&self, names: Vec<String>) -> Result<(), ServiceError> {
        let unneeded = self.without_waiting(names).await?;
        self.give_away(unneeded, |store, name| store.objects().remove(name)).await
    }

    /// Those of these objects that no record needs which waits.
    async fn without_waiting(&self, mut names: Vec<String>) -> Result<Vec<String>, ServiceError> {
        if !names.is_empty() {
            let waiting = self.waiting().await?;
            names.retain(|name| !waiting.contains(name));
        }
        Ok(names)
    }

    /// Moves objects into quarantine that neither a row nor a record that waits refers to.
    async fn put_away(&self, names: Vec<String>) -> Result<(), ServiceError> {
        if names.is_empty() {
            return Ok(());
        }
        let store = self.store.clone();
        let now = blocking("learn the time", move || store.objects().time()).await??;
        self.give_away(names, move |store, name| store.objects().quarantine(name, now)).await
    }

    /// Does away with objects; where other processes store as well, only with those that none of them can
    /// have brought lately.
    async fn give_away(
        &self,
        names: Vec<String>,
        away: impl Fn(&Store, &str) -> Result<(), StoreError> + Send + 'static,
    ) -> Result<(), ServiceError> {
        if names.is_empty() || self.store.held().is_some() {
            return Ok(());
        }
        let store = self.store.clone();
        let give_away = move || {
            // Nothing is written to learn the time where it does not matter: the disk may be full.
            let age = store.is_shared().then(|| Age::now(&store)).transpose()?;
            for name in &names {
                // Asked again at the last moment: bringing an object again makes it new.
                let is_old_enough = |age: &Age| {
                    Ok::<_, StoreError>(
                        store.objects().written_at(name)?.is_some_and(|time| age.is_old_enough(time)),
                    )
                };
                if age.as_ref().map_or(Ok(true), is_old_enough)? {
                    away(&store, name)?;
                }
            }
            Ok::<_, StoreError>(())
        };
        Ok(self.workers.run("remove raw recordings", give_away).await??)
    }

    /// Removes those of these objects that nothing refers to; returns how many.
    async fn remove_uncommitted(&self, names: Vec<String>) -> Result<usize, ServiceError> {
        let _exclusive = self.exclusive().await;
        let orphans = self.store.orphans_among(names).await?;
        let count = orphans.len();
        let shards: BTreeSet<u8> =
            orphans.iter().filter_map(|name| u8::from_str_radix(name.get(..2)?, 16).ok()).collect();
        self.remove(orphans).await?;
        let store = self.store.clone();
        let remove_notes = move || {
            let objects = store.objects();
            let kept = objects.quarantined()?.into_iter().map(|quarantined| quarantined.name).collect();
            shards.into_iter().try_for_each(|shard| objects.remove_empty_notes(shard, &kept))
        };
        self.workers.run("remove notes", remove_notes).await??;
        Ok(count)
    }
}

/// From which age on objects may go that nothing refers to. What was answered and waits for its results is
/// younger. Ages are by the clock that dates the objects: that of a process may be wrong.
struct Age {
    now: Timestamp,
    /// None where this process has the store to itself and can tell.
    most: Option<SignedDuration>,
}

impl Age {
    fn now(store: &Store) -> Result<Self, StoreError> {
        Ok(Self { now: store.objects().time()?, most: store.orphan_age().filter(|age| !age.is_zero()) })
    }

    fn is_old_enough(&self, written_at: Timestamp) -> bool {
        self.most.is_none_or(|most| self.now.duration_since(written_at) >= most)
    }
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
