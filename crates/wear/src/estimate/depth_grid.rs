//! A grid of wear depths with a probability for each.

use super::wear::Posterior;

/// Probability of the interval that is reported with a depth, ...
const INTERVAL_PROBABILITY: f64 = 0.9;

/// ... and the greatest probability of depths below it, and of those above it. With it the intervals contain
/// the truth in 90 % of the records of members that are left out of the estimate.
const MAX_TAIL: f64 = 0.07;

/// Rising wear depths from 0; empty without a library.
#[derive(Debug, Clone, Default)]
pub(super) struct DepthGrid {
    depths_um: Vec<f64>,
}

impl DepthGrid {
    /// Creates the grid of these depths in µm.
    pub(super) fn of(depths_um: &[f64]) -> Self {
        Self { depths_um: depths_um.to_vec() }
    }

    /// Returns the depth in µm that is reported for depth `index` of the ensemble: the last one of this grid
    /// for all beyond it.
    pub(super) fn reported_um(&self, index: usize) -> f64 {
        self.depths_um[index.min(self.depths_um.len() - 1)]
    }

    /// Returns the limits of all cells in µm.
    pub(super) fn cells(&self) -> impl Iterator<Item = [f64; 2]> {
        (0..self.depths_um.len()).map(|point| self.cell_um(point))
    }

    /// Returns the limits of a depth's cell in µm: half-way to its neighbours.
    pub(super) fn cell_um(&self, point: usize) -> [f64; 2] {
        let depths = &self.depths_um;
        let low = if point == 0 { 0.0 } else { 0.5 * (depths[point - 1] + depths[point]) };
        let high =
            if point + 1 == depths.len() { depths[point] } else { 0.5 * (depths[point] + depths[point + 1]) };
        [low, high]
    }

    /// Returns the mean depth in µm.
    pub(super) fn mean_um(&self, probability: &[f64]) -> f64 {
        self.depths_um.iter().zip(probability).map(|(um, p)| um * p).sum()
    }

    /// Returns the quantile at `level` in µm; each point's probability is spread evenly over its cell.
    pub(super) fn quantile_um(&self, probability: &[f64], level: f64) -> f64 {
        let mut below = 0.0;
        for (point, p) in probability.iter().enumerate() {
            // Wear within the first cell cannot be distinguished from none: a low quantile there is 0.
            if point == 0 && *p >= level && level < 0.5 {
                return 0.0;
            }
            if below + p >= level && *p > 0.0 {
                let [low, high] = self.cell_um(point);
                return low + (level - below) / p * (high - low);
            }
            below += p;
        }
        self.depths_um[self.depths_um.len() - 1]
    }

    /// Returns the shortest interval in µm that has [`INTERVAL_PROBABILITY`], with at most [`MAX_TAIL`] on
    /// either side; among equally short ones that with equal tails. If it begins at 0, its end is the 95 %
    /// quantile: little wear hides in a healthy machine's scatter, and the shortest interval would promise
    /// more than is known.
    pub(super) fn interval_um(&self, probability: &[f64]) -> [f64; 2] {
        let tails = 1.0 - INTERVAL_PROBABILITY;
        let (least, most) = (tails - MAX_TAIL, MAX_TAIL);
        let from = |below: f64| {
            [
                self.quantile_um(probability, below),
                self.quantile_um(probability, below + INTERVAL_PROBABILITY),
            ]
        };
        let width = |[low, high]: [f64; 2]| high - low;
        // The density is constant within a cell, so that one end of the shortest interval is the limit of
        // one.
        let mut sum = 0.0;
        let limits = probability.iter().flat_map(|p| {
            sum += p;
            [sum, sum - INTERVAL_PROBABILITY]
        });
        let shortest = [least, most]
            .into_iter()
            .chain(limits)
            .filter(|below| (least..=most).contains(below))
            .map(from)
            .fold(from(0.5 * tails), |best, one| if width(one) < width(best) - 1e-9 { one } else { best });
        match shortest {
            [0.0, _] => [0.0, self.quantile_um(probability, 1.0 - 0.5 * tails)],
            interval => interval,
        }
    }

