//! What the records of one channel say one after the other: its wear, its indicators over the run, its
//! alarms.
//!
//! Everything here is a pure function of the records, events and actions that went in, in their order.

use std::sync::Arc;

use flankwatch_signal::{Features, Indicators, RunMeans};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::alarm::{AlarmPanel, AlarmRule, PanelAction, PanelChange};
use super::event::MaintenanceEvent;
use super::tracker::{EstimatorSettings, HistoryStep, Tracker, TrackerState};
use super::wear::{MissingLibrary, WearEstimate};
use crate::library::Ensemble;

/// Estimates wear and alarms along a channel's records.
#[derive(Debug, Clone)]
pub struct ChannelEstimator {
    tracker: Arc<Tracker>,
    rules: Arc<[AlarmRule]>,
}

/// What is known of a channel after some of its records; an exact copy in JSON goes on the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChannelState {
    tracker: TrackerState,
    run_means: RunMeans,
    alarms: AlarmPanel,
}

/// What one record says in the light of those before it.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordResult {
    /// Indicators that need the records before.
    pub indicators: Indicators,
    /// The wear estimate.
    pub wear: WearEstimate,
    /// Changes of alarms.
    pub changes: Vec<PanelChange>,
}

impl ChannelEstimator {
    /// One with these settings, the libraries of the pair where it has any, and the rules of its alarms.
    pub fn new(settings: EstimatorSettings, ensemble: Option<Arc<Ensemble>>, rules: Vec<AlarmRule>) -> Self {
        Self { tracker: Arc::new(Tracker::new(settings, ensemble)), rules: rules.into() }
    }

    /// One with the first members of an ensemble whose rest is still simulated.
    pub fn provisional(settings: EstimatorSettings, first: Arc<Ensemble>, rules: Vec<AlarmRule>) -> Self {
        Self { tracker: Arc::new(Tracker::provisional(settings, first)), rules: rules.into() }
    }

    /// One while there is no library: as without a pair, and records are told why.
    pub fn without_library(
        settings: EstimatorSettings,
        missing_library: MissingLibrary,
        rules: Vec<AlarmRule>,
    ) -> Self {
        Self { tracker: Arc::new(Tracker::without_library(settings, missing_library)), rules: rules.into() }
    }

    /// The rules of its alarms.
    pub fn rules(&self) -> &[AlarmRule] {
        &self.rules
    }

    /// The state before the first record.
    pub fn start(&self) -> ChannelState {
        ChannelState {
            tracker: self.tracker.start(),
            run_means: RunMeans::default(),
            alarms: AlarmPanel::of(&self.rules),
        }
    }

    /// Takes a record.
    pub fn record(
        &self,
        state: &mut ChannelState,
        time: Timestamp,
        features: &Features,
        indicators: &Indicators,
    ) -> RecordResult {
        let wear = self.tracker.update(&mut state.tracker, time, features);
        let mut of_run = state.run_means.update(indicators);
        of_run.extend(wear.indicators());
        let changes = state.alarms.reading(&self.rules, time, &wear, [indicators, &of_run]);
        RecordResult { indicators: of_run, wear, changes }
    }

    /// The estimates of records before the last inspection of the same teeth, with what it taught; by step.
    pub fn in_hindsight(&self, steps: &[HistoryStep<'_>]) -> Vec<Option<WearEstimate>> {
        self.tracker.in_hindsight(steps)
    }

    /// What is said of a record that people excluded; the state stays as it is.
    pub fn excluded(&self, state: &ChannelState) -> RecordResult {
        RecordResult {
            indicators: Indicators::default(),
            wear: self.tracker.excluded(&state.tracker),
            changes: Vec::new(),
        }
    }

    /// Takes maintenance between two records; returns the changes of alarms.
    pub fn maintenance(&self, state: &mut ChannelState, event: &MaintenanceEvent) -> Vec<PanelChange> {
        self.tracker.event(&mut state.tracker, event);
        // Means over the run of another gear or sensor are nothing to compare with.
        state.run_means = RunMeans::default();
        state.alarms.maintenance(&self.rules, event)
    }

    /// Takes what an operator did to an alarm; none where no rule watches its quantity any more.
    pub fn action(&self, state: &mut ChannelState, action: &PanelAction) -> Option<PanelChange> {
        state.alarms.act(&self.rules, action)
    }
}

impl ChannelState {
    /// The alarms in the order of the rules.
    pub fn into_alarms(self) -> AlarmPanel {
        self.alarms
    }
}
