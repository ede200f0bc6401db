//! The progress of recomputations: the last one of each channel since the start.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use jiff::Timestamp;

use crate::asset::AssetId;
use crate::service::events::{EventSender, LiveEvent};
use crate::service::recomputation::{Recomputation, RecomputationState};
use crate::store::ChannelSummary;

/// Lists the progress of recomputations and sends its changes as events.
#[derive(Debug)]
pub(crate) struct Progress {
    shown: Mutex<BTreeMap<(AssetId, String), Arc<Recomputation>>>,
    events: EventSender,
}

impl Progress {
    pub(crate) fn new(events: EventSender) -> Self {
        Self { shown: Mutex::default(), events }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<(AssetId, String), Arc<Recomputation>>> {
        // Entries are replaced as a whole, so a panic elsewhere cannot leave a partial one.
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The last recomputation of each channel, of one asset or of all assets.
    pub(crate) fn list(&self, asset: Option<&AssetId>) -> Vec<Arc<Recomputation>> {
        let shown = self.lock();
        let wanted = shown.values().filter(|shown| asset.is_none_or(|asset| shown.asset == *asset));
        wanted.cloned().collect()
    }

    /// Lists a channel's recomputation as started.
    pub(crate) fn begin(&self, channel: &ChannelSummary, started_at: Timestamp) {
        self.insert(Recomputation {
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

    /// Changes a listed recomputation and sends the event.
    pub(crate) fn update(&self, asset: &AssetId, channel: &str, change: impl FnOnce(&mut Recomputation)) {
        let mut shown = self.lock();
        if let Some(recomputation) = shown.get_mut(&(asset.clone(), channel.to_owned())) {
            change(Arc::make_mut(recomputation));
            let event = LiveEvent::RecomputationChanged(Recomputation::clone(recomputation));
            drop(shown);
            self.events.send(event);
        }
    }

    /// Lists a recomputation in place of the previous one of its channel.
    pub(crate) fn insert(&self, recomputation: Recomputation) {
        let key = (recomputation.asset.clone(), recomputation.channel.clone());
        self.lock().insert(key, Arc::new(recomputation));
    }

    /// Forgets the recomputation of a channel, which another process continues or which starts again.
    pub(crate) fn forget_channel(&self, asset: &AssetId, channel: &str) {
        self.lock().remove(&(asset.clone(), channel.to_owned()));
    }

    /// Forgets the recomputations of a deleted asset.
    pub(crate) fn forget(&self, asset: &AssetId) {
        self.lock().retain(|(of, _), _| of != asset);
    }
}
