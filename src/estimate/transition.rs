//! How wear may grow between two records: never down, at a rate that is not known.

/// Mean growth between records in µm and its prior weight: from next to nothing to a gear that fails within an hour.
const RATES_UM: [(f64, f64); 4] = [(0.05, 0.35), (0.5, 0.35), (3.0, 0.2), (15.0, 0.1)];

/// Growth over one interval of running on a grid of depths.
#[derive(Debug, Clone, Default)]
pub(super) struct Growth {
    /// For each rate its weight, and for each depth the part that moves on to the next.
    moving: Vec<(f64, Vec<f64>)>,
}

impl Growth {
    /// Growth is a mixture of geometric distributions (the discrete exponential), so that small steps are likely and large ones
    /// possible; the mean is the rate's whatever the grid's steps.
    pub(super) fn on(depths_um: &[f64]) -> Self {
        let parts = |mean_um: f64| {
            let part = |steps: &[f64]| mean_um / (mean_um + steps[1] - steps[0]);
            // What would pass the end of the grid stays at its end.
            depths_um.windows(2).map(part).chain([0.0]).collect()
        };
        Self {
            moving: RATES_UM.iter().map(|&(mean_um, weight)| (weight, parts(mean_um))).collect(),
        }
    }

    /// Probability over depths after one more interval of running.
    pub(super) fn advance(&self, probability: &[f64], advanced: &mut [f64]) {
        advanced.fill(0.0);
        for (weight, parts) in &self.moving {
            let mut moving = 0.0;
            for ((p, part), out) in probability.iter().zip(parts).zip(advanced.iter_mut()) {
                moving += p;
                *out += weight * (1.0 - part) * moving;
                moving *= part;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn advance(depths_um: &[f64], start: &[f64]) -> Vec<f64> {
        let mut advanced = vec![0.0; start.len()];
        Growth::on(depths_um).advance(start, &mut advanced);
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
            let expected: f64 = RATES_UM.iter().map(|(rate, weight)| rate * weight).sum();
            assert!((mean - expected).abs() < 1e-9, "{mean} against {expected}");
        }
    }
}
