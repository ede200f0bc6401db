//! Folding a channel's records into its wear estimates and run means, in the order of time.
//!
//! The estimate of a record, and NA4 and NB4, are functions of what all records of its channel up to it in
//! time say. States on the way are kept, so that a late record folds only what comes after it, and gets the
//! same bits as if all had come in order.

use std::collections::VecDeque;
use std::sync::Arc;

use super::timeline::{Timeline, TimelineEvent};
use crate::estimate::{AlarmPanel, BaselineProgress, ChannelState, PanelChange, WearEstimate, WearStatus};
use crate::service::error::ServiceError;
use crate::service::simulations::KeyedEstimator;
use crate::signal::{Features, Indicators};
use crate::store::{
    ChannelSummary, FoldState, FoldedAlarms, PlacedChange, RunResult, SEGMENTS_PER_STATE, SegmentKey,
    StoreError, StoredFeatures,
};

/// Latest states held in memory: records of connections side by side come in nearly in order.
const RECENT: usize = 16;

/// What the fold takes of one record.
#[derive(Debug, Clone)]
pub(crate) struct FoldInput {
    pub(crate) key: SegmentKey,
    /// It only has its place.
    pub(crate) excluded: bool,
    /// Features for the wear estimate; empty where they were made in another way than those of the other
    /// records.
    pub(crate) features: Features,
    /// Indicators that the record gives by itself; empty likewise.
    pub(crate) indicators: Indicators,
}

/// The state after one of a channel's records.
#[derive(Debug, Clone)]
pub(crate) struct FoldPoint {
    pub(crate) last: SegmentKey,
    /// Number of records that went in.
    pub(crate) position: u64,
    state: ChannelState,
}

/// The latest states of a channel in memory, the newest last.
#[derive(Debug, Clone, Default)]
pub(crate) struct RecentPoints {
    points: VecDeque<FoldPoint>,
}

/// What came of folding some records.
#[derive(Debug)]
pub(crate) struct Folded {
    /// One result for each record.
    pub(crate) results: Vec<(SegmentKey, RunResult)>,
    /// States to be kept, the newest last.
    pub(crate) points: Vec<FoldPoint>,
    /// What came of the alarms.
    pub(crate) alarms: AlarmRun,
}

/// The alarms of a channel from a place on.
#[derive(Debug)]
pub(crate) struct AlarmRun {
    /// The place: twice the number of records before.
    after: u64,
    changes: Vec<PlacedChange>,
    /// After all records, and after what operators did since the last one.
    panel: AlarmPanel,
}

impl AlarmRun {
    /// Before the first record.
    pub(crate) fn start(keyed: &KeyedEstimator) -> Self {
        Self { after: 0, changes: Vec::new(), panel: keyed.estimator.start().into_alarms() }
    }

    /// Replaces what comes after the place where `next` begins.
    pub(crate) fn go_on(&mut self, next: Self) {
        self.changes.retain(|change| change.place <= next.after);
        self.changes.extend(next.changes);
        self.panel = next.panel;
    }

    /// For the store.
    pub(crate) fn folded<'a>(&'a self, keyed: &'a KeyedEstimator, is_append: bool) -> FoldedAlarms<'a> {
        FoldedAlarms {
            rules: keyed.estimator.rules(),
            panel: &self.panel,
            changes: &self.changes,
            after: self.after,
            is_append,
        }
    }

    /// Whether nothing happened.
    pub(crate) fn is_quiet(&self) -> bool {
        self.changes.is_empty()
    }

    fn add(&mut self, place: u64, changes: Vec<PanelChange>) {
        let placed = changes.into_iter().map(|(rule, change)| PlacedChange { place, rule, change });
        self.changes.extend(placed);
    }
}

impl FoldInput {
    /// A stored record as input of a fold under a feature key.
    pub(crate) fn of(stored: StoredFeatures, feature_key: &str) -> Self {
        if stored.feature_key != feature_key {
            return Self {
                key: stored.key,
                excluded: stored.excluded,
                features: Features::default(),
                indicators: Indicators::default(),
            };
        }
        Self {
            key: stored.key,
            excluded: stored.excluded,
            features: stored.features,
            indicators: stored.indicators,
        }
    }
}

impl FoldPoint {
    /// From the store.
    pub(crate) fn from_stored(stored: FoldState) -> Result<Self, serde_json::Error> {
        Ok(Self { state: serde_json::from_str(&stored.state)?, last: stored.last, position: stored.position })
    }

    /// For the store.
    pub(crate) fn to_stored(&self) -> Result<FoldState, ServiceError> {
        let state = serde_json::to_string(&self.state).map_err(|source| StoreError::Damaged {
            what: "state",
            of: self.last.id.to_string(),
            source,
        })?;
        Ok(FoldState { last: self.last.clone(), position: self.position, state })
    }
}

