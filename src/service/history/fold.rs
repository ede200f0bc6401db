//! Folding a channel's records into its wear estimates and run means, in the order of time.
//!
//! The estimate of a record, and NA4 and NB4, are functions of all records of its channel up to its time.
//! Intermediate states are stored, so that a late record refolds only the records after it, and gives the
//! same bits as if all records had arrived in order.

use std::collections::VecDeque;
use std::sync::Arc;

use super::timeline::{Timeline, TimelineEvent};
use crate::estimate::{AlarmPanel, BaselineProgress, ChannelState, PanelChange, WearEstimate, WearStatus};
use crate::service::error::ServiceError;
use crate::service::simulations::KeyedEstimator;
use crate::signal::{Features, Indicators};
use crate::store::{
    ChannelSummary, FoldedAlarms, PlacedChange, RECORDS_PER_STATE, RunResult, SegmentKey, StoreError,
    StoredFeatures, StoredFoldState, is_stored,
};

/// Records whose states are held in memory: records of parallel connections arrive nearly in order. A state
/// to be stored is among them.
const RECENT: u64 = RECORDS_PER_STATE;

/// The states of this many newest records are all held, before them that of each `DENSE`th record.
const DENSE: u64 = 4;

/// The input of the fold for one record.
#[derive(Debug, Clone)]
pub(crate) struct FoldInput {
    pub(crate) key: SegmentKey,
    /// Whether it takes no part in the fold and only keeps its place.
    pub(crate) excluded: bool,
    /// Features for the wear estimate; empty if they were computed in another way than those of the other
    /// records.
    pub(crate) features: Features,
    /// Indicators of the record alone; empty in the same case.
    pub(crate) indicators: Indicators,
}

/// The state after one of a channel's records.
#[derive(Debug, Clone)]
pub(crate) struct FoldState {
    pub(crate) last: SegmentKey,
    /// Number of records folded.
    pub(crate) position: u64,
    state: ChannelState,
}

/// The latest states of a channel in memory, the newest last.
#[derive(Debug, Clone, Default)]
pub(crate) struct RecentStates {
    states: VecDeque<FoldState>,
}

/// The result of folding some records.
#[derive(Debug)]
pub(crate) struct Folded {
    /// One result for each record.
    pub(crate) results: Vec<(SegmentKey, RunResult)>,
    /// States to be stored, the newest last.
    pub(crate) states: Vec<FoldState>,
    /// The changes of the alarms.
    pub(crate) alarms: AlarmRun,
}

/// The alarm changes of a channel after a place.
#[derive(Debug)]
pub(crate) struct AlarmRun {
    /// The place: twice the number of records before it.
    after: u64,
    changes: Vec<PlacedChange>,
    /// The alarms after all records and all operator actions.
    panel: AlarmPanel,
}

impl AlarmRun {
    /// The alarms before the first record.
    pub(crate) fn start(keyed: &KeyedEstimator) -> Self {
        Self { after: 0, changes: Vec::new(), panel: keyed.estimator.start().into_alarms() }
    }

    /// Replaces the changes after the place at which `next` starts.
    pub(crate) fn splice(&mut self, next: Self) {
        self.changes.retain(|change| change.place <= next.after);
        self.changes.extend(next.changes);
        self.panel = next.panel;
    }

    /// Returns the alarms in the form that the store takes.
    pub(crate) fn folded<'a>(&'a self, keyed: &'a KeyedEstimator, is_append: bool) -> FoldedAlarms<'a> {
        FoldedAlarms {
            rules: keyed.estimator.rules(),
            panel: &self.panel,
            changes: &self.changes,
            after: self.after,
            is_append,
        }
    }

    /// Whether there are no changes.
    pub(crate) fn is_empty(&self) -> bool {
        self.changes.is_empty()
    }

    fn add(&mut self, place: u64, changes: Vec<PanelChange>) {
        let placed = changes.into_iter().map(|(rule, change)| PlacedChange { place, rule, change });
        self.changes.extend(placed);
    }
}

impl FoldInput {
    /// Converts a stored record to the input of a fold under a feature key.
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

impl FoldState {
    /// Decodes a stored state.
    pub(crate) fn from_stored(stored: StoredFoldState) -> Result<Self, serde_json::Error> {
        Ok(Self { state: serde_json::from_str(&stored.state)?, last: stored.last, position: stored.position })
    }

    /// Encodes the state for the store.
    pub(crate) fn to_stored(&self) -> Result<StoredFoldState, ServiceError> {
        let state =
            serde_json::to_string(&self.state).map_err(StoreError::damaged("state", &self.last.id))?;
        Ok(StoredFoldState { last: self.last.clone(), position: self.position, state })
    }
}

impl RecentStates {
    /// Creates a list of the newest state only.
    pub(crate) fn new(newest: Option<FoldState>) -> Self {
        Self { states: newest.into_iter().collect() }
    }

    /// The state after the latest record.
    pub(crate) fn newest(&self) -> Option<&FoldState> {
        self.states.back()
    }

    /// The latest state that includes neither `key` nor any later record.
    pub(crate) fn before(&self, key: &SegmentKey) -> Option<&FoldState> {
        self.states.iter().rev().find(|state| state.last < *key)
    }

