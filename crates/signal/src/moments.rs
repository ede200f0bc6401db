//! Moments of a record's samples in the time domain.

use pulp::{Arch, Simd, WithSimd};

use super::indicators::Indicators;
use super::not_computed::NotComputed;
use super::transform::Float;

/// Every this many samples, one contributes to the provisional mean.
const STRIDE: usize = 64;

/// The moments of a record's samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moments {
    samples: usize,
    /// Arithmetic mean.
    pub(super) mean: f64,
    /// Value subtracted from each sample.
    pub(super) shift: f64,
    /// √(Σx²/N).
    pub(super) rms: f64,
    /// max|x|.
    peak: f64,
    /// Σ(x−μ)²/N.
    variance: f64,
    /// Σ(x−μ)⁴/N.
    fourth: f64,
    /// The lowest and the highest sample.
    pub(super) range: [f32; 2],
    /// Whether all samples are equal.
    pub(super) constant: bool,
}

/// Number of samples added at once: interleaved partial sums fill the processor's registers and keep rounding
/// errors small.
const LANES: usize = 8;

/// Sums over eight interleaved subsets of the samples.
struct Sums {
    /// Sums of the first four powers.
    powers: [[f64; LANES]; 4],
    low: [f32; LANES],
    high: [f32; LANES],
}

impl Sums {
    #[inline(always)]
    fn add<T: Float>(&mut self, block: &[f32; LANES], shift: f64, shifted: &mut [T; LANES]) {
        for lane in 0..LANES {
            let sample = block[lane];
            self.low[lane] = if sample < self.low[lane] { sample } else { self.low[lane] };
            self.high[lane] = if sample > self.high[lane] { sample } else { self.high[lane] };
            let x = f64::from(sample) - shift;
            shifted[lane] = T::rounded(x);
            let square = x * x;
            self.powers[0][lane] += x;
            self.powers[1][lane] += square;
            self.powers[2][lane] += square * x;
            self.powers[3][lane] += square * square;
        }
    }
}

/// Sums whole blocks of samples and writes them, less `shift`, to `shifted`: plain loops compiled for each
/// instruction set.
struct BlockSums<'a, T> {
    samples: &'a [[f32; LANES]],
    shift: f64,
    shifted: &'a mut [[T; LANES]],
}

impl<T: Float> WithSimd for BlockSums<'_, T> {
    type Output = Sums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Sums {
        let mut sums =
            Sums { powers: [[0.0; LANES]; 4], low: [f32::INFINITY; LANES], high: [f32::NEG_INFINITY; LANES] };
        for (block, shifted) in self.samples.iter().zip(self.shifted) {
            sums.add(block, self.shift, shifted);
        }
        sums
    }
}

impl Moments {
    /// Computes the moments of at least one sample and writes the samples less `shift`, a value near their
    /// mean, to `shifted`.
    ///
    /// In one pass: moments about the mean of every 64th sample, from which those about the mean follow. The
    /// two means differ by at most 8 standard deviations, so at most 4 digits cancel, and usually less than
    /// one.
    pub(super) fn of<T: Float>(samples: &[f32], shifted: &mut Vec<T>) -> Self {
        let count = samples.len() as f64;
        let picked = samples.iter().step_by(STRIDE);
        let shift = picked.clone().map(|&x| f64::from(x)).sum::<f64>() / picked.len() as f64;
        shifted.resize(samples.len(), T::default());
        let ((blocks, rest), (shifted, room_left)) = (samples.as_chunks(), shifted.as_chunks_mut());
        let mut sums = Arch::new().dispatch(BlockSums { samples: blocks, shift, shifted });
        for (lane, (&sample, shifted)) in rest.iter().zip(room_left).enumerate() {
            (sums.low[lane], sums.high[lane]) = (sums.low[lane].min(sample), sums.high[lane].max(sample));
            let x = f64::from(sample) - shift;
            *shifted = T::rounded(x);
            for (sum, power) in sums.powers.iter_mut().zip(1..) {
                sum[lane] += x.powi(power);
            }
        }
        let low = sums.low.into_iter().fold(f32::INFINITY, f32::min);
        let high = sums.high.into_iter().fold(f32::NEG_INFINITY, f32::max);
        let [first, second, third, fourth] = sums.powers.map(|sum| sum.iter().sum::<f64>() / count);
        let square = first * first;
        let constant = low == high;
        Self {
            samples: samples.len(),
            // Rounding of a sum must not make a constant record vary.
            mean: if constant { f64::from(low) } else { shift + first },
            shift,
            rms: (second + shift * (2.0 * first + shift)).max(0.0).sqrt(),
            peak: f64::from(low.abs().max(high.abs())),
            variance: (second - square).max(0.0),
            fourth: (fourth - 4.0 * first * third + 6.0 * square * second - 3.0 * square * square).max(0.0),
            range: [low, high],
            constant,
        }
    }

