//! Control charts: small deviations that last.
//!
//! One record deviates by chance; a fault stays. For each check that faults of their own kind raise, a
//! cumulative sum (Page 1954) folds over the records: S ← max(0, S + z − k), z the deviation in standard
//! deviations. What is healthy pulls it down by k a record; what lasts at z > k reaches any level, so that
//! ten records of 2 standard deviations say more than one of 4.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// What a record has to deviate by to count, in standard deviations: above what errors of the baseline and
/// slow wear leave.
const ALLOWANCE: f64 = 1.0;

/// One record counts for no more than this.
const MAX_DEVIATIONS: f64 = 5.0;

/// A sum stays below this, so that it comes down soon after the fault is gone.
const MAX_SUM: f64 = 15.0;

/// How far sums of normal deviates overshoot a level on average (Siegmund 1985).
const OVERSHOOT: f64 = 0.583;

/// Sums of one measuring channel; an exact copy in JSON goes on with the same bits.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Cusums {
    sums: BTreeMap<String, f64>,
}

impl Cusums {
    /// Takes the deviations of a record's checks, in standard deviations.
    pub(super) fn update<'a>(&mut self, deviations: impl Iterator<Item = (&'a str, f64)>) {
        for (name, z) in deviations {
            let sum = self.sums.entry(name.to_owned()).or_insert(0.0);
            *sum = (*sum + z.min(MAX_DEVIATIONS) - ALLOWANCE).clamp(0.0, MAX_SUM);
        }
    }

    /// The check whose sum is highest, and the probability that the highest of healthy sums stands there or
    /// above.
    ///
    /// The sum of independent normal deviates less k has a tail of e^(−2k(S + 0.583)) where it has gone on
    /// for long.
    pub(super) fn highest(&self) -> Option<(&str, f64)> {
        let (name, sum) =
            self.sums.iter().max_by(|a, b| a.1.total_cmp(b.1)).filter(|(_, sum)| **sum > 0.0)?;
        Some((name, self.p_value(*sum)))
    }

    /// The highest sum of the checks whose names begin with `kind`, and its probability.
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

    /// 10⁵ healthy records of four checks: the probability told is that of what happens.
    #[test]
    fn healthy_records_pass_a_level_as_often_as_is_told() {
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
    fn two_deviations_that_last_are_seen_within_ten_records_and_forgotten_within_thirty() {
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
