//! Folding a channel's records into its wear estimates and run means, in the order of time.
//!
//! The estimate of a record, and NA4 and NB4, are functions of what all records of its channel up to it in time say. States on the way are kept,
//! so that a late record folds only what comes after it, and gets the same bits as if all had come in order.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::libraries::KeyedTracker;
use super::{Ingest, IngestError};
use crate::estimate::{BaselineProgress, TrackerState, WearEstimate, WearStatus};
use crate::signal::{Features, Indicators, RunMeans};
use crate::store::{ChannelSummary, FoldState, RunResult, SEGMENTS_PER_STATE, SegmentKey, StoreError, StoredFeatures};

/// Latest states held in memory: records of connections side by side come in nearly in order.
const RECENT: usize = 16;

/// What is known of a channel after some of its records.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ChannelState {
    tracker: TrackerState,
    run_means: RunMeans,
}

/// What the fold takes of one record.
#[derive(Debug, Clone)]
pub(super) struct FoldInput {
    pub(super) key: SegmentKey,
    /// Features for the wear estimate; empty where they were made in another way than those of the other records.
    pub(super) features: Features,
    /// Indicators that the record gives by itself; empty likewise.
    pub(super) indicators: Indicators,
}

/// The state after one of a channel's records.
#[derive(Debug, Clone)]
pub(super) struct FoldPoint {
    pub(super) last: SegmentKey,
    /// Number of records that went in.
    pub(super) position: u64,
    state: ChannelState,
}

/// The latest states of a channel in memory, the newest last.
#[derive(Debug, Clone, Default)]
pub(super) struct RecentPoints {
    points: VecDeque<FoldPoint>,
}

/// What came of folding some records.
#[derive(Debug)]
pub(super) struct Folded {
    /// One result for each record.
    pub(super) results: Vec<(SegmentKey, RunResult)>,
    /// States to be kept, the newest last.
    pub(super) points: Vec<FoldPoint>,
}

impl FoldInput {
    /// A stored record as input of a fold under a feature key.
    pub(super) fn of(stored: StoredFeatures, feature_key: &str) -> Self {
        if stored.feature_key != feature_key {
            return Self {
                key: stored.key,
                features: Features::default(),
                indicators: Indicators::default(),
            };
        }
        Self {
            key: stored.key,
            features: stored.features,
            indicators: stored.indicators,
        }
    }
}

impl FoldPoint {
    /// From the store.
    pub(super) fn from_stored(stored: FoldState) -> Result<Self, serde_json::Error> {
        Ok(Self {
            state: serde_json::from_str(&stored.state)?,
            last: stored.last,
            position: stored.position,
        })
    }

    /// For the store.
    pub(super) fn to_stored(&self) -> Result<FoldState, IngestError> {
        let state = serde_json::to_string(&self.state).map_err(|source| StoreError::Damaged {
            what: "state",
            of: self.last.id.to_string(),
            source,
        })?;
        Ok(FoldState {
            last: self.last.clone(),
            position: self.position,
            state,
        })
    }
}

impl RecentPoints {
    /// With the newest state only.
    pub(super) fn new(newest: Option<FoldPoint>) -> Self {
        Self {
            points: newest.into_iter().collect(),
        }
    }

    /// The state after the latest record.
    pub(super) fn newest(&self) -> Option<&FoldPoint> {
        self.points.back()
    }

    /// The latest state in which neither `key` nor any later record is.
    pub(super) fn before(&self, key: &SegmentKey) -> Option<&FoldPoint> {
        self.points.iter().rev().find(|point| point.last < *key)
    }

    /// Replaces what comes after position `after`.
    pub(super) fn replace(&mut self, after: u64, points: Vec<FoldPoint>) {
        while self.points.back().is_some_and(|point| point.position > after) {
            self.points.pop_back();
        }
        self.points.extend(points);
        while self.points.len() > RECENT {
            self.points.pop_front();
        }
    }
}

/// Folds records, in the order of time, on from a state or from the start. CPU work: for a worker thread.
fn fold(tracker: &KeyedTracker, from: Option<FoldPoint>, inputs: Vec<FoldInput>) -> Folded {
    let (mut state, mut position) = match from {
        Some(point) => (point.state, point.position),
        None => (
            ChannelState {
                tracker: tracker.tracker.start(),
                run_means: RunMeans::default(),
            },
            0,
        ),
    };
    let last = position + inputs.len() as u64;
    let mut folded = Folded {
        results: Vec::with_capacity(inputs.len()),
        points: Vec::new(),
    };
    for FoldInput { key, features, indicators } in inputs {
        let result = RunResult {
            indicators: state.run_means.update(&indicators),
            wear: tracker.tracker.update(&mut state.tracker, key.start_time, &features),
        };
        position += 1;
        if position.is_multiple_of(SEGMENTS_PER_STATE) || position + RECENT as u64 > last {
            folded.points.push(FoldPoint {
                last: key.clone(),
                position,
                state: state.clone(),
            });
        }
        folded.results.push((key, result));
    }
    folded
}

impl Ingest {
    /// Folds records, in the order of time, on from a state or from the start.
    pub(super) async fn fold_on(
        &self,
        tracker: &KeyedTracker,
        from: Option<FoldPoint>,
        inputs: Vec<FoldInput>,
    ) -> Result<Folded, IngestError> {
        let tracker = tracker.clone();
        self.inner
            .workers
            .run("estimate the wear", move || fold(&tracker, from, inputs))
            .await
    }

    /// The state after a channel's latest record; none before the first one, or where it cannot be read.
    pub(super) async fn newest_point(&self, channel: &ChannelSummary) -> Result<Option<FoldPoint>, IngestError> {
        let stored = self.inner.store.newest_state(channel).await?;
        Ok(stored.and_then(|stored| read_point(channel, stored)))
    }

    /// The latest kept state in which neither `key` nor any later record is.
    pub(super) async fn point_before(&self, channel: &ChannelSummary, key: &SegmentKey) -> Result<Option<FoldPoint>, IngestError> {
        let stored = self.inner.store.state_before(channel, key).await?;
        Ok(stored.and_then(|stored| read_point(channel, stored)))
    }
}

/// A state from the store; one that cannot be read is worth as much as none, since it can be computed again.
pub(super) fn read_point(channel: &ChannelSummary, stored: FoldState) -> Option<FoldPoint> {
    let position = stored.position;
    FoldPoint::from_stored(stored)
        .inspect_err(|error| {
            tracing::warn!(asset = %channel.asset_id, channel = channel.channel, position, %error, "a kept state of the fold cannot be read");
        })
        .ok()
}

/// The estimate of a record that came while the history before it is being computed again.
pub(super) fn while_recomputing(need: u32, method: String) -> RunResult {
    let reason = "the records before this one are being computed again, its wear follows".to_owned();
    let baseline = BaselineProgress { have: 0, need };
    let wear = WearEstimate::without_number(WearStatus::Recomputing, reason, baseline, method);
    RunResult {
        indicators: Indicators::default(),
        wear,
    }
}
