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

/// Takes weight from depths below what was known before: wear never heals.
///
/// Where less than `tail` of the earlier probability lies at or below a depth, its weight falls in that proportion. The body of
/// the distribution stays as it is, so that noise does not push the estimate up record by record.
pub(super) fn never_heals(weights: &mut [f64], before: &[f64], tail: f64) {
    let mut at_or_below = 0.0;
    for (weight, p) in weights.iter_mut().zip(before) {
        at_or_below += p;
        if at_or_below >= tail {
            return;
        }
        *weight *= at_or_below / tail;
    }
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
    fn depths_below_the_earlier_tail_lose_weight_and_others_do_not() {
        let mut weights = vec![1.0; 4];
        never_heals(&mut weights, &[0.0, 0.125, 0.125, 0.75], 0.25);
        assert_eq!(weights, [0.0, 0.5, 1.0, 1.0]);
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
