//! The fold over an asset's records: first the baseline is collected, then each record updates a probability
//! over wear depths.

mod collecting;
mod healthy;
mod hindsight;
mod record_estimate;
mod tracking;

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use self::collecting::Collecting;
pub use self::hindsight::HistoryStep;
use self::tracking::Tracking;
use super::depth_grid::DepthGrid;
use super::discrepancy::Discrepancy;
use super::event::{Inspection, MaintenanceEvent, MaintenanceKind};
use super::filter::Filter;
use super::growth::Growth;
use super::transmission_error::TransmissionErrors;
use super::wear::{MissingLibrary, WearEstimate, WearStatus};
use crate::library::{Ensemble, REPORTED};
use flankwatch_signal::Features;

/// Settings of the wear estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatorSettings {
    /// Records in the healthy baseline.
    pub baseline_records: u32,
    /// Wear limit in µm that the prognosis is made for.
    pub limit_um: Option<f64>,
}

/// State after the records so far. A copy through JSON continues with bit-identical results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackerState(Stage);

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Stage {
    Collecting(Box<Collecting>),
    Tracking(Box<Tracking>),
}

/// Estimates the wear of one measuring channel by folding over its records in time order.
#[derive(Debug)]
pub struct Tracker {
    settings: EstimatorSettings,
    ensemble: Option<Arc<Ensemble>>,
    missing_library: MissingLibrary,
    /// Whether further members of the ensemble are still being simulated.
    is_provisional: bool,
    grid: DepthGrid,
    growth: Growth,
    discrepancy: Option<Discrepancy>,
    transmission_errors: Option<TransmissionErrors>,
}

impl Tracker {
    /// Creates a tracker for an ensemble. Without one, it only collects the baseline and judges novelty.
    pub fn new(settings: EstimatorSettings, ensemble: Option<Arc<Ensemble>>) -> Self {
        let depths_um = ensemble.as_deref().map_or(&[][..], Ensemble::depths_um);
        let grid = DepthGrid::of(&depths_um[..depths_um.len().min(REPORTED)]);
        Self {
            settings,
            growth: Growth::on(depths_um),
            discrepancy: ensemble.as_deref().map(Discrepancy::of),
            transmission_errors: ensemble.as_deref().map(TransmissionErrors::of),
            grid,
            ensemble,
            missing_library: MissingLibrary::default(),
            is_provisional: false,
        }
    }

    /// Creates a tracker for the first members of an ensemble while the rest is still being simulated. Its
    /// estimates are marked provisional, and it attributes no record to anything but wear.
    pub fn provisional(settings: EstimatorSettings, first: Arc<Ensemble>) -> Self {
        Self { is_provisional: true, ..Self::new(settings, Some(first)) }
    }

    /// Creates a tracker without a library; its estimates say why there is none.
    pub fn without_library(settings: EstimatorSettings, missing_library: MissingLibrary) -> Self {
        Self { missing_library, ..Self::new(settings, None) }
    }

    /// Returns the state before the first record.
    pub fn start(&self) -> TrackerState {
        TrackerState(Stage::Collecting(Box::default()))
    }

    /// Whether the tracker can continue from a state: if wear is tracked in it, then with as many members.
    pub(super) fn continues(&self, state: &TrackerState) -> bool {
        let members = self.members();
        match &state.0 {
            Stage::Collecting(collecting) => {
                collecting.carried().is_none_or(|filter| filter.fits(members, self.variants()))
            }
            Stage::Tracking(tracking) => tracking.fits(members, self.variants()),
        }
    }

    /// Updates the state with a record that began at `at` and returns its estimate. Records and events must
    /// come in time order.
    pub fn update(&self, state: &mut TrackerState, at: Timestamp, features: &Features) -> WearEstimate {
        let mut estimate = self.update_state(state, at, features);
        self.missing_library.apply_to(&mut estimate);
        estimate.ask_about_speed(features);
        if self.is_provisional {
            estimate.make_provisional();
        }
        estimate
    }

    /// Returns the estimate of a record that users excluded; it does not change the state.
    pub fn excluded(&self, state: &TrackerState) -> WearEstimate {
        let have = match &state.0 {
            Stage::Collecting(collecting) => collecting.have().min(self.settings.baseline_records),
            Stage::Tracking(_) => self.settings.baseline_records,
        };
        let reason = "the record is excluded from the baseline, the estimate and the alarms";
        self.without_depth(WearStatus::Excluded, have, reason)
    }

