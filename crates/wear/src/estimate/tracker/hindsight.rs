//! Estimates of earlier records in the light of a later inspection.
//!
//! An inspection shows which members of the ensemble resemble the machine. That holds for its past too, so
//! the records before the inspection are estimated again, each group of members weighted with its probability
//! after the inspection. A group's depth at a record still follows from the records up to that one alone; the
//! fact that wear was nowhere deeper than at the inspection is not used.

use std::sync::Arc;

use flankwatch_signal::Features;
use jiff::Timestamp;

use super::{Stage, Tracker, TrackerState};
use crate::estimate::event::{MaintenanceEvent, MaintenanceKind};
use crate::estimate::wear::WearEstimate;

/// One step of a channel's history.
#[derive(Debug, Clone, Copy)]
pub enum HistoryStep<'a> {
    /// A record that began at a time.
    Record(Timestamp, &'a Features),
    /// Maintenance of the machine.
    Event(&'a MaintenanceEvent),
}

/// The steps before an inspection of the same teeth.
struct InspectedPeriod {
    /// From the first step of these teeth to the inspection, which is not included.
    steps: std::ops::Range<usize>,
    /// Probability of each group of members after the inspection.
    groups: Arc<[f32]>,
}

impl Tracker {
    /// Estimates the records before the last inspection of the same teeth again, in the light of it. Returns
    /// one entry per step, `None` for events and for records that no inspection follows. `steps` are in time
    /// order.
    pub fn in_hindsight(&self, steps: &[HistoryStep<'_>]) -> Vec<Option<WearEstimate>> {
        let periods = self.inspected_periods(steps);
        let mut estimates = vec![None; steps.len()];
        let mut state = self.start();
        let end = periods.iter().map(|period| period.steps.end).max().unwrap_or(0);
        for (index, step) in steps[..end].iter().enumerate() {
            let period = periods.iter().find(|period| period.steps.contains(&index));
            match step {
                HistoryStep::Event(event) => self.event(&mut state, event),
                HistoryStep::Record(at, features) => {
                    self.end_chosen_baseline(&mut state, *at);
                    if let Stage::Tracking(tracking) = &mut state.0 {
                        tracking.hindsight = period.map(|period| Arc::clone(&period.groups));
                    }
                    let estimate = self.update(&mut state, *at, features);
                    estimates[index] = period.map(|_| estimate);
                }
            }
        }
        estimates
    }

    /// Returns the period before the last inspection of each gear pair.
    fn inspected_periods(&self, steps: &[HistoryStep<'_>]) -> Vec<InspectedPeriod> {
        let is_inspection =
            |step: &HistoryStep<'_>| matches!(step, HistoryStep::Event(event) if event.inspection.is_some());
        let end = steps.iter().rposition(is_inspection).map_or(0, |last| last + 1);
        let (mut state, mut first) = (self.start(), 0);
        let mut periods: Vec<InspectedPeriod> = Vec::new();
        for (index, step) in steps[..end].iter().enumerate() {
            let event = match step {
                HistoryStep::Record(at, features) => {
                    self.update(&mut state, *at, features);
                    continue;
                }
                HistoryStep::Event(event) => event,
            };
            self.event(&mut state, event);
            match event.kind {
                MaintenanceKind::GearReplaced | MaintenanceKind::BaselineChosen => first = index + 1,
                MaintenanceKind::SensorReplaced | MaintenanceKind::RegimeChanged => {}
                MaintenanceKind::Inspected => {
                    let Some(groups) = group_probabilities(&state) else { continue };
                    periods.retain(|period| period.steps.start != first);
                    periods.push(InspectedPeriod { steps: first..index, groups: groups.into() });
                }
            }
        }
        periods
    }
}

/// Probability of each group of members; `None` while the first baseline of the gears is collected.
fn group_probabilities(state: &TrackerState) -> Option<Vec<f32>> {
    let filter = match &state.0 {
        Stage::Tracking(tracking) => tracking.filter.as_ref(),
        Stage::Collecting(collecting) => collecting.carried(),
    };
    Some(filter?.groups())
}
