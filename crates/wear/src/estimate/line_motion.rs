//! Motion of the mesh lines: how far their means over the last records and over more records are apart.

use serde::{Deserialize, Serialize};

use super::measured_lines::MeasuredLines;
use crate::library::MESH_LINES;

/// Weight of the newest record in the mean over the last records, and in the mean over more records.
const LAST_PART: f32 = 0.3;
const MORE_PART: f32 = 0.05;

/// Distance of the two means, as a root mean square in standard deviations of a record, from which on the
/// lines move. It is about 0.3 while they stand still.
const MOVING: f64 = 2.5;

/// Moving means of each line's change since the baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct LineMotion {
    /// Over the last records; `None` for lines not seen.
    last: Vec<Option<f32>>,
    /// Over more records.
    more: Vec<f32>,
}

impl Default for LineMotion {
    fn default() -> Self {
        Self { last: vec![None; MESH_LINES], more: vec![0.0; MESH_LINES] }
    }
}

impl LineMotion {
    /// Adds a record, and returns whether the lines move.
    pub(super) fn add(&mut self, record: &MeasuredLines) -> bool {
        let mut squares = 0.0;
        for line in &record.lines {
            let change = line.change as f32;
            let last = self.last[line.index].map_or(change, |mean| mean + LAST_PART * (change - mean));
            self.last[line.index] = Some(last);
            let more = &mut self.more[line.index];
            squares += f64::from(last - *more).powi(2) / line.variance;
            *more += MORE_PART * (change - *more);
        }
        let mean_square = squares / record.lines.len().max(1) as f64;
        mean_square > MOVING * MOVING
    }

    /// Each line's mean change over the last records; `None` for lines not seen.
    pub(super) fn last(&self) -> &[Option<f32>] {
        &self.last
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::estimate::measured_lines::MeasuredLine;

    /// Number of records in which the lines move, of 300 whose lines change by `each` standard deviations
    /// from one record to the next.
    fn moving(each: f64) -> usize {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let normal = Normal::new(0.0, 0.1).unwrap();
        let mut motion = LineMotion::default();
        let mut add = |record: usize| {
            let level = 0.1 * each * record as f64;
            let mut line = |index| MeasuredLine {
                index,
                change: level + normal.sample(&mut rng),
                variance: 0.01,
                floor: -9.0,
            };
            let lines = (0..8).map(&mut line).collect();
            motion.add(&MeasuredLines { lines, load: 1.0 })
        };
        (0..300).filter(|record| add(*record)).count()
    }

    #[test]
    fn lines_move_if_they_change_faster_than_they_scatter() {
        assert_eq!(moving(0.0), 0);
        assert_eq!(moving(0.05), 0);
        assert!(moving(0.3) > 250, "{}", moving(0.3));
    }

    #[test]
    fn a_line_not_seen_has_no_mean() {
        let mut motion = LineMotion::default();
        let line = |change| MeasuredLine { index: 3, change, variance: 0.01, floor: -9.0 };
        motion.add(&MeasuredLines { lines: vec![line(0.2)], load: 1.0 });
        motion.add(&MeasuredLines { lines: vec![line(0.4)], load: 1.0 });
        assert_eq!(motion.last()[2], None);
        assert!((motion.last()[3].unwrap() - 0.26).abs() < 1e-6);
    }
}
