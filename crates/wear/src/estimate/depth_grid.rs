//! The grid of wear depths on which probabilities are tracked.

use super::wear::Posterior;

/// Rising wear depths from 0 to a library's last state; empty without a library.
#[derive(Debug, Clone, Default)]
pub(super) struct DepthGrid {
    depths_um: Vec<f64>,
}

impl DepthGrid {
    /// Creates the grid of these depths in µm.
    pub(super) fn of(depths_um: &[f64]) -> Self {
        Self { depths_um: depths_um.to_vec() }
    }

    /// Returns the depths in µm.
    pub(super) fn depths_um(&self) -> &[f64] {
        &self.depths_um
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

    #[test]
    fn quantiles_of_a_flat_density_are_the_closed_form() {
        let grid = DepthGrid::of(&(0..50).map(|i| 5.0 * f64::from(i)).collect::<Vec<_>>());
        let flat: Vec<f64> = (0..grid.depths_um().len())
            .map(|i| {
                let [low, high] = grid.cell_um(i);
                (high - low) / 245.0
            })
            .collect();
        assert_eq!(grid.quantile_um(&flat, 0.001), 0.0);
        for level in [0.05, 0.5, 0.95] {
            assert!((grid.quantile_um(&flat, level) - 245.0 * level).abs() < 1e-9);
            assert!((grid.probability_above(&flat, 245.0 * level) - (1.0 - level)).abs() < 1e-9);
        }
    }
}
