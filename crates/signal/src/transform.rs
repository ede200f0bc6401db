//! Fourier transforms of real data, with cached plans and buffers.

use std::sync::Arc;

use flankwatch_fourier::{Complex, ComplexToReal, Fft, FftDirection, Planned, RealToComplex};

use super::comb::HARMONICS;

/// Number of cached plans per direction. Records of one asset share a length, so a few suffice; without a
/// limit, a stream of different lengths would grow memory forever.
const MAX_PLANS: usize = 8;

/// Records up to this length are transformed at their exact length, whatever its factors: even a prime costs
/// little here.
const ALWAYS_EXACT: usize = 1 << 14;

/// Returns how many samples of a record its spectra are computed from: all of them if the length is at most
/// 16 384 or has no prime factor above 13, otherwise the longest even leading part whose length has none
/// above 11.
///
/// A prime length costs as much as a dozen transforms of a smooth one. Omitting the tail, at most 1.6 % of
/// the record, changes only the resolution, by that much: there is no padding, and amplitudes keep their
/// meaning.
pub(super) fn spectrum_length(samples: usize) -> usize {
    if samples <= ALWAYS_EXACT || is_smooth(samples, &[2, 3, 5, 7, 11, 13]) {
        return samples;
    }
    // Such a length is at least 0.984 of any number in this range, so the search is short.
    let mut length = samples - samples % 2;
    while !is_smooth(length, &[2, 3, 5, 7, 11]) {
        length -= 2;
    }
    length
}

/// Returns whether a number has only these prime factors.
pub(super) fn is_smooth(mut number: usize, primes: &[usize]) -> bool {
    for prime in primes {
        while number.is_multiple_of(*prime) {
            number /= prime;
        }
    }
    number == 1
}

/// Returns the smallest number from `min` on that has only these prime factors.
pub(super) fn smooth_at_least(min: usize, primes: &[usize]) -> usize {
    (min..).find(|number| is_smooth(*number, primes)).unwrap_or(min)
}

/// Number of cached buffers of each type: two for each harmonic that is tracked, and some more.
const MAX_BUFFERS: usize = 2 * HARMONICS + 4;

/// A floating-point type in which records are transformed.
pub(super) trait Float: Planned + Default {
    /// The nearest number of this type.
    fn rounded(value: f64) -> Self;
}

impl Float for f32 {
    fn rounded(value: f64) -> Self {
        value as Self
    }
}

impl Float for f64 {
    fn rounded(value: f64) -> Self {
        value
    }
}

/// Transform plans, most recently used first, and reusable buffers.
pub(super) struct Transforms<T = f64> {
    max_plans: usize,
    forward: Vec<Arc<dyn RealToComplex<T>>>,
    inverse: Vec<Arc<dyn ComplexToReal<T>>>,
    complex: Vec<Arc<dyn Fft<T>>>,
    scratch: Vec<Complex<T>>,
    real_buffers: Vec<Vec<T>>,
    complex_buffers: Vec<Vec<Complex<T>>>,
}

impl<T: Float> Default for Transforms<T> {
    fn default() -> Self {
        Self::with_max_plans(MAX_PLANS)
    }
}

impl<T: Float> Transforms<T> {
    /// Creates a cache of up to `max_plans` plans per direction.
    pub(super) fn with_max_plans(max_plans: usize) -> Self {
        Self {
            max_plans,
            forward: Vec::with_capacity(max_plans),
            inverse: Vec::with_capacity(max_plans),
            complex: Vec::with_capacity(2 * max_plans),
            scratch: Vec::new(),
            real_buffers: Vec::new(),
            complex_buffers: Vec::new(),
        }
    }

    /// Returns an empty buffer for real numbers, with the memory of a [recycled](Self::recycle) one if
    /// possible.
    pub(super) fn buffer(&mut self) -> Vec<T> {
        self.real_buffers.pop().unwrap_or_default()
    }

    /// Recycles the memory of a buffer.
    pub(super) fn recycle(&mut self, mut buffer: Vec<T>) {
        if self.real_buffers.len() < MAX_BUFFERS {
            buffer.clear();
            self.real_buffers.push(buffer);
        }
    }

    /// Like the method for real numbers.
    pub(super) fn complex_buffer(&mut self) -> Vec<Complex<T>> {
        self.complex_buffers.pop().unwrap_or_default()
    }

