//! Fewer points that look the same: reductions that never hide an extreme value.

use std::ops::Range;

/// Positions of at most about `most` entries of parallel columns of `length` entries: the first and the last
/// one, and in each of equal stretches the least and the greatest of every column. All positions where there
/// are no more than `most`.
///
/// NaN stands for no value; a stretch without any value keeps its first position. At least two positions for
/// each column are kept.
pub fn extremes(columns: &[&[f64]], length: usize, most: usize) -> Vec<usize> {
    if length <= most {
        return (0..length).collect();
    }
    let stretches = (most.saturating_sub(2) / (2 * columns.len().max(1))).max(1);
    let mut kept = vec![0, length - 1];
    for stretch in split(length, stretches) {
        let before = kept.len();
        for column in columns {
            let with_values = stretch.clone().filter(|n| column[*n].is_finite());
            let by_value = |a: &usize, b: &usize| column[*a].total_cmp(&column[*b]);
            kept.extend(with_values.clone().min_by(by_value));
            kept.extend(with_values.max_by(by_value));
        }
        if kept.len() == before {
            kept.push(stretch.start);
        }
    }
    kept.sort_unstable();
    kept.dedup();
    kept
}

/// Positions of at most `most` entries: the greatest in each of equal stretches. All positions where there
/// are no more.
pub fn peaks(values: &[f64], most: usize) -> Vec<usize> {
    if values.len() <= most {
        return (0..values.len()).collect();
    }
    split(values.len(), most)
        .filter_map(|stretch| stretch.max_by(|a, b| values[*a].total_cmp(&values[*b])))
        .collect()
}

/// `length` entries in `parts` stretches, none empty where there are enough entries.
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
        let kept = extremes(&[&values], values.len(), 1000);
        assert!(kept.len() <= 1000 && kept.contains(&777_777) && kept.contains(&123_456));
        assert!(peaks(&values, 1000).contains(&777_777));
    }

    #[test]
    fn a_stretch_without_values_keeps_its_place() {
        let values = vec![f64::NAN; 100];
        assert_eq!(extremes(&[&values], 100, 12).len(), 6);
    }

    proptest! {
        #[test]
        fn extremes_of_the_whole_are_among_the_kept(values in prop::collection::vec(-1e6..1e6f64, 1..500), most in 10..100usize) {
            let kept = extremes(&[&values], values.len(), most);
            prop_assert!(kept.len() <= most);
            prop_assert!(kept.is_sorted_by(|a, b| a < b));
            let of = |positions: &[usize]| {
                let kept = positions.iter().map(|n| values[*n]);
                (kept.clone().fold(f64::MAX, f64::min), kept.fold(f64::MIN, f64::max))
            };
            let all: Vec<usize> = (0..values.len()).collect();
            prop_assert_eq!(of(&kept), of(&all));
            prop_assert_eq!(of(&peaks(&values, most)).1, of(&all).1);
            prop_assert!(peaks(&values, most).len() <= most);
        }
    }
}
