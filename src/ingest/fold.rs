//! Folding records into the wear estimate of their channel, whatever order they come in.
//!
//! The estimate of a record is a function of the features of all records of its channel up to it in time. A record later than
//! all others continues from the stored state; any other makes the fold begin again from the stored features, so that the
//! answer has the same bits as if all had come in order.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::OwnedMutexGuard;

use super::libraries::KeyedTracker;
use super::{Announcement, Ingest, IngestError};
use crate::asset::{AssetId, Segment, SegmentId};
use crate::estimate::{TrackerState, WearEstimate};
use crate::signal::Features;
use crate::store::{ChannelSummary, Commit, FoldState, NewSegment, SegmentKey};

/// Records folded in one piece when a history is folded again: bounds the memory.
const FOLDED_AT_ONCE: u32 = 1024;

/// A channel's fold as it stands in memory; none until it is needed.
type Slot = Option<Fold>;

/// The same behind the channel's lock.
type LockedSlot = Arc<tokio::sync::Mutex<Slot>>;

/// How far a channel has been folded.
#[derive(Debug, Clone)]
pub(super) struct Fold {
    fold_key: String,
    state: TrackerState,
    last: SegmentKey,
}

/// One lock for each (asset, channel), with what only its holder may change.
#[derive(Debug, Default)]
pub(super) struct Channels {
    slots: Mutex<HashMap<(AssetId, String), LockedSlot>>,
}

impl Channels {
    async fn lock(&self, asset: &AssetId, channel: &str) -> OwnedMutexGuard<Slot> {
        let slot = {
            let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(slots.entry((asset.clone(), channel.to_string())).or_default())
        };
        slot.lock_owned().await
    }

    /// Forgets an asset that is gone.
    pub(super) fn forget(&self, asset: &AssetId) {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        slots.retain(|(of, _), _| of != asset);
    }
}

/// A segment as it is after storing.
#[derive(Debug)]
pub(super) struct Stored {
    pub(super) segment: Segment,
    /// It was there before.
    pub(super) repeated: bool,
}

impl Ingest {
    /// Folds and stores segments of one asset in one transaction, and announces them. The answer is in the order given.
    pub(super) async fn store_segments(&self, asset: &AssetId, segments: Vec<NewSegment>) -> Result<Vec<Stored>, IngestError> {
        let order: Vec<SegmentId> = segments.iter().map(|segment| segment.id.clone()).collect();
        let mut by_channel: BTreeMap<String, BTreeMap<SegmentKey, NewSegment>> = BTreeMap::new();
        for segment in segments {
            by_channel
                .entry(segment.channel.clone())
                .or_default()
                .insert(segment.key(), segment);
        }
        let mut locked = Vec::with_capacity(by_channel.len());
        // In the order of names, so that two batches never wait for each other.
        for (channel, new) in by_channel {
            let slot = self.inner.channels.lock(asset, &channel).await;
            locked.push((channel, new, slot));
        }
        // Read under the locks: a description that changes later folds the history again behind us.
        let spec = self.inner.store.asset(asset).await?.spec;
        let tracker = self.inner.libraries.tracker(&spec).await?;
        let repeats = self.inner.store.segments_by_id(&order).await?;
        for segment in &repeats {
            for (_, new, _) in &mut locked {
                new.retain(|key, _| key.id != segment.id);
            }
        }
        let mut done: HashMap<SegmentId, Stored> = repeats
            .into_iter()
            .map(|segment| {
                let stored = Stored { segment, repeated: true };
                (stored.segment.id.clone(), stored)
            })
            .collect();
        locked.retain(|(_, new, _)| !new.is_empty());
        if !locked.is_empty() {
            for stored in self.fold_locked(asset, &tracker, &mut locked).await? {
                self.announce(Announcement::SegmentStored(Arc::new(stored.clone())));
                let id = stored.id.clone();
                done.insert(
                    id,
                    Stored {
                        segment: stored,
                        repeated: false,
                    },
                );
            }
        }
        drop(locked);
        // The same record twice in one batch is stored once and answered once.
        Ok(order.iter().filter_map(|id| done.remove(id)).collect())
    }

    async fn fold_locked(
        &self,
        asset: &AssetId,
        tracker: &KeyedTracker,
        locked: &mut [(String, BTreeMap<SegmentKey, NewSegment>, OwnedMutexGuard<Slot>)],
    ) -> Result<Vec<Segment>, IngestError> {
        // What continues from a known state is computed before the transaction, which others wait for.
        let mut continued = Vec::with_capacity(locked.len());
        for (channel, new, slot) in locked.iter_mut() {
            if slot.is_none() {
                **slot = self.load_fold(asset, channel).await?;
            }
            let fits = |fold: &Fold| fold.fold_key == tracker.fold_key && new.keys().next().is_some_and(|first| fold.last < *first);
            continued.push(match &**slot {
                Some(fold) if fits(fold) => {
                    let features = new.iter().map(|(key, segment)| (key.clone(), segment.features.clone())).collect();
                    Some(self.fold_on(tracker, Some(fold.clone()), features).await?)
                }
                _ => None,
            });
        }
        let mut commit = self.inner.store.begin().await?;
        let mut answer = Vec::new();
        let mut folds = Vec::with_capacity(locked.len());
        for ((name, new, _), continued) in locked.iter_mut().zip(continued) {
            let mut channel = commit.channel(asset, name).await?;
            for segment in new.values() {
                commit.insert(&mut channel, segment).await?;
            }
            let rewritten = continued.is_none();
            let (fold, mut wears) = match continued {
                Some((fold, wears)) => {
                    for (key, wear) in &wears {
                        commit.set_wear(&key.id, wear).await?;
                    }
                    (fold, wears.into_iter().collect())
                }
                None => self.fold_again(&mut commit, &channel, tracker, |key| new.contains_key(key)).await?,
            };
            commit.set_fold(&channel, &fold.to_stored()?, rewritten).await?;
            for (key, segment) in std::mem::take(new) {
                let wear: Option<WearEstimate> = wears.remove(&key);
                answer.push(segment.with_wear(wear.ok_or(IngestError::WorkerLost("estimate the wear"))?));
            }
            folds.push(fold);
        }
        commit.finish().await?;
        for ((_, _, slot), fold) in locked.iter_mut().zip(folds) {
            **slot = Some(fold);
        }
        Ok(answer)
    }

