//! Folding on worker threads, and the states and timelines from which a fold starts.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::channels::{Revisions, Slot};
use super::fold::{FoldInput, FoldPoint, Folded, folding, read_point};
use super::timeline::Timeline;
use crate::service::error::ServiceError;
use crate::service::simulations::KeyedEstimator;
use crate::service::workers::Workers;
use crate::store::{Asset, ChannelSummary, SegmentKey, Store};

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
        from: Option<FoldPoint>,
        inputs: Vec<FoldInput>,
        timeline: &Arc<Timeline>,
    ) -> Result<Folded, ServiceError> {
        let fold = folding(keyed, from, inputs, timeline);
        self.workers.run_first("estimate the wear", fold).await
    }

    /// The state after a channel's latest record; `None` before the first one, or if it cannot be read.
    pub(crate) async fn newest_point(
        &self,
        channel: &ChannelSummary,
    ) -> Result<Option<FoldPoint>, ServiceError> {
        self.states_read.fetch_add(1, Ordering::Relaxed);
        let stored = self.store.newest_state(channel).await?;
        Ok(stored.and_then(|stored| read_point(channel, stored)))
    }

    /// The latest stored state that includes neither `key` nor any later record.
    pub(crate) async fn point_before(
        &self,
        channel: &ChannelSummary,
        key: &SegmentKey,
    ) -> Result<Option<FoldPoint>, ServiceError> {
        self.states_read.fetch_add(1, Ordering::Relaxed);
        let stored = self.store.state_before(channel, key).await?;
        Ok(stored.and_then(|stored| read_point(channel, stored)))
    }

    /// The timeline of a channel, which is `None` before its first record; cached in the slot, whose lock the
    /// caller holds.
    pub(crate) async fn timeline(
        &self,
        asset: &Asset,
        channel: Option<&ChannelSummary>,
        slot: &mut Slot,
    ) -> Result<Arc<Timeline>, ServiceError> {
        slot.validate(Revisions::of(asset, channel));
        if let Some(known) = &slot.timeline {
            return Ok(Arc::clone(known));
        }
        let events = self.store.maintenance(&asset.spec.id).await?;
        let (actions, has_alarms) = match channel {
            Some(channel) => self.store.alarm_actions(channel).await?,
            None => (Vec::new(), false),
        };
        let timeline = Arc::new(Timeline::new(events, actions, has_alarms));
        slot.timeline = Some(Arc::clone(&timeline));
        Ok(timeline)
    }
}
