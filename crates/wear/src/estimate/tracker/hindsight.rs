//! What records before an inspection say once it is known.
//!
//! An inspection tells which members of the ensemble are like the machine. That holds for its past too: the
//! records before it are followed once more, and each group of members counts with the probability that it
//! has after the inspection. How deep a group is at a record follows from the records up to that one, as
//! ever; that wear was nowhere deeper than at the inspection is not used besides.

use std::sync::Arc;

use flankwatch_signal::Features;
use jiff::Timestamp;

use super::{Stage, Tracker, TrackerState};
use crate::estimate::event::{MaintenanceEvent, MaintenanceKind};
use crate::estimate::wear::WearEstimate;

/// One step of a channel's life.
#[derive(Debug, Clone, Copy)]
pub enum LifeStep<'a> {
    /// A record that began at a time.
    Record(Timestamp, &'a Features),
    /// What was done to the machine.
    Event(&'a MaintenanceEvent),
}

/// What an inspection says of the steps before it.
struct Lesson {
    /// The first step of the same teeth, and the inspection's.
    steps: std::ops::Range<usize>,
    /// Probability of each group of members.
    groups: Arc<[f32]>,
}

impl Tracker {
    /// The estimates of records before the last inspection of the same teeth, with what it taught; by step,
    /// and none for steps that no inspection follows. Steps come in the order of time.
    pub fn in_hindsight(&self, steps: &[LifeStep<'_>]) -> Vec<Option<WearEstimate>> {
        let lessons = self.lessons(steps);
        let mut estimates = vec![None; steps.len()];
        let mut state = self.start();
        let end = lessons.iter().map(|lesson| lesson.steps.end).max().unwrap_or(0);
        for (index, step) in steps[..end].iter().enumerate() {
            let lesson = lessons.iter().find(|lesson| lesson.steps.contains(&index));
            match step {
                LifeStep::Event(event) => self.event(&mut state, event),
                LifeStep::Record(at, features) => {
                    if let Stage::Tracking(tracking) = &mut state.0 {
                        tracking.hindsight = lesson.map(|lesson| Arc::clone(&lesson.groups));
                    }
                    let estimate = self.update(&mut state, *at, features);
                    estimates[index] = lesson.map(|_| estimate);
                }
            }
        }
        estimates
    }

    /// The last inspection of each pair of teeth.
    fn lessons(&self, steps: &[LifeStep<'_>]) -> Vec<Lesson> {
        let is_inspection =
            |step: &LifeStep<'_>| matches!(step, LifeStep::Event(event) if event.inspection.is_some());
        let end = steps.iter().rposition(is_inspection).map_or(0, |last| last + 1);
        let (mut state, mut first) = (self.start(), 0);
        let mut lessons: Vec<Lesson> = Vec::new();
        for (index, step) in steps[..end].iter().enumerate() {
            let event = match step {
                LifeStep::Record(at, features) => {
                    self.update(&mut state, *at, features);
                    continue;
                }
                LifeStep::Event(event) => event,
            };
            self.event(&mut state, event);
            match event.kind {
                MaintenanceKind::GearReplaced | MaintenanceKind::BaselineChosen => first = index + 1,
                MaintenanceKind::SensorReplaced | MaintenanceKind::RegimeChanged => {}
                MaintenanceKind::Inspected => {
                    let Some(groups) = groups_of(&state) else { continue };
                    lessons.retain(|lesson| lesson.steps.start != first);
                    lessons.push(Lesson { steps: first..index, groups: groups.into() });
                }
            }
        }
        lessons
    }
}

/// What is believed of the groups of members; none while a baseline is collected.
fn groups_of(state: &TrackerState) -> Option<Vec<f32>> {
    match &state.0 {
        Stage::Tracking(tracking) => Some(tracking.filter.as_ref()?.groups()),
        Stage::Collecting(_) => None,
    }
}
