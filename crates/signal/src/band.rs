//! Root-mean-square values of user-defined frequency bands.

use std::ops::RangeInclusive;

use pulp::{Arch, Simd, WithSimd};
use serde::{Deserialize, Serialize};

use super::motion::Motion;
use super::not_computed::NotComputed;
use super::spectrum::{HANN_BANDWIDTH_BINS, position_of};
use super::sums::sum_of;

/// The quantity whose root mean square a band gives.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum BandQuantity {
    /// The record itself, in its unit.
    #[default]
    Record,
    /// Velocity in mm/s: the record, integrated if it is an acceleration.
    Velocity,
}

/// A band whose value is the indicator `band_<name>`, for example velocity from 10 to 1000 Hz as in ISO
/// 20816.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Band {
    /// Name: 1 to 32 characters of `a-z`, `0-9` and `_`.
    pub name: String,
    /// Lowest and highest frequency in hertz.
    pub band_hz: [f64; 2],
    /// The quantity.
    #[serde(default)]
    pub quantity: BandQuantity,
}

impl Band {
    /// Returns whether name and frequencies are valid.
    pub fn is_valid(&self) -> bool {
        let [low, high] = self.band_hz;
        is_name(&self.name) && low >= 0.0 && low < high && high.is_finite()
    }

    /// Returns the name of the indicator.
    pub(super) fn indicator(&self) -> String {
        format!("band_{}", self.name)
    }

    /// Returns the band's value from the Hann amplitude spectrum of `samples` samples.
    pub(super) fn rms(
        &self,
        amplitude: &[f64],
        samples: usize,
        sample_rate_hz: f64,
        unit: &str,
    ) -> Result<f64, NotComputed> {
        rms_between(self.band_hz, self.quantity, amplitude, samples, sample_rate_hz, unit)
    }
}

/// Returns whether a name can be part of an indicator's: 1 to 32 characters of `a-z`, `0-9` and `_`.
pub fn is_name(name: &str) -> bool {
    let letters = name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    letters && (1..=32).contains(&name.len())
}

/// Returns the unit's factor to mm/s, and whether its samples must be integrated to velocity.
fn to_mm_per_s(unit: &str) -> Option<(f64, bool)> {
    match Motion::of_unit(unit)? {
        (Motion::Acceleration, si) => Some((1e3 * si, true)),
        (Motion::Velocity, si) => Some((1e3 * si, false)),
        (Motion::Displacement, _) => None,
    }
}

/// √(Σ P(f)·Δf) over the bins of the Hann power spectral density P from the lowest to the highest frequency,
/// both included, without bin 0. For the velocity of an acceleration each term is divided by (2πf)².
pub(super) fn rms_between(
    band_hz: [f64; 2],
    quantity: BandQuantity,
    amplitude: &[f64],
    samples: usize,
    sample_rate_hz: f64,
    unit: &str,
) -> Result<f64, NotComputed> {
    let (factor, integrates) = match quantity {
        BandQuantity::Record => (1.0, false),
        BandQuantity::Velocity => to_mm_per_s(unit).ok_or(NotComputed::NotAcceleration)?,
    };
    let [low, high] = band_hz.map(|frequency| position_of(frequency, samples, sample_rate_hz));
    if high > 0.5 * samples as f64 {
        return Err(NotComputed::AboveNyquist);
    }
    let (first, last) = ((low.ceil() as usize).max(1), high.floor() as usize);
    if first > last {
        return Err(NotComputed::TooShort);
    }
    let squares = |bins: RangeInclusive<usize>| {
        let first = integrates.then_some(*bins.start() as f64);
        Arch::new().dispatch(BandSquares { amplitude: &amplitude[bins], first })
    };
    // The bin at half the sampling rate has no mirror image.
    let sum = squares(first..=last) + if 2 * last == samples { squares(last..=last) } else { 0.0 };
    let resolution_hz = sample_rate_hz / samples as f64;
    let factor = if integrates { factor / (std::f64::consts::TAU * resolution_hz) } else { factor };
    Ok(factor * (0.5 * sum / HANN_BANDWIDTH_BINS).sqrt())
}

/// The sum of the squares of amplitudes, each divided by its bin's number if that of the `first` one is
/// given; as a plain loop compiled for each instruction set.
struct BandSquares<'a> {
    amplitude: &'a [f64],
    first: Option<f64>,
}

impl WithSimd for BandSquares<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let Some(mut bin) = self.first else { return sum_of(self.amplitude, |a| a * a) };
        let (blocks, rest) = self.amplitude.as_chunks::<8>();
        let mut sums = [0.0; 8];
        for block in blocks {
            for (lane, (sum, a)) in sums.iter_mut().zip(block).enumerate() {
                let integrated = a / (bin + lane as f64);
                *sum += integrated * integrated;
            }
            bin += 8.0;
        }
        let rest: f64 = rest.iter().zip(0..).map(|(a, k)| (a / (bin + f64::from(k))).powi(2)).sum();
        rest + sums.into_iter().sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use jiff::Timestamp;

    use super::super::{AnalysisSettings, Analyzer, MeshContext, Record};
    use super::*;

    fn value(band_hz: [f64; 2], quantity: BandQuantity, unit: &str) -> Result<f64, NotComputed> {
        let samples = (0..8000)
            .map(|i| (3.0 + 2.0 * (2.0 * PI * 159.3 * f64::from(i) / 8000.0).sin()) as f32)
            .collect();
        let record = Record::new("1", Timestamp::UNIX_EPOCH, 8000.0, unit, samples).unwrap();
        let band = Band { name: "b".to_owned(), band_hz, quantity };
        let got = Analyzer::new(AnalysisSettings::default()).analyze_with_bands(
            &record,
            &MeshContext::unknown(),
            &[band],
        );
        got.indicators.get("band_b").ok_or_else(|| got.indicators.absent["band_b"])
    }

    /// Closed form: a sine of amplitude 2 has a root mean square of √2, and of √2·1000/(2π·159.3) mm/s as
    /// velocity, without the offset.
    #[test]
    fn a_sine_reads_its_root_mean_square() {
        let rms = value([10.0, 1000.0], BandQuantity::Record, "m/s2").unwrap();
        assert!((rms / 2.0_f64.sqrt() - 1.0).abs() < 1e-6, "{rms}");
        let velocity = value([10.0, 1000.0], BandQuantity::Velocity, "m/s2").unwrap();
        let want = 2.0_f64.sqrt() * 1e3 / (2.0 * PI * 159.3);
        assert!((velocity / want - 1.0).abs() < 1e-4, "{velocity} {want}");
        let in_g = value([10.0, 1000.0], BandQuantity::Velocity, "g").unwrap();
        assert!((in_g / velocity - 9.806_65).abs() < 1e-12);
        assert!(value([1000.0, 4000.0], BandQuantity::Record, "m/s2").unwrap() < 1e-3);
    }

    #[test]
    fn bands_without_a_value_report_the_reason() {
        assert_eq!(value([10.0, 1000.0], BandQuantity::Velocity, "V"), Err(NotComputed::NotAcceleration));
        assert_eq!(value([10.0, 4001.0], BandQuantity::Record, "V"), Err(NotComputed::AboveNyquist));
        assert_eq!(value([10.2, 10.4], BandQuantity::Record, "V"), Err(NotComputed::TooShort));
    }
}