    /// Returns the probability that wear exceeds a depth in µm.
    pub(super) fn probability_above(&self, probability: &[f64], limit_um: f64) -> f64 {
        let above = |(point, p): (usize, &f64)| {
            let [low, high] = self.cell_um(point);
            let part = if high > low {
                ((high - limit_um) / (high - low)).clamp(0.0, 1.0)
            } else {
                f64::from(u8::from(high > limit_um))
            };
            p * part
        };
        probability.iter().enumerate().map(above).sum()
    }

    /// Returns the distribution as it is published.
    pub(super) fn posterior(&self, probability: &[f64]) -> Posterior {
        Posterior { wear_um: self.depths_um.clone(), probability: probability.to_vec() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sum of a normal density over each cell.
    fn normal(grid: &DepthGrid, mean_um: f64, deviation_um: f64) -> Vec<f64> {
        let density = |um: &f64| (-0.5 * ((um - mean_um) / deviation_um).powi(2)).exp();
        let weights: Vec<f64> = grid
            .depths_um
            .iter()
            .zip(grid.cells())
            .map(|(um, [low, high])| density(um) * (high - low))
            .collect();
        let total: f64 = weights.iter().sum();
        weights.iter().map(|weight| weight / total).collect()
    }

    #[test]
    fn the_interval_is_the_shortest_one() {
        let grid = DepthGrid::of(&(0..=490).map(|k| 0.5 * f64::from(k)).collect::<Vec<_>>());
        // Symmetric: equal tails, 1.645 standard deviations.
        let [low, high] = grid.interval_um(&normal(&grid, 120.0, 10.0));
        assert!((low - 103.55).abs() < 0.3 && (high - 136.45).abs() < 0.3, "{low} {high}");
        // Cut off by the end of the library: from the quantile 7 % on.
        let half = normal(&grid, 245.0, 10.0);
        let [low, high] = grid.interval_um(&half);
        assert!((low - (245.0 - 18.12)).abs() < 0.3 && high > 244.0, "{low} {high}");
        assert!((grid.probability_above(&half, low) - (1.0 - MAX_TAIL)).abs() < 1e-9);
        // Mixed 0.95 to 0.05: the smaller part is left out.
        let mixed: Vec<f64> = normal(&grid, 60.0, 5.0)
            .iter()
            .zip(normal(&grid, 200.0, 5.0))
            .map(|(one, other)| 0.95 * one + 0.05 * other)
            .collect();
        let [low, high] = grid.interval_um(&mixed);
        assert!(low > 45.0 && high < 80.0, "{low} {high}");
        let inside = grid.probability_above(&mixed, low) - grid.probability_above(&mixed, high);
        assert!((inside - INTERVAL_PROBABILITY).abs() < 1e-9, "{inside}");
    }

    #[test]
    fn an_interval_from_zero_ends_at_the_95_percent_quantile() {
        let grid = DepthGrid::of(&[0.0, 1.0, 2.0, 3.0, 4.0]);
        let probability = [0.5, 0.3, 0.12, 0.05, 0.03];
        let interval = grid.interval_um(&probability);
        assert_eq!(interval, [0.0, grid.quantile_um(&probability, 0.95)]);
    }

    #[test]
    fn of_equally_short_intervals_that_with_equal_tails_is_taken() {
        // Flat from 5 to 45 µm.
        let grid = DepthGrid::of(&[0.0, 10.0, 20.0, 30.0, 40.0, 50.0]);
        let [low, high] = grid.interval_um(&[0.0, 0.25, 0.25, 0.25, 0.25, 0.0]);
        assert!((low - 7.0).abs() < 1e-9 && (high - 43.0).abs() < 1e-9, "{low} {high}");
    }

    #[test]
    fn quantiles_of_a_flat_density_are_the_closed_form() {
        let grid = DepthGrid::of(&(0..50).map(|i| 5.0 * f64::from(i)).collect::<Vec<_>>());
        let flat: Vec<f64> = grid.cells().map(|[low, high]| (high - low) / 245.0).collect();
        assert_eq!(grid.quantile_um(&flat, 0.001), 0.0);
        for level in [0.05, 0.5, 0.95] {
            assert!((grid.quantile_um(&flat, level) - 245.0 * level).abs() < 1e-9);
            assert!((grid.probability_above(&flat, 245.0 * level) - (1.0 - level)).abs() < 1e-9);
        }
    }
}
