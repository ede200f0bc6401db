//! The recomputations since the start, as they are shown: the last one of each channel.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use jiff::Timestamp;

use crate::asset::AssetId;
use crate::service::events::{Announcer, LiveEvent};
use crate::service::recomputation::{Recomputation, RecomputationState};
use crate::store::ChannelSummary;

/// Shows and announces how far recomputations are.
#[derive(Debug)]
pub(crate) struct Progress {
    shown: Mutex<BTreeMap<(AssetId, String), Arc<Recomputation>>>,
    events: Announcer,
}

impl Progress {
    pub(crate) fn new(events: Announcer) -> Self {
        Self { shown: Mutex::default(), events }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<(AssetId, String), Arc<Recomputation>>> {
        // Entries are replaced whole, so a panic elsewhere cannot have left half of one.
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The last recomputation of each channel, of one asset or of all.
    pub(crate) fn list(&self, asset: Option<&AssetId>) -> Vec<Arc<Recomputation>> {
        let shown = self.lock();
        let wanted = shown.values().filter(|shown| asset.is_none_or(|asset| shown.asset == *asset));
        wanted.cloned().collect()
    }

    /// Shows that a channel's history is being computed again.
    pub(crate) fn begin(&self, channel: &ChannelSummary, started_at: Timestamp) {
        self.note(Recomputation {
            asset: channel.asset_id.clone(),
            channel: channel.channel.clone(),
            state: RecomputationState::Analysing,
            records_total: channel.segments,
            analysed: 0,
            without_raw: 0,
            folded: 0,
            error: None,
            started_at,
            finished_at: None,
        });
    }

    /// Shows and announces how far that is.
    pub(crate) fn update(&self, asset: &AssetId, channel: &str, change: impl FnOnce(&mut Recomputation)) {
        let mut shown = self.lock();
        if let Some(recomputation) = shown.get_mut(&(asset.clone(), channel.to_owned())) {
            change(Arc::make_mut(recomputation));
            let event = LiveEvent::RecomputationChanged(Recomputation::clone(recomputation));
            drop(shown);
            self.events.announce(event);
        }
    }

    /// Shows a recomputation as it is.
    pub(crate) fn note(&self, recomputation: Recomputation) {
        let key = (recomputation.asset.clone(), recomputation.channel.clone());
        self.lock().insert(key, Arc::new(recomputation));
    }

    /// Forgets the recomputations of an asset that is gone.
    pub(crate) fn forget(&self, asset: &AssetId) {
        self.lock().retain(|(of, _), _| of != asset);
    }
}
