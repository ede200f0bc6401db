//! Folding a channel's records into its wear estimates and run means, in the order of time.
//!
//! The estimate of a record, and NA4 and NB4, are functions of what all records of its channel up to it in time say. States on the way are kept,
//! so that a late record folds only what comes after it, and gets the same bits as if all had come in order.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::libraries::KeyedTracker;
use super::occurrences::{Occurrence, Occurrences};
use super::{Ingest, IngestError};
use crate::estimate::{AlarmPanel, BaselineProgress, PanelChange, TrackerState, WearEstimate, WearStatus};
use crate::signal::{Features, Indicators, RunMeans};
use crate::store::{
    ChannelSummary, FoldState, FoldedAlarms, PlacedChange, RunResult, SEGMENTS_PER_STATE, SegmentKey, StoreError, StoredFeatures,
};

/// Latest states held in memory: records of connections side by side come in nearly in order.
const RECENT: usize = 16;

/// What is known of a channel after some of its records.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct ChannelState {
    tracker: TrackerState,
    run_means: RunMeans,
    alarms: AlarmPanel,
}

impl ChannelState {
    fn start(tracker: &KeyedTracker) -> Self {
        Self {
            tracker: tracker.tracker.start(),
            run_means: RunMeans::default(),
            alarms: AlarmPanel::of(&tracker.rules),
        }
    }

    /// Takes what happened between two records.
    fn pass(&mut self, tracker: &KeyedTracker, occurrence: &Occurrence) -> Vec<PanelChange> {
        match occurrence {
            Occurrence::Action(action) => self.alarms.act(&tracker.rules, action).into_iter().collect(),
            Occurrence::Maintenance(event) => {
                tracker.tracker.event(&mut self.tracker, event);
                // Means over the run of another gear or sensor are nothing to compare with.
                self.run_means = RunMeans::default();
                self.alarms.maintenance(&tracker.rules, event)
            }
        }
    }

    fn take(&mut self, tracker: &KeyedTracker, input: &FoldInput) -> (RunResult, Vec<PanelChange>) {
        let FoldInput { key, features, indicators } = input;
        let wear = tracker.tracker.update(&mut self.tracker, key.start_time, features);
        let mut of_run = self.run_means.update(indicators);
        of_run.extend(wear.indicators());
        let result = RunResult { indicators: of_run, wear };
        let indicators = [indicators, &result.indicators];
        let changes = self.alarms.reading(&tracker.rules, key.start_time, &result.wear, indicators);
        (result, changes)
    }
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
    /// What came of the alarms.
    pub(super) alarms: AlarmRun,
}

/// The alarms of a channel from a place on.
#[derive(Debug)]
pub(super) struct AlarmRun {
    /// The place: twice the number of records before.
    after: u64,
    changes: Vec<PlacedChange>,
    /// After all records, and after what people did since the last one.
    panel: AlarmPanel,
}

impl AlarmRun {
    /// Before the first record.
    pub(super) fn start(tracker: &KeyedTracker) -> Self {
        Self {
            after: 0,
            changes: Vec::new(),
            panel: AlarmPanel::of(&tracker.rules),
        }
    }

    /// Replaces what comes after the place where `next` begins.
    pub(super) fn go_on(&mut self, next: Self) {
        self.changes.retain(|change| change.place <= next.after);
        self.changes.extend(next.changes);
        self.panel = next.panel;
    }

    /// For the store.
    pub(super) fn folded<'a>(&'a self, tracker: &'a KeyedTracker, is_append: bool) -> FoldedAlarms<'a> {
        FoldedAlarms {
            rules: &tracker.rules,
            panel: &self.panel,
            changes: &self.changes,
            after: self.after,
            is_append,
        }
    }

    /// Whether nothing happened.
    pub(super) fn is_quiet(&self) -> bool {
        self.changes.is_empty()
    }

    fn add(&mut self, place: u64, changes: Vec<PanelChange>) {
        let placed = changes.into_iter().map(|(rule, change)| PlacedChange { place, rule, change });
        self.changes.extend(placed);
    }
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

/// Folding records as a task for a worker thread.
pub(super) fn folding(
    tracker: &KeyedTracker,
    from: Option<FoldPoint>,
    inputs: Vec<FoldInput>,
    occurrences: &Arc<Occurrences>,
) -> impl FnOnce() -> Folded + Send + use<> {
    let (tracker, occurrences) = (tracker.clone(), Arc::clone(occurrences));
    move || fold(&tracker, from, inputs, &occurrences)
}

/// Of the states on the way those that the store keeps, and the newest.
pub(super) fn states_of(points: &[FoldPoint]) -> Result<Vec<FoldState>, IngestError> {
    let newest = points.last().map_or(0, |point| point.position);
    points
        .iter()
        .filter(|point| point.position == newest || point.position.is_multiple_of(SEGMENTS_PER_STATE))
        .map(FoldPoint::to_stored)
        .collect()
}

/// Folds records, in the order of time, on from a state or from the start. CPU work: for a worker thread.
fn fold(tracker: &KeyedTracker, from: Option<FoldPoint>, inputs: Vec<FoldInput>, occurrences: &Occurrences) -> Folded {
    let (mut state, mut position, mut last_time) = match from {
        Some(point) => (point.state, point.position, Some(point.last.start_time)),
        None => (ChannelState::start(tracker), 0, None),
    };
    let last = position + inputs.len() as u64;
    let mut results = Vec::with_capacity(inputs.len());
    let mut points = Vec::new();
    let mut alarms = AlarmRun {
        after: 2 * position,
        ..AlarmRun::start(tracker)
    };
    for input in inputs {
        let start_time = input.key.start_time;
        for occurrence in occurrences.between(last_time, start_time) {
            alarms.add(2 * position + 1, state.pass(tracker, occurrence));
        }
        let (result, changes) = state.take(tracker, &input);
        position += 1;
        last_time = Some(start_time);
        alarms.add(2 * position, changes);
        if position.is_multiple_of(SEGMENTS_PER_STATE) || position + RECENT as u64 > last {
            points.push(FoldPoint {
                last: input.key.clone(),
                position,
                state: state.clone(),
            });
        }
        results.push((input.key, result));
    }
    // An event counts from the next record on; what people did to an alarm counts at once.
    for action in occurrences.actions_from(last_time) {
        alarms.add(2 * position + 1, state.alarms.act(&tracker.rules, action).into_iter().collect());
    }
    alarms.panel = state.alarms;
    Folded { results, points, alarms }
}

impl Ingest {
    /// Folds records, in the order of time, on from a state or from the start, before records that wait to be analysed: somebody holds the
    /// channel's lock meanwhile.
    pub(super) async fn fold_on(
        &self,
        tracker: &KeyedTracker,
        from: Option<FoldPoint>,
        inputs: Vec<FoldInput>,
        occurrences: &Arc<Occurrences>,
    ) -> Result<Folded, IngestError> {
        let fold = folding(tracker, from, inputs, occurrences);
        self.inner.workers.run_first("estimate the wear", fold).await
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