    /// Drops all states but the newest.
    pub(crate) fn keep_newest(&mut self) {
        self.states.drain(..self.states.len().saturating_sub(1));
    }

    /// Replaces the states after position `after`.
    pub(crate) fn replace(&mut self, after: u64, states: Vec<FoldState>) {
        while self.states.back().is_some_and(|state| state.position > after) {
            self.states.pop_back();
        }
        self.states.extend(states);
        let newest = self.states.back().map_or(0, |state| state.position);
        self.states.retain(|state| {
            let age = newest - state.position;
            age < DENSE || age < RECENT && state.position.is_multiple_of(DENSE)
        });
    }
}

/// Returns the folding of records as a task for a worker thread.
pub(crate) fn folding(
    keyed: &KeyedEstimator,
    from: Option<FoldState>,
    inputs: Vec<FoldInput>,
    timeline: &Arc<Timeline>,
) -> impl FnOnce() -> Folded + Send + use<> {
    let (keyed, timeline) = (keyed.clone(), Arc::clone(timeline));
    move || fold(&keyed, from, inputs, &timeline)
}

/// Selects the states to be stored.
pub(crate) fn states_to_store(states: &[FoldState]) -> Result<Vec<StoredFoldState>, ServiceError> {
    let newest = states.last().map_or(0, |state| newest_stored(state.position));
    let stored = states.iter().filter(|state| state.position <= newest && is_stored(state.position, newest));
    stored.map(FoldState::to_stored).collect()
}

/// Position of the newest stored state of so many records.
fn newest_stored(records: u64) -> u64 {
    records - records % RECORDS_PER_STATE
}

/// Folds records, in the order of time, from a state or from the start. CPU-bound: for a worker thread.
fn fold(
    keyed: &KeyedEstimator,
    from: Option<FoldState>,
    inputs: Vec<FoldInput>,
    timeline: &Timeline,
) -> Folded {
    let estimator = &keyed.estimator;
    let (mut state, mut position, mut last_time) = match from {
        Some(from) => (from.state, from.position, Some(from.last.start_time)),
        None => (estimator.start(), 0, None),
    };
    let last = position + inputs.len() as u64;
    let mut results = Vec::with_capacity(inputs.len());
    let mut states = Vec::new();
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
        if is_stored(position, newest_stored(last)) || position + RECENT > last {
            states.push(FoldState { last: key.clone(), position, state: state.clone() });
        }
        let result = RunResult { indicators: result.indicators, wear: result.wear };
        results.push((key, result));
    }
    // An event takes effect with the next record; an operator action takes effect at once.
    for action in timeline.actions_from(last_time) {
        alarms.add(2 * position + 1, estimator.action(&mut state, action).into_iter().collect());
    }
    alarms.panel = state.into_alarms();
    Folded { results, states, alarms }
}

/// Decodes a stored state; returns `None` if it cannot be decoded, because it can be recomputed.
pub(crate) fn read_state(channel: &ChannelSummary, stored: StoredFoldState) -> Option<FoldState> {
    let position = stored.position;
    FoldState::from_stored(stored)
        .inspect_err(|error| {
            tracing::warn!(asset = %channel.asset_id, channel = channel.channel, position, %error, "failed to read a stored fold state");
        })
        .ok()
}

/// The estimate of a record that arrives while the history before it is being recomputed.
pub(crate) fn while_recomputing(need: u32) -> RunResult {
    let reason = "earlier records are being recomputed; the wear estimate will follow".to_owned();
    let baseline = BaselineProgress { have: 0, need };
    let wear = WearEstimate::without_number(WearStatus::Recomputing, reason, baseline);
    RunResult { indicators: Indicators::default(), wear }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::*;
    use crate::asset::SegmentId;
    use crate::estimate::{ChannelEstimator, EstimatorSettings, MissingLibrary};

    fn key(second: u64) -> SegmentKey {
        let start_time = Timestamp::from_second(second as i64).unwrap();
        SegmentKey { start_time, id: SegmentId(format!("{second:03}")) }
    }

    #[test]
    fn recent_states_are_few_and_close_to_any_late_record() {
        let settings = EstimatorSettings { baseline_records: 8, limit_um: None };
        let estimator = ChannelEstimator::without_library(settings, MissingLibrary::NoMesh, Vec::new());
        let state = |position| FoldState { last: key(position), position, state: estimator.start() };
        for step in [1, 3, 40] {
            let mut recent = RecentStates::default();
            for first in (1..=40).step_by(step) {
                let until = (first + step as u64 - 1).min(40);
                recent.replace(first - 1, (first..=until).map(state).collect());
            }
            let held: Vec<u64> = recent.states.iter().map(|state| state.position).collect();
            assert_eq!(held, [28, 32, 36, 37, 38, 39, 40], "{step} at once");
            let before = |second| recent.before(&key(second)).map(|state| state.position);
            assert_eq!([40, 39, 36, 33].map(before), [Some(39), Some(38), Some(32), Some(32)]);
            assert_eq!(before(28), None);
        }
    }
}
