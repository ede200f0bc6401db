//! How wear may grow between two records: never down, at a rate that is not known.

use serde::{Deserialize, Serialize};

/// Mean growth between records in µm: from next to nothing to a gear that fails within an hour.
const RATES_UM: [f64; RATES] = [0.05, 0.5, 1.5, 10.0];

/// How many rates there are.
const RATES: usize = 4;

/// Their prior weights.
const PRIOR: [f64; RATES] = [0.3, 0.4, 0.2, 0.1];

/// Part of what was learnt of the rate that the next record leaves: wear may begin to grow faster.
const MEMORY: f64 = 0.95;

/// What each rate is believed to be worth by now.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct RateWeights([f64; RATES]);

impl Default for RateWeights {
    fn default() -> Self {
        Self(PRIOR)
    }
}

impl RateWeights {
    /// Weighs the rates by the likelihood of a record after growth at each.
    fn learn(&mut self, likelihood: [f64; RATES]) {
        let mut weights = [0.0; RATES];
        for (rate, weight) in weights.iter_mut().enumerate() {
            *weight = self.0[rate].powf(MEMORY) * PRIOR[rate].powf(1.0 - MEMORY) * likelihood[rate].max(1e-300);
        }
        let total: f64 = weights.iter().sum();
        self.0 = weights.map(|weight| weight / total);
    }
}

/// Growth over one interval of running on a grid of depths.
#[derive(Debug, Clone, Default)]
pub(super) struct Growth {
    /// For each rate and depth the part that moves on to the next.
    moving: Vec<Vec<f64>>,
}

impl Growth {
    /// Growth at each rate is geometric (the discrete exponential), so that small steps are likely and large ones
    /// possible; the mean is the rate's whatever the grid's steps.
    pub(super) fn on(depths_um: &[f64]) -> Self {
        let parts = |mean_um: f64| {
            let part = |steps: &[f64]| mean_um / (mean_um + steps[1] - steps[0]);
            // What would pass the end of the grid stays at its end.
            depths_um.windows(2).map(part).chain([0.0]).collect()
        };
        Self {
            moving: RATES_UM.map(parts).into(),
        }
    }

    /// Probability over depths after one more interval of running.
    pub(super) fn advance(&self, weights: &RateWeights, probability: &[f64], advanced: &mut [f64]) {
        advanced.fill(0.0);
        for (parts, weight) in self.moving.iter().zip(weights.0) {
            grow(parts, probability, |depth, p| advanced[depth] += weight * p);
        }
    }

    /// Learns from a record what the rate is: `likelihood` by depth, `probability` before the record's interval.
    pub(super) fn learn(&self, weights: &mut RateWeights, probability: &[f64], likelihood: &[f64]) {
        let mut of_rate = [0.0; RATES];
        for (parts, sum) in self.moving.iter().zip(&mut of_rate) {
            grow(parts, probability, |depth, p| *sum += p * likelihood[depth]);
        }
        weights.learn(of_rate);
    }
}

fn grow(parts: &[f64], probability: &[f64], mut put: impl FnMut(usize, f64)) {
    let mut moving = 0.0;
    for (depth, (p, part)) in probability.iter().zip(parts).enumerate() {
        moving += p;
        put(depth, (1.0 - part) * moving);
        moving *= part;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn advance(depths_um: &[f64], start: &[f64]) -> Vec<f64> {
        let mut advanced = vec![0.0; start.len()];
        Growth::on(depths_um).advance(&RateWeights::default(), start, &mut advanced);
        advanced
    }

    #[test]
    fn nothing_is_lost_and_nothing_heals() {
        let depths: Vec<f64> = (0..50).map(|i| f64::from(i * i)).collect();
        let mut start = vec![0.0; 50];
        start[10] = 0.25;
        start[48] = 0.75;
        let advanced = advance(&depths, &start);
        assert!((advanced.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(advanced[..10].iter().all(|&p| p == 0.0));
    }

    #[test]
    fn the_mean_grows_by_the_mixture_mean() {
        for step in [0.5, 1.0, 5.0] {
            let depths: Vec<f64> = (0..2000).map(|i| step * f64::from(i)).collect();
            let mut start = vec![0.0; 2000];
            start[0] = 1.0;
            let mean: f64 = advance(&depths, &start).iter().zip(&depths).map(|(p, um)| um * p).sum();
            // Mixture mean: Σ weight × rate.
            let expected: f64 = RATES_UM.iter().zip(PRIOR).map(|(rate, weight)| rate * weight).sum();
            assert!((mean - expected).abs() < 1e-9, "{mean} against {expected}");
        }
    }
}