    /// Folds a channel again where its estimates stand under another key than the asset's present one.
    pub(super) async fn refold(&self, asset: &AssetId, channel: &str) -> Result<(), IngestError> {
        let mut slot = self.inner.channels.lock(asset, channel).await;
        let spec = self.inner.store.asset(asset).await?.spec;
        let tracker = self.inner.libraries.tracker(&spec).await?;
        if slot.is_none() {
            *slot = self.load_fold(asset, channel).await?;
        }
        if slot.as_ref().is_some_and(|fold| fold.fold_key == tracker.fold_key) {
            return Ok(());
        }
        let mut commit = self.inner.store.begin().await?;
        let summary = commit.channel(asset, channel).await?;
        if summary.segments == 0 {
            return Ok(());
        }
        let (fold, _) = self.fold_again(&mut commit, &summary, &tracker, |_| false).await?;
        commit.set_fold(&summary, &fold.to_stored()?, true).await?;
        commit.finish().await?;
        *slot = Some(fold);
        tracing::info!(%asset, channel, segments = summary.segments, "wear history folded again");
        self.announce(Announcement::HistoryFolded {
            asset: asset.clone(),
            channel: channel.to_string(),
        });
        Ok(())
    }

    /// Folds all features of a channel from the first one on and stores every estimate; returns those that `wanted` picks.
    async fn fold_again(
        &self,
        commit: &mut Commit,
        channel: &ChannelSummary,
        tracker: &KeyedTracker,
        wanted: impl Fn(&SegmentKey) -> bool,
    ) -> Result<(Fold, HashMap<SegmentKey, WearEstimate>), IngestError> {
        let mut picked = HashMap::new();
        let mut fold: Option<Fold> = None;
        loop {
            let features = commit
                .features(channel, fold.as_ref().map(|fold| &fold.last), FOLDED_AT_ONCE)
                .await?;
            if features.is_empty() {
                break;
            }
            let (next, wears) = self.fold_on(tracker, fold.take(), features).await?;
            fold = Some(next);
            for (key, wear) in wears {
                commit.set_wear(&key.id, &wear).await?;
                if wanted(&key) {
                    picked.insert(key, wear);
                }
            }
        }
        Ok((fold.ok_or(IngestError::WorkerLost("fold a history"))?, picked))
    }

    /// Folds records on from a state, or from the start, on a worker thread.
    async fn fold_on(
        &self,
        tracker: &KeyedTracker,
        from: Option<Fold>,
        features: Vec<(SegmentKey, Features)>,
    ) -> Result<(Fold, Vec<(SegmentKey, WearEstimate)>), IngestError> {
        let KeyedTracker { tracker, fold_key } = tracker.clone();
        let folded = self.inner.workers.run("estimate the wear", move || {
            let mut state = from.map_or_else(|| tracker.start(), |fold| fold.state);
            let wears: Vec<(SegmentKey, WearEstimate)> = features
                .into_iter()
                .map(|(key, features)| {
                    let wear = tracker.update(&mut state, &features);
                    (key, wear)
                })
                .collect();
            let last = wears.last().map(|(key, _)| key.clone())?;
            Some((Fold { fold_key, state, last }, wears))
        });
        folded.await?.ok_or(IngestError::WorkerLost("fold no records"))
    }

    async fn load_fold(&self, asset: &AssetId, channel: &str) -> Result<Option<Fold>, IngestError> {
        let stored = self.inner.store.fold_state(asset, channel).await?;
        Ok(stored.and_then(|stored| match serde_json::from_str(&stored.state) {
            Ok(state) => Some(Fold {
                fold_key: stored.fold_key,
                state,
                last: stored.last,
            }),
            Err(error) => {
                tracing::warn!(%asset, channel, %error, "stored state of the fold cannot be read, the history is folded again");
                None
            }
        }))
    }
}

impl Fold {
    fn to_stored(&self) -> Result<FoldState, IngestError> {
        let state = serde_json::to_string(&self.state).map_err(|source| crate::store::StoreError::Damaged {
            what: "state",
            of: self.last.id.to_string(),
            source,
        })?;
        Ok(FoldState {
            fold_key: self.fold_key.clone(),
            state,
            last: self.last.clone(),
        })
    }
}
