//! Ranges and linearity of sequences.

/// Greatest minus least value.
pub(super) fn range(values: &[f64]) -> f64 {
    let (least, most) = limits(values);
    most - least
}

/// Least and greatest value.
pub(super) fn limits(values: &[f64]) -> (f64, f64) {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (least, most)
}

/// Greatest distance of y from its least-squares line over x, as a part of y's range.
pub(super) fn departure_from_a_line(x: &[f64], y: &[f64]) -> f64 {
    let count = x.len() as f64;
    let (mean_x, mean_y) = (x.iter().sum::<f64>() / count, y.iter().sum::<f64>() / count);
    let products: f64 = x.iter().zip(y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let squares: f64 = x.iter().map(|x| (x - mean_x).powi(2)).sum();
    let slope = products / squares;
    let departures = x.iter().zip(y).map(|(x, y)| (y - mean_y - slope * (x - mean_x)).abs());
    departures.fold(0.0, f64::max) / range(y)
}

/// Interpolates y linearly at `at`; x need not rise. The greatest of several branches, `None` outside.
pub(super) fn highest_at(x: &[f64], y: &[f64], at: f64) -> Option<f64> {
    x.windows(2)
        .zip(y.windows(2))
        .filter(|(x, _)| x[0] <= at && at <= x[1] && x[0] < x[1])
        .map(|(x, y)| y[0] + (at - x[0]) / (x[1] - x[0]) * (y[1] - y[0]))
        .max_by(f64::total_cmp)
}

/// Whether each value is above the one before it.
pub(super) fn rises(values: &[f64]) -> bool {
    values.windows(2).all(|two| two[1] > two[0])
}

/// Whether each value is below the one before it.
pub(super) fn falls(values: &[f64]) -> bool {
    values.windows(2).all(|two| two[1] < two[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_departs_from_its_line_by_its_closed_form() {
        // y = x² on [0, 1] about x − 1/6: by 1/6 at the ends.
        let x: Vec<f64> = (0..=10_000).map(|i| f64::from(i) / 1e4).collect();
        let y: Vec<f64> = x.iter().map(|x| x * x).collect();
        assert!((departure_from_a_line(&x, &y) - 1.0 / 6.0).abs() < 1e-3);
        assert!(departure_from_a_line(&x, &x) < 1e-14);
    }

    #[test]
    fn the_highest_of_several_branches_is_returned() {
        let (x, y) = ([0.0, 2.0, 1.0, 3.0], [0.0, 2.0, 1.0, 7.0]);
        assert_eq!(highest_at(&x, &y, 1.5), Some(2.5));
        assert_eq!(highest_at(&x, &y, 3.5), None);
    }
}
