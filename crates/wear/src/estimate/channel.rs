//! The results of one channel's records in sequence: wear, run-wide indicators and alarms.
//!
//! Everything here is a pure function of the records, events and actions, in their order.

use std::sync::Arc;

use flankwatch_signal::{Features, Indicators, RunMeans};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::alarm::{AlarmPanel, AlarmRule, PanelAction, PanelChange};
use super::event::{MaintenanceEvent, MaintenanceKind};
use super::tracker::{EstimatorSettings, HistoryStep, Tracker, TrackerState};
use super::wear::{MissingLibrary, WearEstimate};
use crate::library::Ensemble;

/// Estimates wear and alarms along a channel's records.
#[derive(Debug, Clone)]
pub struct ChannelEstimator {
    tracker: Arc<Tracker>,
    rules: Arc<[AlarmRule]>,
}

/// State of a channel after some of its records. A copy through JSON continues with the same results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChannelState {
    tracker: TrackerState,
    run_means: RunMeans,
    alarms: AlarmPanel,
}

/// The results of one record, given the records before it.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordResult {
    /// Indicators that depend on earlier records.
    pub indicators: Indicators,
    /// The wear estimate.
    pub wear: WearEstimate,
    /// Changes of alarms.
    pub changes: Vec<PanelChange>,
}

impl ChannelEstimator {
    /// Creates an estimator with these settings, the pair's ensemble where there is one, and alarm rules.
    pub fn new(settings: EstimatorSettings, ensemble: Option<Arc<Ensemble>>, rules: Vec<AlarmRule>) -> Self {
        Self { tracker: Arc::new(Tracker::new(settings, ensemble)), rules: rules.into() }
    }

    /// Creates an estimator with the first members of an ensemble while the rest is still being simulated.
    pub fn provisional(settings: EstimatorSettings, first: Arc<Ensemble>, rules: Vec<AlarmRule>) -> Self {
        Self { tracker: Arc::new(Tracker::provisional(settings, first)), rules: rules.into() }
    }

    /// Creates an estimator without a library; its estimates say why there is none.
    pub fn without_library(
        settings: EstimatorSettings,
        missing_library: MissingLibrary,
        rules: Vec<AlarmRule>,
    ) -> Self {
        Self { tracker: Arc::new(Tracker::without_library(settings, missing_library)), rules: rules.into() }
    }

    /// Returns the alarm rules.
    pub fn rules(&self) -> &[AlarmRule] {
        &self.rules
    }

    /// Returns the state before the first record.
    pub fn start(&self) -> ChannelState {
        ChannelState {
            tracker: self.tracker.start(),
            run_means: RunMeans::default(),
            alarms: AlarmPanel::of(&self.rules),
        }
    }

    /// Whether a state is one of this estimator's, or of one whose ensemble has as many members.
    pub fn continues(&self, state: &ChannelState) -> bool {
        self.tracker.continues(&state.tracker)
    }

    /// Updates the state with a record and returns its results.
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

    /// Estimates the records before the last inspection of the same teeth again, in the light of it. Returns
    /// one entry per step, `None` for events and for records that no inspection follows.
    pub fn in_hindsight(&self, steps: &[HistoryStep<'_>]) -> Vec<Option<WearEstimate>> {
        self.tracker.in_hindsight(steps)
    }

    /// Returns the result of a record that users excluded; it does not change the state.
    pub fn excluded(&self, state: &ChannelState) -> RecordResult {
        RecordResult {
            indicators: Indicators::default(),
            wear: self.tracker.excluded(&state.tracker),
            changes: Vec::new(),
        }
    }

    /// Updates the state with maintenance between two records; returns the changes of alarms.
    pub fn maintenance(&self, state: &mut ChannelState, event: &MaintenanceEvent) -> Vec<PanelChange> {
        self.tracker.event(&mut state.tracker, event);
        // Means over the run of another gear or sensor are not comparable. An inspection changes neither.
        if event.kind != MaintenanceKind::Inspected {
            state.run_means = RunMeans::default();
        }
        state.alarms.maintenance(&self.rules, event)
    }

    /// Applies what an operator did to an alarm; `None` where no rule watches its quantity any more.
    pub fn action(&self, state: &mut ChannelState, action: &PanelAction) -> Option<PanelChange> {
        state.alarms.act(&self.rules, action)
    }
}

impl ChannelState {
    /// Returns the alarms in the order of the rules.
    pub fn into_alarms(self) -> AlarmPanel {
        self.alarms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn run_means_restart_with_a_sensor_and_not_with_an_inspection() {
        let settings = EstimatorSettings { baseline_records: 10, limit_um: None };
        let estimator = ChannelEstimator::new(settings, None, Vec::new());
        let mut indicators = Indicators::default();
        indicators.values.insert("residual_variance", 2.0);
        indicators.values.insert("residual_fourth_moment", 12.0);
        let mut state = estimator.start();
        state.run_means.update(&indicators);
        let event = |kind| MaintenanceEvent {
            time: Timestamp::UNIX_EPOCH,
            kind,
            by: String::new(),
            comment: String::new(),
            inspection: None,
            until: None,
        };
        estimator.maintenance(&mut state, &event(MaintenanceKind::Inspected));
        assert_ne!(state.run_means, RunMeans::default());
        estimator.maintenance(&mut state, &event(MaintenanceKind::SensorReplaced));
        assert_eq!(state.run_means, RunMeans::default());
    }
}
