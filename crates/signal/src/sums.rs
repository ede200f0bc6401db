//! Sums in interleaved parts: this fills the processor's registers and limits rounding.

/// Number of interleaved parts.
const PARTS: usize = 8;

/// Returns the sum of a function over values.
#[inline(always)]
pub(super) fn sum_of<T>(values: &[T], of: impl Fn(&T) -> f64) -> f64 {
    let (blocks, rest) = values.as_chunks::<PARTS>();
    let mut sums = [0.0; PARTS];
    for block in blocks {
        for (sum, value) in sums.iter_mut().zip(block) {
            *sum += of(value);
        }
    }
    rest.iter().map(of).sum::<f64>() + sums.into_iter().sum::<f64>()
}

/// Returns the mean of a function over values.
#[inline(always)]
pub(super) fn mean_of<T>(values: &[T], of: impl Fn(&T) -> f64) -> f64 {
    sum_of(values, of) / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_any_length_are_complete() {
        for count in 0..40_u32 {
            let values: Vec<u32> = (0..count).collect();
            assert_eq!(
                sum_of(&values, |value| f64::from(2 * value)),
                f64::from(count * count) - f64::from(count)
            );
        }
    }
}