    /// Returns the population standard deviation: the root mean square with the mean removed.
    pub(super) fn deviation(&self) -> Result<f64, NotComputed> {
        match self {
            Self { samples: 1, .. } => Err(NotComputed::TooShort),
            Self { constant: true, .. } => Err(NotComputed::Constant),
            _ => Ok(self.variance.sqrt()),
        }
    }

    /// Returns the kurtosis, not excess.
    pub(super) fn kurtosis(&self) -> Result<f64, NotComputed> {
        self.deviation().map(|_| self.fourth / (self.variance * self.variance))
    }

    /// Inserts the indicators of the time domain.
    pub(super) fn indicate(&self, indicators: &mut Indicators) {
        indicators.insert("rms", Ok(self.rms));
        indicators.insert("peak", Ok(self.peak));
        indicators.insert("kurtosis", self.kurtosis());
        let crest_factor =
            if self.peak > 0.0 { Ok(self.peak / self.rms) } else { Err(NotComputed::Constant) };
        indicators.insert("crest_factor", crest_factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn indicators(samples: &[f32]) -> Indicators {
        let mut indicators = Indicators::default();
        Moments::of(samples, &mut Vec::<f64>::new()).indicate(&mut indicators);
        indicators
    }

    /// By hand: x = 1, 2, 3, 6 has mean 3, Σx² = 50, Σ(x−3)² = 14, Σ(x−3)⁴ = 16 + 1 + 81 = 98; kurtosis
    /// 4·98/14² = 2.
    #[test]
    fn four_samples_by_hand() {
        let got = indicators(&[1.0, 2.0, 3.0, -6.0].map(|x: f32| x.abs()));
        assert_eq!(got.get("rms"), Some(12.5_f64.sqrt()));
        assert_eq!(got.get("peak"), Some(6.0));
        assert_eq!(got.get("kurtosis"), Some(2.0));
        assert_eq!(got.get("crest_factor"), Some(6.0 / 12.5_f64.sqrt()));
    }

    /// Closed form: kurtosis of a sine 3/2, crest factor √2, root mean square A/√2; an offset enters only the
    /// last two.
    #[test]
    fn a_sine_and_its_offset() {
        let sine = |offset: f64| -> Vec<f32> {
            (0..100_000)
                .map(|i| (offset + 2.0 * (2.0 * std::f64::consts::PI * f64::from(i) / 1000.0).sin()) as f32)
                .collect()
        };
        let got = indicators(&sine(0.0));
        assert!((got.values["kurtosis"] - 1.5).abs() < 1e-7);
        assert!((got.values["rms"] - 2.0_f64.sqrt()).abs() < 1e-7);
        assert!((got.values["crest_factor"] - 2.0_f64.sqrt()).abs() < 1e-7);
        let got = indicators(&sine(10.0));
        assert!((got.values["kurtosis"] - 1.5).abs() < 1e-6);
        assert!((got.values["rms"] - 102.0_f64.sqrt()).abs() < 1e-6);
        assert!((got.values["peak"] - 12.0).abs() < 1e-6);
    }

    #[test]
    fn constant_zero_and_single_samples_report_the_reason() {
        let constant = indicators(&[0.1; 1000]);
        assert_eq!(constant.absent["kurtosis"], NotComputed::Constant);
        assert!((constant.values["rms"] - f64::from(0.1_f32)).abs() < 1e-15);
        let zero = indicators(&[0.0; 10]);
        assert_eq!(zero.values["rms"], 0.0);
        assert_eq!(zero.absent["crest_factor"], NotComputed::Constant);
        let single = indicators(&[3.0]);
        assert_eq!(single.absent["kurtosis"], NotComputed::TooShort);
        assert_eq!(single.values["crest_factor"], 1.0);
    }

    #[test]
    fn the_largest_samples_do_not_overflow() {
        let got = indicators(&[f32::MAX, -f32::MAX, f32::MAX, 0.0]);
        assert!(got.values.values().all(|value| value.is_finite()), "{got:?}");
        let got = indicators(&[1e-45, 0.0, 0.0]);
        assert!(got.values["kurtosis"].is_finite(), "{got:?}");
    }
}
