//! The grid of wear depths that probabilities are tracked on.

use super::wear::Posterior;

/// Up to this depth in µm the grid is fine: wear of the size of the teeth's deflection changes the vibration fastest.
const FINE_UP_TO_UM: f64 = 30.0;

/// Steps below and above it in µm.
const FINE_STEP_UM: f64 = 1.5;
const COARSE_STEP_UM: f64 = 3.0;

/// Rising wear depths from 0 to a library's last state; empty where there is no library.
#[derive(Debug, Clone, Default)]
pub(super) struct DepthGrid {
    depths_um: Vec<f64>,
}

impl DepthGrid {
    /// The grid up to a greatest depth in µm.
    pub(super) fn up_to(max_wear_um: f64) -> Self {
        let fine_end = FINE_UP_TO_UM.min(max_wear_um);
        let fine = (fine_end / FINE_STEP_UM).round().max(1.0) as usize;
        let coarse = ((max_wear_um - fine_end) / COARSE_STEP_UM).ceil() as usize;
        let mut depths_um: Vec<f64> = (0..=fine).map(|i| fine_end * i as f64 / fine as f64).collect();
        depths_um.extend((1..=coarse).map(|i| fine_end + (max_wear_um - fine_end) * i as f64 / coarse as f64));
        Self { depths_um }
    }

    /// The depths in µm.
    pub(super) fn depths_um(&self) -> &[f64] {
        &self.depths_um
    }

    /// The ends of a depth's cell: half way to its neighbours.
    fn cell_um(&self, point: usize) -> [f64; 2] {
        let depths = &self.depths_um;
        let low = if point == 0 {
            0.0
        } else {
            0.5 * (depths[point - 1] + depths[point])
        };
        let high = if point + 1 == depths.len() {
            depths[point]
        } else {
            0.5 * (depths[point] + depths[point + 1])
        };
        [low, high]
    }

    /// Probability falling as an exponential of this mean in µm around a depth.
    pub(super) fn around(&self, centre_um: f64, mean_um: f64) -> Vec<f64> {
        let weight = |point: usize| {
            let [low, high] = self.cell_um(point);
            (high - low) * (-(self.depths_um[point] - centre_um).abs() / mean_um).exp()
        };
        let weights: Vec<f64> = (0..self.depths_um.len()).map(weight).collect();
        let total: f64 = weights.iter().sum();
        weights.iter().map(|weight| weight / total).collect()
    }

    /// Mean depth in µm.
    pub(super) fn mean_um(&self, probability: &[f64]) -> f64 {
        self.depths_um.iter().zip(probability).map(|(um, p)| um * p).sum()
    }

    /// The depth in µm below which a part `level` of the probability lies; each point's probability is spread over its cell.
    pub(super) fn quantile_um(&self, probability: &[f64], level: f64) -> f64 {
        let mut below = 0.0;
        for (point, p) in probability.iter().enumerate() {
            // What lies in the first cell is not told from no wear: the low end of an interval is 0 there.
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

    /// The probability that a depth in µm is passed.
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

    /// The distribution as it is handed out.
    pub(super) fn posterior(&self, probability: &[f64]) -> Posterior {
        Posterior {
            wear_um: self.depths_um.clone(),
            probability: probability.to_vec(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_is_fine_where_the_vibration_changes_fast() {
        let grid = DepthGrid::up_to(245.0);
        let depths = grid.depths_um();
        assert_eq!((depths[0], depths[1], depths[20], depths[92]), (0.0, 1.5, 30.0, 245.0));
        assert!((depths[21] - 30.0 - 215.0 / 72.0).abs() < 1e-9);
        assert_eq!(DepthGrid::up_to(12.0).depths_um().len(), 9);
    }

    #[test]
    fn quantiles_of_a_flat_density_are_the_closed_form() {
        let grid = DepthGrid::up_to(245.0);
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

    #[test]
    fn what_lies_around_a_depth_has_it_as_its_median() {
        let grid = DepthGrid::up_to(245.0);
        let around = grid.around(120.0, 10.0);
        assert!((around.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!((grid.quantile_um(&around, 0.5) - 120.0).abs() < 1.0);
        // An exponential to both sides leaves e⁻² beyond twice its mean.
        assert!((grid.probability_above(&around, 140.0) - 0.5 * (-2.0f64).exp()).abs() < 0.02);
    }
}
