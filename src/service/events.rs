//! Live events of the service, for subscribers. In a cluster they are sent between nodes as JSON.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::sync::{broadcast, mpsc};

use super::recomputation::Recomputation;
use super::replay::Replay;
use crate::asset::{AssetId, Segment, SegmentId};
use crate::estimate::WearEstimate;
use crate::signal::Indicators;
use crate::store::{AlarmNotice, StoredEvent};

/// Maximum number of events by which a subscriber may lag behind.
const MAX_BEHIND: usize = 1024;

/// A live event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", content = "event", rename_all = "snake_case")]
pub enum LiveEvent {
    /// An asset was created or its description changed.
    AssetChanged(AssetId),
    /// An asset was deleted.
    AssetRemoved(AssetId),
    /// The indicators of a newly stored record.
    Indicators(SegmentRef, Indicators),
    /// The wear estimate of a newly stored record, without its posterior.
    Wear(SegmentRef, Box<WearEstimate>),
    /// The estimates of a channel were recomputed.
    HistoryFolded {
        /// The asset.
        asset: AssetId,
        /// The channel.
        channel: String,
    },
    /// A recomputation of a channel's history progressed or ended.
    RecomputationChanged(Recomputation),
    /// An alarm changed.
    AlarmChanged(Box<AlarmNotice>),
    /// A maintenance event was added or removed.
    MaintenanceChanged {
        /// The asset.
        asset: AssetId,
        /// The event.
        event: StoredEvent,
        /// Whether it was removed.
        is_removed: bool,
    },
    /// A replay progressed or ended.
    ReplayChanged(Box<Replay>),
    /// This number of events was lost in transit.
    Lost(u64),
}

/// The record that an event is about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SegmentRef {
    /// The asset.
    pub asset_id: AssetId,
    /// The channel.
    pub channel: String,
    /// The segment.
    pub segment_id: SegmentId,
    /// The time of its first sample.
    pub start_time: Timestamp,
}

/// An event with its sequence number among those of all nodes of a cluster.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberedEvent {
    /// Identifies the sequence of numbers.
    pub run: Arc<str>,
    /// The sequence number, which increases from event to event.
    pub number: u64,
    /// The event.
    pub event: LiveEvent,
}

/// The events of all nodes of a cluster in a common order.
#[derive(Debug)]
pub struct SharedEvents {
    /// Identifies this order in event ids; changes when their stream is created anew.
    pub run: Arc<str>,
    /// Past events.
    pub backlog: Vec<NumberedEvent>,
    /// Future events.
    pub receiver: mpsc::Receiver<NumberedEvent>,
}

impl LiveEvent {
    /// The asset that it is about; `None` if it is about all.
    pub fn asset(&self) -> Option<&AssetId> {
        match self {
            Self::AssetChanged(asset) | Self::AssetRemoved(asset) => Some(asset),
            Self::Indicators(segment, _) | Self::Wear(segment, _) => Some(&segment.asset_id),
            Self::HistoryFolded { asset, .. } | Self::MaintenanceChanged { asset, .. } => Some(asset),
            Self::RecomputationChanged(recomputation) => Some(&recomputation.asset),
            Self::AlarmChanged(notice) => Some(&notice.alarm.asset_id),
            Self::ReplayChanged(replay) => Some(&replay.asset),
            Self::Lost(_) => None,
        }
    }
}

/// Sends events to all subscribers; a clone is another handle.
#[derive(Debug, Clone)]
pub struct EventSender {
    all: broadcast::Sender<LiveEvent>,
    /// Changes of alarms alone, and losses: among the events of many records they would be lost sooner.
    alarms: broadcast::Sender<LiveEvent>,
}

impl Default for EventSender {
    fn default() -> Self {
        Self { all: broadcast::channel(MAX_BEHIND).0, alarms: broadcast::channel(MAX_BEHIND).0 }
    }
}

impl EventSender {
    /// Sends an event.
    pub(crate) fn send(&self, event: LiveEvent) {
        // An error means that there is no subscriber.
        if matches!(event, LiveEvent::AlarmChanged(_) | LiveEvent::Lost(_)) {
            let _ = self.alarms.send(event.clone());
        }
        let _ = self.all.send(event);
    }

    /// Sends the indicators and the wear estimate of a newly stored record.
    pub(crate) fn send_segment(&self, segment: &Segment) {
        let reference = SegmentRef {
            asset_id: segment.asset_id.clone(),
            channel: segment.channel.clone(),
            segment_id: segment.id.clone(),
            start_time: segment.start_time,
        };
        let wear = WearEstimate { posterior: None, ..segment.wear.clone() };
        self.send(LiveEvent::Indicators(reference.clone(), segment.indicators.clone()));
        self.send(LiveEvent::Wear(reference, Box::new(wear)));
    }

    /// Sends changes of alarms.
    pub(crate) fn send_alarms(&self, notices: Vec<AlarmNotice>) {
        for notice in notices {
            self.send(LiveEvent::AlarmChanged(Box::new(notice)));
        }
    }

    /// Subscribes to all events from now on.
    pub fn subscribe(&self) -> broadcast::Receiver<LiveEvent> {
        self.all.subscribe()
    }

    /// Subscribes to changes of alarms from now on, and to [losses](LiveEvent::Lost) of events.
    pub(crate) fn subscribe_to_alarms(&self) -> broadcast::Receiver<LiveEvent> {
        self.alarms.subscribe()
    }
}
