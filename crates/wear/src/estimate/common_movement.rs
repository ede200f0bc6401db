//! Common movement of the healthy lines from record to record.
//!
//! Load is the main disturbance of a healthy machine: it moves all mesh lines at once, always in the same
//! proportions. Where the torque of the records is not known, these proportions appear in the baseline as the
//! direction of most of the lines' scatter. Early wear under load moves the lines in nearly the same way, so
//! changes along this direction are not removed; instead, the estimate allows for no wear at all.

use nalgebra::{DMatrix, SymmetricEigen};

use super::measured_lines::MeasuredLines;

/// Fewest lines and records from which a direction is estimated.
const MIN_LINES: usize = 6;
const MIN_RECORDS: usize = 12;

/// Least part of the lines' variance along the direction. Six independent lines of 20 records give 0.3.
const MIN_PART: f64 = 0.5;

/// A record has moved along the direction by more than this many standard deviations of the healthy ones, ...
const MOVED: f64 = 3.0;

/// ... and this part of its squared change lies along it.
const ALONG: f64 = 0.6;

/// The direction of most of the healthy lines' scatter.
#[derive(Debug, Clone)]
pub(super) struct CommonMovement {
    /// By line (0 is the first mesh harmonic): its component of the unit vector along the direction.
    lines: Vec<(usize, f64)>,
    /// Standard deviation of the healthy records along it.
    deviation: f64,
}

impl CommonMovement {
    /// Estimates the direction from the residuals of the fit over speed; `None` where none stands out.
    pub(super) fn of(lines: &[(usize, &[f64])]) -> Option<Self> {
        let records = lines.iter().map(|(_, values)| values.len()).min().unwrap_or(0);
        if lines.len() < MIN_LINES || records < MIN_RECORDS {
            return None;
        }
        let values = DMatrix::from_fn(records, lines.len(), |record, line| lines[line].1[record]);
        let eigen = SymmetricEigen::new(values.tr_mul(&values) / records as f64);
        let most = eigen.eigenvalues.imax();
        let variance = eigen.eigenvalues[most];
        if variance < MIN_PART * eigen.eigenvalues.sum() {
            return None;
        }
        let direction = eigen.eigenvectors.column(most);
        let lines = lines.iter().zip(direction.iter()).map(|((line, _), part)| (*line, *part));
        Some(Self { lines: lines.collect(), deviation: variance.sqrt() })
    }

    /// Whether a record's lines have moved along the direction, and much further than in the baseline.
    pub(super) fn explains(&self, record: &MeasuredLines) -> bool {
        let (mut along, mut square, mut change) = (0.0, 0.0, 0.0);
        for line in &record.lines {
            if let Some((_, part)) = self.lines.iter().find(|(index, _)| *index == line.index) {
                along += part * line.change;
                square += part * part;
                change += line.change * line.change;
            }
        }
        // The best-fitting distance along the direction.
        let moved = along / f64::max(square, f64::MIN_POSITIVE);
        square > MIN_PART && moved.abs() > MOVED * self.deviation && along * moved > ALONG * change
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::estimate::measured_lines::MeasuredLine;

    const LINES: usize = 8;

    /// Effect of load on each line.
    fn direction(line: usize) -> f64 {
        1.0 + (1.3 * line as f64).sin()
    }

    fn baseline(load: f64, own: f64, seed: u64) -> Vec<Vec<f64>> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let mut lines = vec![Vec::new(); LINES];
        for _ in 0..20 {
            let torque = load * normal();
            for (line, values) in lines.iter_mut().enumerate() {
                values.push(torque * direction(line) + own * normal());
            }
        }
        lines
    }

    fn movement(lines: &[Vec<f64>]) -> Option<CommonMovement> {
        CommonMovement::of(&lines.iter().map(Vec::as_slice).enumerate().collect::<Vec<_>>())
    }

    fn record(change: impl Fn(usize) -> f64) -> MeasuredLines {
        let line = |index| MeasuredLine { index, change: change(index), variance: 0.01, floor: -9.0 };
        MeasuredLines { lines: (0..LINES).map(line).collect(), load: 1.0 }
    }

    #[test]
    fn a_load_beyond_the_baselines_is_recognised_and_other_movements_are_not() {
        let movement = movement(&baseline(0.1, 0.05, 1)).unwrap();
        assert!(movement.explains(&record(|line| 0.5 * direction(line))));
        assert!(movement.explains(&record(|line| -0.5 * direction(line))));
        assert!(!movement.explains(&record(|line| 0.15 * direction(line))), "within the baseline's scatter");
        assert!(!movement.explains(&record(|line| 0.5 * if line % 2 == 0 { 1.0 } else { -1.0 })));
    }

    #[test]
    fn lines_that_scatter_by_themselves_have_no_common_movement() {
        assert!((0..50).all(|seed| movement(&baseline(0.0, 0.1, seed)).is_none()));
    }
}