    fn update_state(&self, state: &mut TrackerState, at: Timestamp, features: &Features) -> WearEstimate {
        self.end_chosen_baseline(state, at);
        match &mut state.0 {
            Stage::Collecting(collecting) => {
                let (estimate, tracking) = self.collect(collecting, at, features);
                if let Some(tracking) = tracking {
                    state.0 = Stage::Tracking(Box::new(tracking));
                }
                estimate
            }
            Stage::Tracking(tracking) => self.track(tracking, at, features),
        }
    }

    /// Updates the state with a maintenance event. An inspection sets the wear depth, but not while the first
    /// baseline of the gears is collected. Any other event starts a new baseline; wear continues from its
    /// present depth unless the gear was replaced or the baseline was chosen.
    pub fn event(&self, state: &mut TrackerState, event: &MaintenanceEvent) {
        if event.kind == MaintenanceKind::Inspected {
            if let Some(inspection) = &event.inspection {
                self.inspect(state, event.time, inspection);
            }
            return;
        }
        // What is not known of the same gears stays unknown.
        let (carried, passed_over) = match (&mut state.0, event.kind) {
            (_, MaintenanceKind::GearReplaced | MaintenanceKind::BaselineChosen) => (None, 0),
            (Stage::Collecting(collecting), _) => (collecting.take_carried(), collecting.passed_over()),
            (Stage::Tracking(tracking), _) => (tracking.filter.take(), tracking.passed_over.unwrap_or(0)),
        };
        let collecting = Collecting::after_event(carried, event.until).passing_over(passed_over);
        state.0 = Stage::Collecting(Box::new(collecting));
    }

    /// Updates the state with a depth that was measured on the teeth at `at`.
    fn inspect(&self, state: &mut TrackerState, at: Timestamp, inspection: &Inspection) {
        let Some(ensemble) = self.ensemble.as_deref() else {
            return;
        };
        self.end_chosen_baseline(state, at);
        match &mut state.0 {
            Stage::Collecting(collecting) => {
                // Wear counts from the first baseline of the gears, whatever their depth is then.
                if let Some(filter) = collecting.take_carried() {
                    collecting.carry_inspected(self.inspected(ensemble, Some(filter), inspection));
                }
            }
            Stage::Tracking(tracking) => {
                tracking.filter = Some(self.inspected(ensemble, tracking.filter.take(), inspection));
                tracking.add_inspection(ensemble, inspection);
            }
        }
    }

    /// Starts tracking where a chosen baseline is over at this time.
    fn end_chosen_baseline(&self, state: &mut TrackerState, at: Timestamp) {
        if let Stage::Collecting(collecting) = &mut state.0
            && collecting.ends_chosen_baseline(at)
            && let Some(tracking) = self.finish_chosen_baseline(collecting, at)
        {
            state.0 = Stage::Tracking(Box::new(tracking));
        }
    }

    /// Depths in µm that are tracked, more than are reported; none without a library.
    fn tracked_um(&self) -> &[f64] {
        self.ensemble.as_deref().map_or(&[], Ensemble::depths_um)
    }

    /// Number of members of the ensemble; 0 without one.
    fn members(&self) -> usize {
        self.ensemble.as_deref().map_or(0, |ensemble| ensemble.members().len())
    }

    fn variants(&self) -> usize {
        self.ensemble.as_deref().map_or(1, Ensemble::variants)
    }

    /// Returns the existing filter where its size fits the ensemble, else that of a new machine.
    fn filter_for(&self, existing: Option<Filter>) -> Filter {
        let (members, variants) = (self.members(), self.variants());
        match existing {
            Some(filter) if filter.fits(members, variants) => filter,
            _ => Filter::start(self.tracked_um(), members / variants, variants),
        }
    }
}

#[cfg(test)]
mod event_tests;
#[cfg(test)]
mod forecast_tests;
#[cfg(test)]
mod load_tests;
#[cfg(test)]
mod long_life_tests;
#[cfg(test)]
mod state_tests;
#[cfg(test)]
mod tests;
