//! Moments of a record's samples in the time domain.

use super::indicators::{Absence, Indicators};

/// Independent partial sums: they let the processor add several samples at once and keep rounding errors small.
const LANES: usize = 16;

/// What the time domain says of a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moments {
    samples: usize,
    /// Arithmetic mean.
    pub(super) mean: f64,
    /// √(Σx²/N).
    rms: f64,
    /// max|x|.
    peak: f64,
    /// Σ(x−μ)²/N.
    variance: f64,
    /// Σ(x−μ)⁴/N.
    fourth: f64,
    /// All samples are equal.
    pub(super) constant: bool,
}

impl Moments {
    /// Moments of at least one sample, and the samples with their mean removed in `centred`.
    pub(super) fn of(samples: &[f32], centred: &mut Vec<f64>) -> Self {
        let count = samples.len() as f64;
        let (mut sums, mut squares) = ([0.0; LANES], [0.0; LANES]);
        let (mut lows, mut highs) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
        for chunk in samples.chunks(LANES) {
            for (lane, &sample) in chunk.iter().enumerate() {
                let x = f64::from(sample);
                sums[lane] += x;
                squares[lane] += x * x;
                lows[lane] = lows[lane].min(sample);
                highs[lane] = highs[lane].max(sample);
            }
        }
        let low = lows.into_iter().fold(f32::INFINITY, f32::min);
        let high = highs.into_iter().fold(f32::NEG_INFINITY, f32::max);
        let constant = low == high;
        // A sum's rounding must not make a constant record vary.
        let mean = if constant {
            f64::from(low)
        } else {
            sums.iter().sum::<f64>() / count
        };

        centred.clear();
        centred.extend(samples.iter().map(|&x| f64::from(x) - mean));
        let (mut seconds, mut fourths) = ([0.0; LANES], [0.0; LANES]);
        for chunk in centred.chunks(LANES) {
            for (lane, x) in chunk.iter().enumerate() {
                let square = x * x;
                seconds[lane] += square;
                fourths[lane] += square * square;
            }
        }
        Self {
            samples: samples.len(),
            mean,
            rms: (squares.iter().sum::<f64>() / count).sqrt(),
            peak: f64::from(low.abs().max(high.abs())),
            variance: seconds.iter().sum::<f64>() / count,
            fourth: fourths.iter().sum::<f64>() / count,
            constant,
        }
    }

    /// Standard deviation over the population: the root mean square with the mean removed.
    pub(super) fn deviation(&self) -> Result<f64, Absence> {
        match self {
            Self { samples: 1, .. } => Err(Absence::TooShort),
            Self { constant: true, .. } => Err(Absence::Constant),
            _ => Ok(self.variance.sqrt()),
        }
    }

    /// Kurtosis, not excess.
    pub(super) fn kurtosis(&self) -> Result<f64, Absence> {
        self.deviation().map(|_| self.fourth / (self.variance * self.variance))
    }

    /// Puts down the indicators of the time domain.
    pub(super) fn indicate(&self, indicators: &mut Indicators) {
        indicators.insert("rms", Ok(self.rms));
        indicators.insert("peak", Ok(self.peak));
        indicators.insert("kurtosis", self.kurtosis());
        let crest_factor = if self.peak > 0.0 {
            Ok(self.peak / self.rms)
        } else {
            Err(Absence::Constant)
        };
        indicators.insert("crest_factor", crest_factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn indicators(samples: &[f32]) -> Indicators {
        let mut indicators = Indicators::default();
        Moments::of(samples, &mut Vec::new()).indicate(&mut indicators);
        indicators
    }

    /// By hand: x = 1, 2, 3, 6 has mean 3, Σx² = 50, Σ(x−3)² = 14, Σ(x−3)⁴ = 16 + 1 + 81 = 98; kurtosis 4·98/14² = 2.
    #[test]
    fn four_samples_by_hand() {
        let got = indicators(&[1.0, 2.0, 3.0, -6.0].map(|x: f32| x.abs()));
        assert_eq!(got.get("rms"), Some(12.5_f64.sqrt()));
        assert_eq!(got.get("peak"), Some(6.0));
        assert_eq!(got.get("kurtosis"), Some(2.0));
        assert_eq!(got.get("crest_factor"), Some(6.0 / 12.5_f64.sqrt()));
    }

    /// Closed form: kurtosis of a sine 3/2, crest factor √2, root mean square A/√2; an offset enters only the last two.
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
    fn constant_zero_and_single_samples_say_why() {
        let constant = indicators(&[0.1; 1000]);
        assert_eq!(constant.absent["kurtosis"], Absence::Constant);
        assert!((constant.values["rms"] - f64::from(0.1_f32)).abs() < 1e-15);
        let zero = indicators(&[0.0; 10]);
        assert_eq!(zero.values["rms"], 0.0);
        assert_eq!(zero.absent["crest_factor"], Absence::Constant);
        let single = indicators(&[3.0]);
        assert_eq!(single.absent["kurtosis"], Absence::TooShort);
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
