//! The grid of wear depths that probabilities are tracked on.

use super::wear::Posterior;
use crate::library::Library;

/// Cells of the grid to one interval of library states.
const REFINEMENT: usize = 4;

/// Mean of the exponential prior on wear when the baseline is complete, in µm: the baseline is taken to be healthy, not perfect.
const PRIOR_WEAR_UM: f64 = 3.0;

/// Equally spaced wear depths from 0 to a library's last state; empty where there is no library.
#[derive(Debug, Clone, Default)]
pub(super) struct DepthGrid {
    depths_um: Vec<f64>,
}

impl DepthGrid {
    /// The grid of a library, which has at least two states.
    pub(super) fn of(library: &Library) -> Self {
        let intervals = (library.states().len() - 1) * REFINEMENT;
        let depth_um = |i| library.max_wear_um() * i as f64 / intervals as f64;
        Self {
            depths_um: (0..=intervals).map(depth_um).collect(),
        }
    }

    /// The depths in µm.
    pub(super) fn depths_um(&self) -> &[f64] {
        &self.depths_um
    }

    /// The distance of two depths in µm.
    pub(super) fn step_um(&self) -> f64 {
        self.depths_um[1] - self.depths_um[0]
    }

    /// What is believed when the baseline is complete.
    pub(super) fn prior(&self) -> Vec<f64> {
        let weights: Vec<f64> = self.depths_um.iter().map(|um| (-um / PRIOR_WEAR_UM).exp()).collect();
        let total: f64 = weights.iter().sum();
        weights.iter().map(|weight| weight / total).collect()
    }

    /// Mean depth in µm.
    pub(super) fn mean_um(&self, probability: &[f64]) -> f64 {
        self.depths_um.iter().zip(probability).map(|(um, p)| um * p).sum()
    }

    /// The depth in µm below which a part `level` of the probability lies; each point's probability is spread over its cell.
    pub(super) fn quantile_um(&self, probability: &[f64], level: f64) -> f64 {
        let deepest = self.depths_um[self.depths_um.len() - 1];
        let mut below = 0.0;
        for (um, p) in self.depths_um.iter().zip(probability) {
            if below + p >= level && *p > 0.0 {
                let part = (level - below) / p;
                return (um + (part - 0.5) * self.step_um()).clamp(0.0, deepest);
            }
            below += p;
        }
        deepest
    }

    /// The library state nearest to a point of the grid.
    pub(super) fn nearest_state(point: usize) -> usize {
        (point + REFINEMENT / 2) / REFINEMENT
    }

    /// The probability gathered at the nearest library states.
    pub(super) fn by_library_state(library: &Library, probability: &[f64]) -> Posterior {
        let wear_um: Vec<f64> = library.states().iter().map(|state| state.wear_um).collect();
        let mut gathered = vec![0.0; wear_um.len()];
        for (point, p) in probability.iter().enumerate() {
            gathered[Self::nearest_state(point)] += p;
        }
        Posterior {
            wear_um,
            probability: gathered,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_a_flat_posterior_are_the_closed_form() {
        let grid = DepthGrid {
            depths_um: (0..=100).map(f64::from).collect(),
        };
        let flat = vec![1.0 / 101.0; 101];
        // Cells reach from −0.5 to 100.5, so the quantile of level q is 101·q − 0.5.
        for level in [0.05, 0.5, 0.95] {
            assert!((grid.quantile_um(&flat, level) - (101.0 * level - 0.5)).abs() < 1e-9);
        }
        assert!((grid.mean_um(&flat) - 50.0).abs() < 1e-9);
    }
}
