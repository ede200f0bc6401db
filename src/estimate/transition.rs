//! How wear may grow between two records: never down, at a rate that is not known.

/// Mean growth between records in µm and its prior weight: from next to nothing to a gear that fails within an hour.
const RATES_UM: [(f64, f64); 4] = [(0.05, 0.35), (0.5, 0.35), (3.0, 0.2), (15.0, 0.1)];

/// Probability over wear depths after one more interval of running.
///
/// Growth is a mixture of geometric distributions on the grid (the discrete exponential), so that small steps are likely
/// and large ones possible; what would pass the end of the grid stays at its end.
pub(super) fn advance(probability: &[f64], step_um: f64) -> Vec<f64> {
    let mut advanced = vec![0.0; probability.len()];
    for (mean_um, weight) in RATES_UM {
        let mean_steps = mean_um / step_um;
        let ratio = mean_steps / (1.0 + mean_steps);
        let last = probability.len() - 1;
        let mut moving = 0.0;
        for (i, p) in probability.iter().enumerate() {
            moving = ratio * moving + p;
            let stays = if i == last { moving } else { (1.0 - ratio) * moving };
            advanced[i] += weight * stays;
        }
    }
    advanced
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_lost_and_nothing_heals() {
        let mut start = vec![0.0; 50];
        start[10] = 0.25;
        start[48] = 0.75;
        let advanced = advance(&start, 1.0);
        assert!((advanced.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(advanced[..10].iter().all(|&p| p == 0.0));
    }

    #[test]
    fn the_mean_grows_by_the_mixture_mean() {
        let mut start = vec![0.0; 2000];
        start[0] = 1.0;
        let mean: f64 = advance(&start, 1.0).iter().enumerate().map(|(i, p)| i as f64 * p).sum();
        // Mixture mean: Σ weight × rate.
        let expected: f64 = RATES_UM.iter().map(|(rate, weight)| rate * weight).sum();
        assert!((mean - expected).abs() < 1e-9, "{mean} against {expected}");
    }
}
