//! Reduction of points for plots that preserves extreme values.

use std::ops::Range;

/// Returns the positions of at most about `max_points` entries of parallel columns of `length` entries: the
/// first and the last one, and the minimum and maximum of every column in each of equal intervals. Returns
/// all positions if there are at most `max_points`.
///
/// NaN means no value; an interval without any value keeps its first position. At least two positions per
/// column are returned.
pub fn extremes(columns: &[&[f64]], length: usize, max_points: usize) -> Vec<usize> {
    if length <= max_points {
        return (0..length).collect();
    }
    let intervals = (max_points.saturating_sub(2) / (2 * columns.len().max(1))).max(1);
    let mut positions = vec![0, length - 1];
    for interval in split(length, intervals) {
        let before = positions.len();
        for column in columns {
            let with_values = interval.clone().filter(|n| column[*n].is_finite());
            let by_value = |a: &usize, b: &usize| column[*a].total_cmp(&column[*b]);
            positions.extend(with_values.clone().min_by(by_value));
            positions.extend(with_values.max_by(by_value));
        }
        if positions.len() == before {
            positions.push(interval.start);
        }
    }
    positions.sort_unstable();
    positions.dedup();
    positions
}

/// Returns the positions of at most `max_points` entries: the maximum in each of equal intervals. Returns all
/// positions if there are no more.
pub fn peaks(values: &[f64], max_points: usize) -> Vec<usize> {
    if values.len() <= max_points {
        return (0..values.len()).collect();
    }
    split(values.len(), max_points)
        .filter_map(|interval| interval.max_by(|a, b| values[*a].total_cmp(&values[*b])))
        .collect()
}

/// Splits `length` entries into `parts` intervals, none empty if there are enough entries.
fn split(length: usize, parts: usize) -> impl Iterator<Item = Range<usize>> {
    let parts = parts.min(length);
    (0..parts).map(move |n| n * length / parts..(n + 1) * length / parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn one_spike_among_a_million_is_kept() {
        let mut values = vec![0.0; 1_000_000];
        values[777_777] = 9.0;
        values[123_456] = -9.0;
        let positions = extremes(&[&values], values.len(), 1000);
        assert!(positions.len() <= 1000 && positions.contains(&777_777) && positions.contains(&123_456));
        assert!(peaks(&values, 1000).contains(&777_777));
    }

    #[test]
    fn an_interval_without_values_keeps_its_position() {
        let values = vec![f64::NAN; 100];
        assert_eq!(extremes(&[&values], 100, 12).len(), 6);
    }

    proptest! {
        #[test]
        fn global_extremes_are_kept(values in prop::collection::vec(-1e6..1e6f64, 1..500), max_points in 10..100usize) {
            let positions = extremes(&[&values], values.len(), max_points);
            prop_assert!(positions.len() <= max_points);
            prop_assert!(positions.is_sorted_by(|a, b| a < b));
            let of = |positions: &[usize]| {
                let positions = positions.iter().map(|n| values[*n]);
                (positions.clone().fold(f64::MAX, f64::min), positions.fold(f64::MIN, f64::max))
            };
            let all: Vec<usize> = (0..values.len()).collect();
            prop_assert_eq!(of(&positions), of(&all));
            prop_assert_eq!(of(&peaks(&values, max_points)).1, of(&all).1);
            prop_assert!(peaks(&values, max_points).len() <= max_points);
        }
    }
}
