//! Sudden changes of the mesh lines.
//!
//! Wear moves the lines over many records, and goes on. A load, or anything else of the machine's operation,
//! moves them from one record to the next, and then they stay. Where the torque of the records is not known,
//! such a change does not prove wear: the depths that were probable before it remain possible until the lines
//! move on.

use serde::{Deserialize, Serialize};

use super::measured_lines::MeasuredLines;
use crate::library::MESH_LINES;

/// A record differs from a level if its lines do by this many standard deviations, as a root mean square.
const DIFFERENT: f64 = 2.2;

/// Number of records in a row that differ, from which on a change counts as lasting.
const LASTING: u8 = 3;

/// Number of records in the mean level after a change.
const RECORDS_AFTER: u8 = 10;

/// Weight of the newest record in the level before a change.
const NEWEST_PART: f64 = 0.3;

/// Probability of a depth that is not kept: zeros are short as text.
const NEGLIGIBLE: f64 = 1e-5;

/// The level of the lines, and the depths before it last changed suddenly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct SuddenChange {
    /// By line, its change since the baseline: a moving mean, or the mean since a sudden change; `None` for
    /// lines not seen since then. Empty if the next record sets it.
    level: Vec<Option<f32>>,
    /// Number of records in a row that differ from the level.
    differing: u8,
    /// Number of records in the mean since a sudden change; `None` without one.
    records_after: Option<u8>,
    /// Probability by reported depth before the change, or so far.
    before: Vec<f32>,
}

impl Default for SuddenChange {
    fn default() -> Self {
        Self { level: vec![Some(0.0); MESH_LINES], differing: 0, records_after: None, before: Vec::new() }
    }
}

impl SuddenChange {
    /// Starts again, with the next record as the level.
    pub(super) fn restart(&mut self) {
        *self = Self { level: Vec::new(), ..Self::default() };
    }

    /// Adds a record, and the probability by reported depth after it.
    pub(super) fn add(&mut self, record: &MeasuredLines, by_depth: &[f64]) {
        if self.level.is_empty() {
            self.set_level(record);
        }
        if self.distance(record) > DIFFERENT {
            self.differing += 1;
            if self.differing < LASTING {
                return;
            }
            // The lines move on after a sudden change: this is not what a load does.
            self.records_after = if self.records_after.is_some() { None } else { Some(0) };
            self.set_level(record);
        }
        self.differing = 0;
        let part = match &mut self.records_after {
            Some(records) => {
                *records += 1;
                if *records > RECORDS_AFTER {
                    *records = RECORDS_AFTER;
                    return;
                }
                1.0 / f64::from(*records)
            }
            None => {
                self.before =
                    by_depth.iter().map(|p| if *p < NEGLIGIBLE { 0.0 } else { *p as f32 }).collect();
                NEWEST_PART
            }
        };
        for line in &record.lines {
            let level = self.level[line.index].get_or_insert(line.change as f32);
            *level += (part * (line.change - f64::from(*level))) as f32;
        }
    }

    /// Probability by reported depth before a sudden change; `None` without one.
    pub(super) fn before(&self) -> Option<&[f32]> {
        self.records_after.and(Some(&*self.before)).filter(|before| !before.is_empty())
    }

    fn set_level(&mut self, record: &MeasuredLines) {
        self.level = vec![None; MESH_LINES];
        record.lines.iter().for_each(|line| self.level[line.index] = Some(line.change as f32));
    }

    /// Root mean square of the lines' distances from the level, in standard deviations.
    fn distance(&self, record: &MeasuredLines) -> f64 {
        let squares = record.lines.iter().filter_map(|line| {
            let difference = line.change - f64::from(self.level[line.index]?);
            Some(difference * difference / line.variance)
        });
        let (count, sum) = squares.fold((0, 0.0), |(count, sum), square| (count + 1, sum + square));
        (sum / f64::from(count.max(1))).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::measured_lines::MeasuredLine;

    /// A record whose lines have changed by 1 and 3 parts of `change`.
    fn record(change: f64) -> MeasuredLines {
        let line = |(index, part)| MeasuredLine { index, change: part * change, variance: 0.01, floor: -9.0 };
        MeasuredLines { lines: [(0, 1.0), (4, 3.0)].into_iter().map(line).collect(), load: 1.0 }
    }

    /// Adds records with these changes, each with a depth that is certain: the number of the record.
    fn watched(changes: impl IntoIterator<Item = f64>) -> SuddenChange {
        let mut sudden = SuddenChange::default();
        for (number, change) in changes.into_iter().enumerate() {
            let mut by_depth = vec![0.0; 500];
            by_depth[number] = 1.0;
            sudden.add(&record(change), &by_depth);
        }
        sudden
    }

    fn depth_before(sudden: &SuddenChange) -> Option<usize> {
        sudden.before()?.iter().position(|p| *p == 1.0)
    }

    #[test]
    fn a_lasting_step_keeps_the_depths_before_it() {
        let step = |records| watched((0..records).map(|n| if n < 10 { 0.0 } else { 0.3 }));
        assert_eq!(depth_before(&step(12)), None, "not yet lasting");
        assert_eq!(depth_before(&step(13)), Some(9));
        assert_eq!(depth_before(&step(200)), Some(9));
    }

    #[test]
    fn single_records_and_gradual_changes_are_not_sudden() {
        assert_eq!(depth_before(&watched((0..60).map(|n| if n % 5 == 4 { 0.3 } else { 0.0 }))), None);
        for records in 1..200 {
            assert_eq!(depth_before(&watched((0..records).map(|n| 0.02 * f64::from(n)))), None, "{records}");
        }
    }

    #[test]
    fn a_step_after_which_the_lines_move_on_is_forgotten() {
        let moving = |n: i32| if n < 10 { 0.0 } else { 0.3 + 0.02 * f64::from((n - 20).max(0)) };
        let sudden = watched((0..60).map(moving));
        assert_eq!(depth_before(&sudden), None);
    }

    #[test]
    fn after_a_restart_the_next_record_is_the_level() {
        let mut sudden = watched(vec![0.0; 10]);
        sudden.restart();
        for _ in 0..10 {
            sudden.add(&record(0.5), &[1.0]);
        }
        assert_eq!(sudden.before(), None);
    }

    /// The first record after a restart is sampled too slowly for one of the lines.
    #[test]
    fn a_line_that_was_not_seen_has_no_level() {
        let mut sudden = watched(vec![0.0; 10]);
        sudden.restart();
        let mut slow = record(0.5);
        slow.lines.pop();
        sudden.add(&slow, &[1.0]);
        for _ in 0..10 {
            sudden.add(&record(0.5), &[1.0]);
        }
        assert_eq!(sudden.before(), None);
    }
}
