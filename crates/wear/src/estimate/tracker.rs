//! The fold over an asset's records: baseline first, then a probability over wear depths that each record
//! sharpens.

mod answer;
mod collecting;
mod healthy;
mod hindsight;
mod tracking;

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use self::collecting::Collecting;
pub use self::hindsight::HistoryStep;
use self::tracking::Tracking;
use super::depth_grid::DepthGrid;
use super::discrepancy::Discrepancy;
use super::event::{MaintenanceEvent, MaintenanceKind};
use super::filter::Filter;
use super::growth::Growth;
use super::wear::{MissingLibrary, WearEstimate, WearStatus};
use crate::library::Ensemble;
use flankwatch_signal::Features;

/// What a user decides about the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatorSettings {
    /// Records in the healthy baseline.
    pub baseline_records: u32,
    /// Wear depth in µm that the prognosis is about.
    pub limit_um: Option<f64>,
}

/// What is known after the records so far; an exact copy in JSON continues with the same bits.
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
    /// Whether more members of the ensemble follow.
    is_provisional: bool,
    grid: DepthGrid,
    growth: Growth,
    discrepancy: Option<Discrepancy>,
}

impl Tracker {
    /// A tracker for an ensemble of libraries; without one, only the baseline is collected and novelty
    /// judged.
    pub fn new(settings: EstimatorSettings, ensemble: Option<Arc<Ensemble>>) -> Self {
        let grid =
            ensemble.as_deref().map(|ensemble| DepthGrid::of(ensemble.depths_um())).unwrap_or_default();
        Self {
            settings,
            growth: Growth::on(grid.depths_um()),
            discrepancy: ensemble.as_deref().map(Discrepancy::of),
            grid,
            ensemble,
            missing_library: MissingLibrary::default(),
            is_provisional: false,
        }
    }

    /// A tracker for the first members of an ensemble whose rest is still simulated: what it answers to a
    /// record is told as provisional, and nothing is called other than wear.
    pub fn provisional(settings: EstimatorSettings, first: Arc<Ensemble>) -> Self {
        Self { is_provisional: true, ..Self::new(settings, Some(first)) }
    }

    /// A tracker while there is no library: as without one, and records are told why.
    pub fn without_library(settings: EstimatorSettings, missing_library: MissingLibrary) -> Self {
        Self { missing_library, ..Self::new(settings, None) }
    }

    /// The state before the first record.
    pub fn start(&self) -> TrackerState {
        TrackerState(Stage::Collecting(Box::default()))
    }

    /// Takes one more record that began at `at`; records and events come in time order.
    pub fn update(&self, state: &mut TrackerState, at: Timestamp, features: &Features) -> WearEstimate {
        let mut answer = self.update_state(state, at, features);
        self.missing_library.apply_to(&mut answer);
        if self.is_provisional {
            answer.make_provisional();
        }
        answer
    }

    /// The answer to a record that takes no part; the state stays as it is.
    pub fn excluded(&self, state: &TrackerState) -> WearEstimate {
        let have = match &state.0 {
            Stage::Collecting(collecting) => collecting.have().min(self.settings.baseline_records),
            Stage::Tracking(_) => self.settings.baseline_records,
        };
        let reason = "the record is excluded: it takes no part in the baseline, the estimate and the alarms";
        self.without_depth(WearStatus::Excluded, have, reason)
    }

    fn update_state(&self, state: &mut TrackerState, at: Timestamp, features: &Features) -> WearEstimate {
        match &mut state.0 {
            Stage::Collecting(collecting) => {
                if collecting.ends_chosen_baseline(at)
                    && let Some(tracking) = self.finish_chosen_baseline(collecting, at)
                {
                    state.0 = Stage::Tracking(Box::new(tracking));
                    return self.update_state(state, at, features);
                }
                let (answer, tracking) = self.collect(collecting, at, features);
                if let Some(tracking) = tracking {
                    state.0 = Stage::Tracking(Box::new(tracking));
                }
                answer
            }
            Stage::Tracking(tracking) => self.track(tracking, at, features),
        }
    }

    /// Takes an event: an inspection says how deep the wear is; else a new baseline is learnt, and unless the
    /// gear was replaced, wear goes on from where it was.
    pub fn event(&self, state: &mut TrackerState, event: &MaintenanceEvent) {
        let carried = match (&mut state.0, event.kind) {
            (Stage::Tracking(tracking), MaintenanceKind::Inspected) => {
                if let Some(inspection) = &event.inspection {
                    self.inspect(tracking, inspection);
                }
                return;
            }
            // Nothing has been compared yet that a depth could tell from.
            (Stage::Collecting(_), MaintenanceKind::Inspected) => return,
            (_, MaintenanceKind::GearReplaced | MaintenanceKind::BaselineChosen) => None,
            (Stage::Collecting(collecting), _) => collecting.take_carried(),
            (Stage::Tracking(tracking), _) => tracking.filter.take(),
        };
        state.0 = Stage::Collecting(Box::new(Collecting::after_event(carried, event.until)));
    }

    fn variants(&self) -> usize {
        self.ensemble.as_deref().map_or(1, Ensemble::variants)
    }

    /// A filter for this ensemble: the kept one where it fits, else that of a new machine.
    fn filter_for(&self, kept: Option<Filter>, members: usize) -> Filter {
        match kept {
            Some(filter) if filter.fits(members, self.variants()) => filter,
            _ => Filter::start(self.grid.depths_um(), members, self.variants()),
        }
    }
}

#[cfg(test)]
mod event_tests;
#[cfg(test)]
mod tests;
