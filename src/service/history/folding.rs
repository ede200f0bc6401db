//! Folding on worker threads, with what the fold begins from.

use std::sync::Arc;

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
}

impl Folding {
    /// Folds records, in the order of time, on from a state or from the start, before records that wait to be
    /// analysed: somebody holds the channel's lock meanwhile.
    pub(crate) async fn fold_first(
        &self,
        keyed: &KeyedEstimator,
        from: Option<FoldPoint>,
        inputs: Vec<FoldInput>,
        timeline: &Arc<Timeline>,
    ) -> Result<Folded, ServiceError> {
        let fold = folding(keyed, from, inputs, timeline);
        self.workers.run_first("estimate the wear", fold).await
    }

    /// The state after a channel's latest record; none before the first one, or where it cannot be read.
    pub(crate) async fn newest_point(
        &self,
        channel: &ChannelSummary,
    ) -> Result<Option<FoldPoint>, ServiceError> {
        let stored = self.store.newest_state(channel).await?;
        Ok(stored.and_then(|stored| read_point(channel, stored)))
    }

    /// The latest kept state in which neither `key` nor any later record is.
    pub(crate) async fn point_before(
        &self,
        channel: &ChannelSummary,
        key: &SegmentKey,
    ) -> Result<Option<FoldPoint>, ServiceError> {
        let stored = self.store.state_before(channel, key).await?;
        Ok(stored.and_then(|stored| read_point(channel, stored)))
    }

    /// What happened between the records of a channel, none before its first one; kept in the slot, whose
    /// lock the caller holds.
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
