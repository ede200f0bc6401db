//! CUSUM control charts, which detect small deviations that last.
//!
//! One record may deviate by chance; a fault lasts. Each check that a particular kind of fault raises has a
//! cumulative sum over the records (Page 1954): S ← max(0, S + z − k), with z the deviation in standard
//! deviations. A healthy record lowers the sum by k on average. A lasting deviation z > k reaches any level,
//! so ten records at 2 standard deviations count for more than one at 4.

use flankwatch_signal::ByName;
use serde::{Deserialize, Serialize};

/// The allowance k in standard deviations: more than errors of the baseline and slow wear cause.
const ALLOWANCE: f64 = 1.0;

/// Largest deviation of one record that counts, in standard deviations.
const MAX_DEVIATIONS: f64 = 5.0;

/// Upper limit of a sum, so that it falls soon after the fault is gone.
const MAX_SUM: f64 = 15.0;

/// Mean overshoot of a level by sums of normal deviates (Siegmund 1985).
const OVERSHOOT: f64 = 0.583;

/// CUSUMs of one measuring channel by check. A copy through JSON continues with bit-identical results.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Cusums {
    sums: ByName<f64>,
}

impl Cusums {
    /// Adds the deviations of a record's checks, in standard deviations.
    pub(super) fn update<'a>(&mut self, deviations: impl Iterator<Item = (&'a str, f64)>) {
        for (name, z) in deviations {
            let sum = self.sums.get(name).copied().unwrap_or(0.0);
            self.sums.insert(name, (sum + z.min(MAX_DEVIATIONS) - ALLOWANCE).clamp(0.0, MAX_SUM));
        }
    }

    /// Continues the sum of another check as that of this one, unless this one has a sum.
    pub(super) fn continue_as(&mut self, name: &str, is_other: impl Fn(&str) -> bool) {
        if self.sums.contains_key(name) {
            return;
        }
        let other = self.sums.keys().find(|other| is_other(other)).cloned();
        if let Some(sum) = other.and_then(|other| self.sums.remove(&other)) {
            self.sums.insert(name, sum);
        }
    }

    /// Returns the check with the highest sum, and the probability of such a sum on a healthy channel.
    ///
    /// In the steady state, a sum over independent normal deviates has the tail e^(−2k(S + 0.583)).
    pub(super) fn highest(&self) -> Option<(&str, f64)> {
        let (name, sum) =
            self.sums.iter().max_by(|a, b| a.1.total_cmp(b.1)).filter(|(_, sum)| **sum > 0.0)?;
        Some((name, self.p_value(*sum)))
    }

    /// Returns the check with the highest sum among those whose names begin with `kind`, and its probability.
    pub(super) fn highest_of(&self, kind: &str) -> Option<(&str, f64)> {
        let of_kind = self.sums.iter().filter(|(name, _)| name.starts_with(kind));
        let (name, sum) = of_kind.max_by(|a, b| a.1.total_cmp(b.1)).filter(|(_, sum)| **sum > 0.0)?;
        Some((name, self.p_value(*sum)))
    }

    fn p_value(&self, sum: f64) -> f64 {
        let tail = (-2.0 * ALLOWANCE * (sum + OVERSHOOT)).exp();
        (tail * self.sums.len() as f64).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    fn normal(random: &mut ChaCha8Rng) -> f64 {
        StandardNormal.sample(random)
    }

    /// 10⁵ healthy records of four checks: the stated probability is the observed frequency.
    #[test]
    fn healthy_records_pass_a_level_as_often_as_stated() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut cusums = Cusums::default();
        let levels = [1e-1, 1e-2, 1e-3];
        let mut passed = [0_u32; 3];
        for _ in 0..100_000 {
            cusums.update(["a", "b", "c", "d"].into_iter().map(|name| (name, normal(&mut random))));
            if let Some((_, p)) = cusums.highest() {
                for (passed, level) in passed.iter_mut().zip(levels) {
                    *passed += u32::from(p < level);
                }
            }
        }
        for (passed, level) in passed.into_iter().zip(levels) {
            let part = f64::from(passed) / 1e5;
            assert!(part < 1.5 * level && part > 0.2 * level, "{part} below {level}");
        }
    }

    #[test]
    fn a_shift_of_two_deviations_is_detected_within_ten_records_and_cleared_within_thirty() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut seen = 0;
        for _ in 0..200 {
            let mut cusums = Cusums::default();
            for _ in 0..50 {
                cusums.update([("a", normal(&mut random)), ("b", normal(&mut random))].into_iter());
            }
            for _ in 0..10 {
                cusums.update([("a", 2.0 + normal(&mut random)), ("b", normal(&mut random))].into_iter());
            }
            let (name, p) = cusums.highest().unwrap();
            seen += u32::from(name == "a" && p < 1e-4);
            for _ in 0..30 {
                cusums.update([("a", normal(&mut random)), ("b", normal(&mut random))].into_iter());
            }
            assert!(cusums.highest().is_none_or(|(_, p)| p > 1e-4));
        }
        assert!(seen > 180, "{seen} of 200");
    }
}
