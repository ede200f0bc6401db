//! Rate of change of readings: the slope of a straight line through the readings in a time window.

use std::collections::VecDeque;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// Cells of the window. Each cell counts with its mean, so that many records do not enlarge the state and a
/// burst of them does not dominate the line.
const CELLS: i64 = 24;

/// Part of the window that the readings must span before a rate is given.
const MIN_REACH: f64 = 0.5;

const SECONDS_A_DAY: f64 = 86_400.0;

/// The readings in a time window. A copy through JSON continues with the same results.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct RateWindow {
    cells: VecDeque<Cell>,
}

/// The readings in one cell of the window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Cell {
    /// Start of the cell, in cell lengths since 1970.
    number: i64,
    /// Number of readings.
    readings: f64,
    /// Mean time of the readings after the start of the cell, in seconds.
    after_s: f64,
    /// Mean value.
    value: f64,
}

impl RateWindow {
    /// Adds a reading and returns the change per day over the last `over_s` seconds; `None` while the
    /// readings span less than half of this window.
    pub(super) fn update(&mut self, over_s: f64, time: Timestamp, value: f64) -> Option<f64> {
        let cell_s = over_s / CELLS as f64;
        let seconds = time.as_nanosecond() as f64 * 1e-9;
        let number = (seconds / cell_s).floor();
        let after_s = seconds - number * cell_s;
        let number = number as i64;
        self.cells.retain(|cell| cell.number > number - CELLS);
        match self.cells.back_mut().filter(|cell| cell.number >= number) {
            Some(cell) => {
                cell.readings += 1.0;
                cell.after_s += (after_s - cell.after_s) / cell.readings;
                cell.value += (value - cell.value) / cell.readings;
            }
            None => self.cells.push_back(Cell { number, readings: 1.0, after_s, value }),
        }
        let points = || {
            self.cells.iter().map(|cell| ((cell.number - number) as f64 * cell_s + cell.after_s, cell.value))
        };
        let reach_s = after_s - points().next()?.0;
        let count = self.cells.len() as f64;
        if count < 3.0 || reach_s < MIN_REACH * over_s {
            return None;
        }
        let sum = points().fold((0.0, 0.0), |sum, point| (sum.0 + point.0, sum.1 + point.1));
        let mean = (sum.0 / count, sum.1 / count);
        let [across, along] = points().fold([0.0, 0.0], |[across, along], (at, value)| {
            [across + (at - mean.0) * (value - mean.1), along + (at - mean.0).powi(2)]
        });
        Some(SECONDS_A_DAY * across / along).filter(|rate| rate.is_finite())
    }

    /// Discards the readings.
    pub(super) fn clear(&mut self) {
        self.cells.clear();
    }

    /// Whether there are no readings.
    pub(super) fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;

    #[test]
    fn a_straight_line_has_its_slope_at_any_spacing_of_readings() {
        // 3 a day over two days, hourly at first, then every second for a while, then hourly.
        let mut window = RateWindow::default();
        let value = |seconds: i64| 5.0 + 3.0 * seconds as f64 / SECONDS_A_DAY;
        let times =
            (0..24).map(|n| 3600 * n).chain((0..5000).map(|n| 86_400 + n)).chain((26..48).map(|n| 3600 * n));
        let mut rates = Vec::new();
        for seconds in times {
            let time = Timestamp::UNIX_EPOCH + SignedDuration::from_secs(seconds);
            rates.push((seconds, window.update(86_400.0, time, value(seconds))));
        }
        for (seconds, rate) in rates {
            assert_eq!(rate.is_some(), seconds >= 43_200, "{seconds} s: {rate:?}");
            assert!(rate.is_none_or(|rate| (rate - 3.0).abs() < 1e-6), "{seconds} s: {rate:?}");
        }
        assert!(window.cells.len() <= CELLS as usize);
    }

    #[test]
    fn readings_before_a_pause_do_not_count() {
        let mut window = RateWindow::default();
        for minute in 0..60 {
            let time = Timestamp::UNIX_EPOCH + SignedDuration::from_mins(minute);
            window.update(3600.0, time, minute as f64);
        }
        let later = Timestamp::UNIX_EPOCH + SignedDuration::from_hours(9);
        assert_eq!(window.update(3600.0, later, 1000.0), None);
    }
}
