//! What happens in the service, for those who follow it live. In a cluster events go from node to node as
//! JSON.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast;

use super::recomputation::Recomputation;
use super::replay::Replay;
use crate::asset::{AssetId, Segment, SegmentId};
use crate::estimate::WearEstimate;
use crate::signal::Indicators;
use crate::store::{AlarmNotice, StoredEvent};

/// Events that one who follows may lag behind.
const MAX_BEHIND: usize = 1024;

/// One thing that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", content = "event", rename_all = "snake_case")]
pub enum LiveEvent {
    /// An asset was made or its description changed.
    AssetChanged(AssetId),
    /// An asset was removed.
    AssetRemoved(AssetId),
    /// The indicators of a record that is stored now.
    Indicators(SegmentPlace, Indicators),
    /// The wear estimate of a record that is stored now, without its posterior.
    Wear(SegmentPlace, Box<WearEstimate>),
    /// The estimates of a channel were computed again.
    HistoryFolded {
        /// The asset.
        asset: AssetId,
        /// The channel.
        channel: String,
    },
    /// A recomputation of a channel's history went on or ended.
    RecomputationChanged(Recomputation),
    /// Something happened to an alarm.
    AlarmChanged(Box<AlarmNotice>),
    /// A maintenance event was added or removed.
    MaintenanceChanged {
        /// The asset.
        asset: AssetId,
        /// The event.
        event: StoredEvent,
        /// It was removed.
        is_removed: bool,
    },
    /// A replay went on or ended.
    ReplayChanged(Box<Replay>),
    /// So many events were lost on their way.
    Lost(u64),
}

/// Which record an event is about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SegmentPlace {
    /// The asset.
    pub asset_id: AssetId,
    /// The channel.
    pub channel: String,
    /// The segment.
    pub segment_id: SegmentId,
    /// The time of its first sample.
    pub start_time: Timestamp,
}

/// An event with its place in what all nodes of a cluster show.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberedEvent {
    /// Rises from event to event.
    pub number: u64,
    /// What happened.
    pub event: LiveEvent,
}

impl LiveEvent {
    /// The asset that it is about; none where it is about all.
    pub fn asset(&self) -> Option<&AssetId> {
        match self {
            Self::AssetChanged(asset) | Self::AssetRemoved(asset) => Some(asset),
            Self::Indicators(place, _) | Self::Wear(place, _) => Some(&place.asset_id),
            Self::HistoryFolded { asset, .. } | Self::MaintenanceChanged { asset, .. } => Some(asset),
            Self::RecomputationChanged(recomputation) => Some(&recomputation.asset),
            Self::AlarmChanged(notice) => Some(&notice.alarm.asset_id),
            Self::ReplayChanged(replay) => Some(&replay.asset),
            Self::Lost(_) => None,
        }
    }
}

/// Announces events to all who follow; a clone is another handle.
#[derive(Debug, Clone)]
pub struct Announcer(broadcast::Sender<LiveEvent>);

impl Default for Announcer {
    fn default() -> Self {
        Self(broadcast::channel(MAX_BEHIND).0)
    }
}

impl Announcer {
    /// Announces an event.
    pub(crate) fn announce(&self, event: LiveEvent) {
        // Nobody may be following.
        let _ = self.0.send(event);
    }

    /// Announces what a record that is stored now says.
    pub(crate) fn announce_segment(&self, segment: &Segment) {
        let place = SegmentPlace {
            asset_id: segment.asset_id.clone(),
            channel: segment.channel.clone(),
            segment_id: segment.id.clone(),
            start_time: segment.start_time,
        };
        let wear = WearEstimate { posterior: None, ..segment.wear.clone() };
        self.announce(LiveEvent::Indicators(place.clone(), segment.indicators.clone()));
        self.announce(LiveEvent::Wear(place, Box::new(wear)));
    }

    /// Announces what happened to alarms.
    pub(crate) fn announce_alarms(&self, notices: Vec<AlarmNotice>) {
        for notice in notices {
            self.announce(LiveEvent::AlarmChanged(Box::new(notice)));
        }
    }

    /// Follows what happens from now on.
    pub fn follow(&self) -> broadcast::Receiver<LiveEvent> {
        self.0.subscribe()
    }
}
