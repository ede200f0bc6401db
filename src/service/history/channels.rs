//! One lock for each channel, with what only its holder may change.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::OwnedMutexGuard;

use super::fold::RecentPoints;
use super::timeline::Timeline;
use crate::asset::AssetId;
use crate::store::{Asset, ChannelSummary};

/// Channels whose states stay in memory; those of others are read again when needed.
const MAX_CACHED: usize = 512;

/// What the store held of a channel when something was read of it; where it holds the same, that still is so.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Revisions {
    asset: i64,
    /// None before the first record.
    channel: Option<(i64, i64)>,
}

impl Revisions {
    pub(crate) fn of(asset: &Asset, channel: Option<&ChannelSummary>) -> Self {
        Self { asset: asset.version(), channel: channel.map(ChannelSummary::version) }
    }
}

/// What is held of a channel.
#[derive(Debug, Default)]
pub(crate) struct Slot {
    /// The latest states of the fold; none until they are needed.
    pub(crate) points: Option<RecentPoints>,
    /// What happened between its records; none until it is needed, or where more has happened since.
    pub(crate) timeline: Option<Arc<Timeline>>,
    /// What both were read of or made from.
    revisions: Option<Revisions>,
}

/// The same behind the channel's lock.
type LockedSlot = Arc<tokio::sync::Mutex<Slot>>;

/// The slots of all channels in use.
#[derive(Debug, Default)]
pub(crate) struct Channels {
    slots: Mutex<HashMap<(AssetId, String), LockedSlot>>,
}

impl Slot {
    /// Forgets what was not made from this: another process may have changed the channel.
    pub(crate) fn validate(&mut self, revisions: Revisions) {
        if self.revisions != Some(revisions) {
            *self = Self { revisions: Some(revisions), ..Self::default() };
        }
    }

    /// Says that what is held is what the store holds now.
    pub(crate) fn set_revisions(&mut self, revisions: Revisions) {
        self.revisions = Some(revisions);
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }
}

impl Channels {
    /// The slot of a channel; kept in memory as long as it is held.
    pub(crate) fn slot(&self, asset: &AssetId, channel: &str) -> LockedSlot {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        if slots.len() >= MAX_CACHED {
            slots.retain(|_, slot| Arc::strong_count(slot) > 1);
        }
        Arc::clone(slots.entry((asset.clone(), channel.to_string())).or_default())
    }

    /// The right to change a channel.
    pub(crate) async fn lock(&self, asset: &AssetId, channel: &str) -> OwnedMutexGuard<Slot> {
        self.slot(asset, channel).lock_owned().await
    }

    /// Forgets an asset that is gone.
    pub(crate) fn forget(&self, asset: &AssetId) {
        let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
        slots.retain(|(of, _), _| of != asset);
    }
}
