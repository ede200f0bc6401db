//! One lock for each channel, with what only its holder may change.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::OwnedMutexGuard;

use super::fold::RecentPoints;
use super::occurrences::Occurrences;
use crate::asset::AssetId;
use crate::store::{Asset, ChannelSummary};

/// Channels whose states stay in memory; those of others are read again when needed.
const MOST_HELD: usize = 512;

/// What the store held of a channel when something was read of it; where it holds the same, that still is so.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Basis {
    asset: i64,
    /// None before the first record.
    channel: Option<(i64, i64)>,
}

impl Basis {
    pub(super) fn of(asset: &Asset, channel: Option<&ChannelSummary>) -> Self {
        Self {
            asset: asset.version(),
            channel: channel.map(ChannelSummary::version),
        }
    }
}

/// What is held of a channel.
#[derive(Debug, Default)]
pub(super) struct Slot {
    /// The latest states of the fold; none until they are needed.
    pub(super) points: Option<RecentPoints>,
    /// What happened between its records; none until it is needed, or where more has happened since.
    pub(super) occurrences: Option<Arc<Occurrences>>,
    /// What both were read of or made from.
    basis: Option<Basis>,
}

/// The same behind the channel's lock.
type LockedSlot = Arc<tokio::sync::Mutex<Slot>>;

/// The slots of all channels in use.
#[derive(Debug, Default)]
pub(super) struct Channels {
    slots: Mutex<HashMap<(AssetId, String), LockedSlot>>,
}

impl Slot {
    /// Forgets what was not made from this: another process may have changed the channel.
    pub(super) fn rest_on(&mut self, basis: Basis) {
        if self.basis != Some(basis) {
            *self = Self {
                basis: Some(basis),
                ..Self::default()
            };
        }
    }

    /// Says that what is held is what the store holds now.
    pub(super) fn now_of(&mut self, basis: Basis) {
        self.basis = Some(basis);
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
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