    /// Like the method for real numbers.
    pub(super) fn recycle_complex(&mut self, mut buffer: Vec<Complex<T>>) {
        if self.complex_buffers.len() < MAX_BUFFERS {
            buffer.clear();
            self.complex_buffers.push(buffer);
        }
    }

    /// Σ z·exp(∓2πikn/N) in place of the N values, not divided by their number.
    pub(super) fn complex(&mut self, values: &mut [Complex<T>], direction: FftDirection) {
        let matches =
            |plan: &Arc<dyn Fft<T>>| plan.len() == values.len() && plan.fft_direction() == direction;
        let make = || T::complex_plan(values.len(), direction);
        let plan = newest(&mut self.complex, 2 * self.max_plans, matches, make);
        grow(&mut self.scratch, plan.get_inplace_scratch_len());
        plan.process_with_scratch(values, &mut self.scratch);
    }

    /// Bins 0 to ⌊N/2⌋ of Σ x·exp(−2πikn/N) of the N samples of `input`, which is overwritten.
    pub(super) fn forward(&mut self, input: &mut [T], output: &mut Vec<Complex<T>>) {
        let length = input.len();
        let matches = |plan: &Arc<dyn RealToComplex<T>>| plan.len() == length;
        let plan = newest(&mut self.forward, self.max_plans, matches, || T::forward_plan(length));
        output.resize(length / 2 + 1, Complex::default());
        grow(&mut self.scratch, plan.get_scratch_len());
        plan.process_with_scratch(input, output, &mut self.scratch)
            .expect("input, output and scratch have the plan's lengths");
    }

    /// The `output.len()` real values whose transform's bins are `input` (not divided by their number).
    /// `input` is overwritten; its bin 0 and, where there is one, the bin at half the sampling rate are real.
    pub(super) fn inverse(&mut self, input: &mut [Complex<T>], output: &mut [T]) {
        let length = output.len();
        let matches = |plan: &Arc<dyn ComplexToReal<T>>| plan.len() == length;
        let plan = newest(&mut self.inverse, self.max_plans, matches, || T::inverse_plan(length));
        grow(&mut self.scratch, plan.get_scratch_len());
        plan.process_with_scratch(input, output, &mut self.scratch)
            .expect("input, output and scratch have the plan's lengths, and the end bins are real");
    }
}

/// Moves the matching plan of a list to its front, or makes it in place of the one least recently used, if
/// the list has `most` plans.
fn newest<P>(plans: &mut Vec<P>, most: usize, matches: impl Fn(&P) -> bool, make: impl FnOnce() -> P) -> &P {
    match plans.iter().position(matches) {
        Some(index) => plans[..=index].rotate_right(1),
        None => {
            plans.truncate(most - 1);
            plans.insert(0, make());
        }
    }
    &plans[0]
}

fn grow<T: Float>(scratch: &mut Vec<Complex<T>>, length: usize) {
    if scratch.len() < length {
        scratch.resize(length, Complex::default());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_and_short_lengths_are_unchanged() {
        for length in [1, 2, 3, 7919, 16_381, 20_000, 200_000, 13 * 4096, 1 << 24] {
            assert_eq!(spectrum_length(length), length);
        }
    }

    #[test]
    fn awkward_lengths_lose_at_most_their_last_1_6_percent() {
        assert_eq!(spectrum_length(199_999), 199_650);
        for length in (16_385..3_000_000).step_by(977) {
            let kept = spectrum_length(length);
            assert!(kept <= length && kept as f64 >= 0.984 * length as f64, "{length} → {kept}");
        }
    }

    #[test]
    fn one_and_two_samples_transform() {
        let mut transforms = Transforms::<f64>::default();
        let mut bins = Vec::new();
        transforms.forward(&mut [3.0], &mut bins);
        assert_eq!(bins, [Complex::new(3.0, 0.0)]);
        transforms.forward(&mut [3.0, 1.0], &mut bins);
        assert_eq!(bins, [Complex::new(4.0, 0.0), Complex::new(2.0, 0.0)]);
    }

    #[test]
    fn cached_plans_are_bounded() {
        let mut transforms = Transforms::<f64>::default();
        for length in 1..40 {
            transforms.forward(&mut vec![0.0; length], &mut Vec::new());
        }
        assert_eq!(transforms.forward.len(), MAX_PLANS);
        assert_eq!(transforms.forward[0].len(), 39);
    }
}
