//! Folding on worker threads, and the states and timelines from which a fold starts.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::channels::{ChannelCache, Revisions};
use super::fold::{FoldInput, FoldState, Folded, RecentStates, folding, read_state};
use super::timeline::Timeline;
use crate::service::error::ServiceError;
use crate::service::simulations::KeyedEstimator;
use crate::service::workers::Workers;
use crate::store::{Asset, ChannelSummary, SegmentKey, Store};

/// Maximum number of records after the latest stored state that are folded again while their channel is
/// locked.
const MAX_FOLDED_AGAIN: u32 = 128;

/// Folds records of a store on worker threads.
#[derive(Clone)]
pub(crate) struct Folding {
    pub(crate) store: Store,
    pub(crate) workers: Arc<Workers>,
    /// Number of states read from the store.
    pub(crate) states_read: Arc<AtomicU64>,
}

impl Folding {
    /// Folds records, in the order of time, from a state or from the start. Takes priority over records
    /// waiting for their analysis, because the caller holds the channel's lock.
    pub(crate) async fn fold_with_priority(
        &self,
        keyed: &KeyedEstimator,
        from: Option<FoldState>,
        inputs: Vec<FoldInput>,
        timeline: &Arc<Timeline>,
    ) -> Result<Folded, ServiceError> {
        let fold = folding(keyed, from, inputs, timeline);
        self.workers.run_first("estimate the wear", fold).await
    }

    /// The states after a channel's latest records: those after the latest stored state are folded again.
    /// Empty if that state cannot be read, or if too many records follow it.
    pub(crate) async fn recent_states(
        &self,
        keyed: &KeyedEstimator,
        channel: &ChannelSummary,
        timeline: &Arc<Timeline>,
    ) -> Result<RecentStates, ServiceError> {
        self.states_read.fetch_add(1, Ordering::Relaxed);
        let from = match self.store.newest_state(channel).await? {
            None => None,
            Some(stored) => match read_state(channel, stored) {
                None => return Ok(RecentStates::default()),
                Some(state) => Some(state),
            },
        };
        let after = from.as_ref().map(|state| &state.last);
        let stored = self.store.features(channel, channel.served_analyses(), after, MAX_FOLDED_AGAIN).await?;
        if stored.len() as u64 >= u64::from(MAX_FOLDED_AGAIN) {
            return Ok(RecentStates::default());
        }
        let mut recent = RecentStates::new(from.clone());
        if !stored.is_empty() {
            let inputs = stored.into_iter().map(|stored| FoldInput::of(stored, &keyed.feature_key)).collect();
            let after = from.as_ref().map_or(0, |state| state.position);
            recent.replace(after, self.fold_with_priority(keyed, from, inputs, timeline).await?.states);
        }
        Ok(recent)
    }

    /// The latest stored state that includes neither `key` nor any later record.
    pub(crate) async fn state_before(
        &self,
        channel: &ChannelSummary,
        key: &SegmentKey,
    ) -> Result<Option<FoldState>, ServiceError> {
        self.states_read.fetch_add(1, Ordering::Relaxed);
        let stored = self.store.state_before(channel, channel.served_wear(), key).await?;
        Ok(stored.and_then(|stored| read_state(channel, stored)))
    }

    /// The timeline of a channel, which is `None` before its first record; kept in the cache, whose lock the
    /// caller holds.
    pub(crate) async fn timeline(
        &self,
        asset: &Asset,
        channel: Option<&ChannelSummary>,
        cache: &mut ChannelCache,
    ) -> Result<Arc<Timeline>, ServiceError> {
        cache.validate(Revisions::of(asset, channel));
        if let Some(known) = &cache.timeline {
            return Ok(Arc::clone(known));
        }
        let events = self.store.maintenance(&asset.spec.id).await?;
        let (actions, has_alarms) = match channel {
            Some(channel) => self.store.alarm_actions(channel).await?,
            None => (Vec::new(), false),
        };
        let timeline = Arc::new(Timeline::new(events, actions, has_alarms));
        cache.timeline = Some(Arc::clone(&timeline));
        Ok(timeline)
    }
}
