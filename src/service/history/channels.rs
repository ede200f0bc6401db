//! One lock for each channel, with cached data that only its holder may change.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::fold::RecentStates;
use super::timeline::Timeline;
use crate::asset::AssetId;
use crate::store::{Asset, ChannelSummary};

/// Number of channels up to which each keeps its recent states; with more, each keeps its newest state only.
const MAX_WITH_RECENT: usize = 512;

/// Maximum number of cached channels; above it, unused ones are dropped. A state that tracks wear takes about
/// 0.1 MB.
const MAX_CACHED: usize = 4096;

/// The revisions of a channel and its asset in the store. Data read at these revisions is valid as long as
/// the store has the same ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Revisions {
    asset: i64,
    /// `None` before the first record.
    channel: Option<(i64, i64)>,
}

impl Revisions {
    pub(crate) fn of(asset: &Asset, channel: Option<&ChannelSummary>) -> Self {
        Self { asset: asset.version(), channel: channel.map(ChannelSummary::version) }
    }
}

/// The cached data of a channel.
#[derive(Debug, Default)]
pub(crate) struct ChannelCache {
    /// The latest states of the fold; `None` until they are needed.
    pub(crate) states: Option<RecentStates>,
    /// The timeline; `None` until it is needed, or if it is outdated.
    pub(crate) timeline: Option<Arc<Timeline>>,
    /// The unit of the stored records; `None` until it is needed.
    pub(crate) unit: Option<String>,
    /// The revisions at which these were read.
    revisions: Option<Revisions>,
}

/// A cache behind the channel's lock.
type LockedCache = Arc<tokio::sync::Mutex<ChannelCache>>;

/// The caches of all channels in use.
#[derive(Debug, Default)]
pub(crate) struct Channels {
    caches: Mutex<HashMap<(AssetId, String), LockedCache>>,
}

impl ChannelCache {
    /// Clears the cache unless it was read at these revisions: another process may have changed the channel.
    pub(crate) fn validate(&mut self, revisions: Revisions) {
        if self.revisions != Some(revisions) {
            *self = Self { revisions: Some(revisions), ..Self::default() };
        }
    }

    /// Marks the cached data as that of these revisions.
    pub(crate) fn set_revisions(&mut self, revisions: Revisions) {
        self.revisions = Some(revisions);
    }

    /// Clears the cache.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }
}

impl Channels {
    /// The cache of a channel; it is not dropped while it is in use.
    pub(crate) fn cache(&self, asset: &AssetId, channel: &str) -> LockedCache {
        let mut caches = self.caches.lock().unwrap_or_else(PoisonError::into_inner);
        if caches.len() >= MAX_CACHED {
            caches.retain(|_, cache| Arc::strong_count(cache) > 1);
        }
        Arc::clone(caches.entry((asset.clone(), channel.to_string())).or_default())
    }

    /// Whether there are so many channels that each keeps its newest state only.
    pub(crate) fn are_many(&self) -> bool {
        self.caches.lock().unwrap_or_else(PoisonError::into_inner).len() > MAX_WITH_RECENT
    }

    /// Drops the caches of a deleted asset.
    pub(crate) fn forget(&self, asset: &AssetId) {
        let mut caches = self.caches.lock().unwrap_or_else(PoisonError::into_inner);
        caches.retain(|(of, _), _| of != asset);
    }
}