impl RecentPoints {
    /// With the newest state only.
    pub(crate) fn new(newest: Option<FoldPoint>) -> Self {
        Self { points: newest.into_iter().collect() }
    }

    /// The state after the latest record.
    pub(crate) fn newest(&self) -> Option<&FoldPoint> {
        self.points.back()
    }

    /// The latest state in which neither `key` nor any later record is.
    pub(crate) fn before(&self, key: &SegmentKey) -> Option<&FoldPoint> {
        self.points.iter().rev().find(|point| point.last < *key)
    }

    /// Replaces what comes after position `after`.
    pub(crate) fn replace(&mut self, after: u64, points: Vec<FoldPoint>) {
        while self.points.back().is_some_and(|point| point.position > after) {
            self.points.pop_back();
        }
        self.points.extend(points);
        while self.points.len() > RECENT {
            self.points.pop_front();
        }
    }
}

/// Folding records as a task for a worker thread.
pub(crate) fn folding(
    keyed: &KeyedEstimator,
    from: Option<FoldPoint>,
    inputs: Vec<FoldInput>,
    timeline: &Arc<Timeline>,
) -> impl FnOnce() -> Folded + Send + use<> {
    let (keyed, timeline) = (keyed.clone(), Arc::clone(timeline));
    move || fold(&keyed, from, inputs, &timeline)
}

/// Of the states on the way those that the store keeps, and the newest.
pub(crate) fn states_of(points: &[FoldPoint]) -> Result<Vec<FoldState>, ServiceError> {
    let newest = points.last().map_or(0, |point| point.position);
    points
        .iter()
        .filter(|point| point.position == newest || point.position.is_multiple_of(SEGMENTS_PER_STATE))
        .map(FoldPoint::to_stored)
        .collect()
}

/// Folds records, in the order of time, on from a state or from the start. CPU work: for a worker thread.
fn fold(
    keyed: &KeyedEstimator,
    from: Option<FoldPoint>,
    inputs: Vec<FoldInput>,
    timeline: &Timeline,
) -> Folded {
    let estimator = &keyed.estimator;
    let (mut state, mut position, mut last_time) = match from {
        Some(point) => (point.state, point.position, Some(point.last.start_time)),
        None => (estimator.start(), 0, None),
    };
    let last = position + inputs.len() as u64;
    let mut results = Vec::with_capacity(inputs.len());
    let mut points = Vec::new();
    let mut alarms = AlarmRun { after: 2 * position, ..AlarmRun::start(keyed) };
    for input in inputs {
        let FoldInput { key, features, indicators, .. } = input;
        let start_time = key.start_time;
        for event in timeline.between(last_time, start_time) {
            let changes = match event {
                TimelineEvent::Action(action) => estimator.action(&mut state, action).into_iter().collect(),
                TimelineEvent::Maintenance(event) => estimator.maintenance(&mut state, event),
            };
            alarms.add(2 * position + 1, changes);
        }
        let result = match input.excluded {
            true => estimator.excluded(&state),
            false => estimator.record(&mut state, start_time, &features, &indicators),
        };
        position += 1;
        last_time = Some(start_time);
        alarms.add(2 * position, result.changes);
        if position.is_multiple_of(SEGMENTS_PER_STATE) || position + RECENT as u64 > last {
            points.push(FoldPoint { last: key.clone(), position, state: state.clone() });
        }
        let result = RunResult { indicators: result.indicators, wear: result.wear };
        results.push((key, result));
    }
    // An event counts from the next record on; what operators did to an alarm counts at once.
    for action in timeline.actions_from(last_time) {
        alarms.add(2 * position + 1, estimator.action(&mut state, action).into_iter().collect());
    }
    alarms.panel = state.into_alarms();
    Folded { results, points, alarms }
}

/// A state from the store; one that cannot be read is worth as much as none, since it can be computed again.
pub(crate) fn read_point(channel: &ChannelSummary, stored: FoldState) -> Option<FoldPoint> {
    let position = stored.position;
    FoldPoint::from_stored(stored)
        .inspect_err(|error| {
            tracing::warn!(asset = %channel.asset_id, channel = channel.channel, position, %error, "failed to read a state of the fold");
        })
        .ok()
}

/// The estimate of a record that came while the history before it is being computed again.
pub(crate) fn while_recomputing(need: u32) -> RunResult {
    let reason = "the records before this one are being computed again, its wear follows".to_owned();
    let baseline = BaselineProgress { have: 0, need };
    let wear = WearEstimate::without_number(WearStatus::Recomputing, reason, baseline);
    RunResult { indicators: Indicators::default(), wear }
}
