//! Spearman's rank correlation.

/// Spearman's rank correlation; `None` for fewer than 8 pairs.
pub(crate) fn rank_correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    if pairs.len() < 8 {
        return None;
    }
    let ranks = |value: &dyn Fn(&(f64, f64)) -> f64| {
        let mut order: Vec<usize> = (0..pairs.len()).collect();
        order.sort_by(|&a, &b| value(&pairs[a]).total_cmp(&value(&pairs[b])));
        let mut ranks = vec![0.0; pairs.len()];
        let mut first = 0;
        while first < order.len() {
            let same = order[first..]
                .iter()
                .take_while(|&&i| value(&pairs[i]) == value(&pairs[order[first]]))
                .count();
            for &i in &order[first..first + same] {
                ranks[i] = first as f64 + 0.5 * (same - 1) as f64;
            }
            first += same;
        }
        ranks
    };
    let (x, y) = (ranks(&|pair| pair.0), ranks(&|pair| pair.1));
    let mean = 0.5 * (pairs.len() - 1) as f64;
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>();
    let scale = (product(&x, &x) * product(&y, &y)).sqrt();
    Some(if scale > 0.0 { product(&x, &y) / scale } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXPECTED: f64 = 0.8734939759036143;

    /// SciPy: spearmanr([1, 2, 2, 3, 4, 5, 6, 7], [2, 1, 3, 3, 7, 5, 6, 9]).
    #[test]
    fn rank_correlation_is_scipys() {
        let x = [1.0, 2.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
        let y = [2.0, 1.0, 3.0, 3.0, 7.0, 5.0, 6.0, 9.0];
        let pairs: Vec<(f64, f64)> = x.into_iter().zip(y).collect();
        assert!(
            (rank_correlation(&pairs).unwrap() - EXPECTED).abs() < 1e-9,
            "{:?}",
            rank_correlation(&pairs)
        );
        assert_eq!(rank_correlation(&pairs[..5]), None);
    }
}
