//! Root of a function between two points of opposite sign.

/// A root of `f` in `[low, high]` to within `tolerance`, by the ITP method (Oliveira and Takahashi, ACM
/// Trans. Math. Softw. 47, 2020): superlinear on smooth functions, never more than one step behind bisection.
///
/// `at_low` and `at_high` are the values of `f` at the ends and have opposite signs (or one is zero).
pub(super) fn find(
    f: impl Fn(f64) -> f64,
    (low, at_low): (f64, f64),
    (high, at_high): (f64, f64),
    tolerance: f64,
) -> f64 {
    if at_low == 0.0 {
        return low;
    }
    if at_high == 0.0 {
        return high;
    }
    let rising = if at_high > 0.0 { 1.0 } else { -1.0 };
    let (mut a, mut b, mut fa, mut fb) = (low, high, rising * at_low, rising * at_high);
    let k1 = 0.2 / (b - a);
    let steps = ((b - a) / (2.0 * tolerance)).log2().ceil().max(0.0) as i32 + 1;
    for step in 0..=steps {
        if b - a <= 2.0 * tolerance {
            break;
        }
        let half = 0.5 * (a + b);
        let radius = tolerance * 2.0_f64.powi(steps - step) - 0.5 * (b - a);
        let secant = (fb * a - fa * b) / (fb - fa);
        let sign = (half - secant).signum();
        let shift = k1 * (b - a).powi(2);
        let truncated = if shift <= (half - secant).abs() { secant + sign * shift } else { half };
        let projected = if (truncated - half).abs() <= radius { truncated } else { half - sign * radius };
        let value = rising * f(projected);
        if value > 0.0 {
            (b, fb) = (projected, value);
        } else if value < 0.0 {
            (a, fa) = (projected, value);
        } else {
            return projected;
        }
    }
    0.5 * (a + b)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::find;

    #[test]
    fn finds_roots_known_in_closed_form() {
        type Function = fn(f64) -> f64;
        let cases: [(Function, f64, f64, f64); 4] = [
            (|x| x * x - 2.0, 0.0, 2.0, 2.0_f64.sqrt()),
            (|x| 1.0 - x.exp(), -3.0, 2.5, 0.0),
            (|x| (x - 0.7).powi(3), -1.0, 4.0, 0.7),
            (|x| if x < 0.3 { -1.0 } else { 1.0 }, 0.0, 1.0, 0.3),
        ];
        for (f, low, high, root) in cases {
            let found = find(f, (low, f(low)), (high, f(high)), 1e-12);
            assert!((found - root).abs() <= 2e-12, "{found} for {root}");
        }
    }

    #[test]
    fn is_far_quicker_than_bisection_on_a_smooth_function() {
        let count = Cell::new(0);
        let f = |x: f64| {
            count.set(count.get() + 1);
            x.exp() - 1.5
        };
        find(f, (0.0, -0.5), (1.0, 1.0_f64.exp() - 1.5), 1e-13);
        assert!(count.get() <= 12, "{} evaluations; bisection takes 43", count.get());
    }
}
