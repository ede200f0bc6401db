//! One lock for each channel, with what only its holder may change.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::OwnedMutexGuard;

use super::fold::RecentPoints;
use super::occurrences::Occurrences;
use crate::asset::AssetId;
use crate::store::SegmentKey;

/// Channels whose states stay in memory; those of others are read again when needed.
const MOST_HELD: usize = 512;

/// What is held of a channel.
#[derive(Debug, Default)]
pub(super) struct Slot {
    /// The latest states of the fold; none until they are needed.
    pub(super) points: Option<RecentPoints>,
    /// The earliest record stored since a recomputation of the channel began.
    pub(super) earliest_new: Option<SegmentKey>,
    /// What happened between its records; none until it is needed, or where more has happened since.
    pub(super) occurrences: Option<Arc<Occurrences>>,
}

/// The same behind the channel's lock.
type LockedSlot = Arc<tokio::sync::Mutex<Slot>>;

/// The slots of all channels in use.
#[derive(Debug, Default)]
pub(super) struct Channels {
    slots: Mutex<HashMap<(AssetId, String), LockedSlot>>,
}

impl Slot {
    /// Notes a record, or the place of something between records, that a recomputation under way may have passed already.
    pub(super) fn note_new(&mut self, key: &SegmentKey) {
        if self.earliest_new.as_ref().is_none_or(|earliest| key < earliest) {
            self.earliest_new = Some(key.clone());
        }
    }
}

impl Channels {
    /// The slot of a channel; kept in memory as long as it is held.
    pub(super) fn slot(&self, asset: &AssetId, channel: &str) -> LockedSlot {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        if slots.len() >= MOST_HELD {
            slots.retain(|_, slot| Arc::strong_count(slot) > 1);
        }
        Arc::clone(slots.entry((asset.clone(), channel.to_string())).or_default())
    }

    /// The right to change a channel.
    pub(super) async fn lock(&self, asset: &AssetId, channel: &str) -> OwnedMutexGuard<Slot> {
        self.slot(asset, channel).lock_owned().await
    }

    /// Forgets an asset that is gone.
    pub(super) fn forget(&self, asset: &AssetId) {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        slots.retain(|(of, _), _| of != asset);
    }
}
