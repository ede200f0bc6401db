//! The one-sided amplitude spectrum under a Hann window.

use flankwatch_fourier::Complex;
use pulp::{Arch, Simd, WithSimd};
use serde::Serialize;

/// Equivalent noise bandwidth of the Hann window in bins.
pub(super) const HANN_BANDWIDTH_BINS: f64 = 1.5;

/// A one-sided amplitude (peak) spectrum: a sine of amplitude A at the frequency of a bin reads A there.
///
/// Computed from a record with its mean removed, under a periodic Hann window divided by its mean (0.5). The
/// bins at zero and at half the sampling rate have no mirror image and are not doubled.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Spectrum {
    /// Quantity of the values: `"amplitude_peak"`, or `"psd"` for a power spectral density.
    pub quantity: &'static str,
    /// Unit of the values: the record's unit, or its square per hertz for a power spectral density.
    pub unit: String,
    /// Name of the window: `"hann"`.
    pub window: &'static str,
    /// Equivalent noise bandwidth in hertz.
    pub bandwidth_hz: f64,
    /// Bin spacing in hertz.
    pub resolution_hz: f64,
    /// Value of bin k, at k × `resolution_hz`.
    pub amplitude: Vec<f64>,
}

impl Spectrum {
    /// Creates a Hann spectrum from amplitudes.
    pub(super) fn hann(unit: &str, resolution_hz: f64, amplitude: Vec<f64>) -> Self {
        Self {
            quantity: "amplitude_peak",
            unit: unit.to_owned(),
            window: "hann",
            bandwidth_hz: HANN_BANDWIDTH_BINS * resolution_hz,
            resolution_hz,
            amplitude,
        }
    }

    /// Converts to the power spectral density of the same record of `samples` samples: the mean square in
    /// each bin over the window's bandwidth, as SciPy's `periodogram` with `window="hann",
    /// scaling="density"`. Its sum times the resolution is the record's variance, apart from the effect of
    /// the window.
    pub(super) fn into_density(mut self, samples: usize) -> Self {
        for (k, value) in self.amplitude.iter_mut().enumerate() {
            let sides = if k == 0 || 2 * k == samples { 1.0 } else { 0.5 };
            *value = sides * *value * *value / self.bandwidth_hz;
        }
        self.quantity = "psd";
        self.unit = format!("({})^2/Hz", self.unit);
        self
    }

    /// Returns the frequency of a bin in hertz.
    pub fn frequency_hz(&self, bin: usize) -> f64 {
        bin as f64 * self.resolution_hz
    }
}

/// Returns the position in bins of a frequency in the spectrum of `samples` samples. It is a whole number at
/// a bin's frequency, which a quotient by the rounded bin spacing often misses.
pub(super) fn position_of(frequency_hz: f64, samples: usize, sample_rate_hz: f64) -> f64 {
    frequency_hz * samples as f64 / sample_rate_hz
}

/// Computes the amplitudes under the Hann window from the `bins` of the unwindowed transform of `length`
/// samples.
///
/// Multiplying by the periodic Hann window 0.5 − 0.5·cos(2πn/N) equals the convolution ½X(k) − ¼(X(k−1) +
/// X(k+1)) of the bins. One transform therefore serves both the windowed spectrum and the envelope, which
/// must not be windowed.
pub(super) fn hann_amplitude(bins: &[Complex<f64>], length: usize, amplitude: &mut Vec<f64>) {
    amplitude.resize(bins.len(), 0.0);
    let Some(last) = bins.len().checked_sub(1) else {
        return;
    };
    let one_sided = 4.0 / length as f64;
    let windowed = |k: usize, before: Complex<f64>, after: Complex<f64>| {
        (bins[k] * 0.5 - (before + after) * 0.25).norm_sqr().sqrt()
    };
    // Beyond the ends the spectrum continues with the conjugates of the mirrored bins.
    let beyond_zero = bins[last.min(1)].conj();
    amplitude[0] = 0.5 * one_sided * windowed(0, beyond_zero, bins[last.min(1)]);
    if last == 0 {
        return;
    }
    Arch::new().dispatch(InnerBins { bins, scale: 0.25 * one_sided, amplitude: &mut amplitude[1..last] });
    amplitude[last] = if length.is_multiple_of(2) {
        0.5 * one_sided * windowed(last, bins[last - 1], bins[last - 1].conj())
    } else {
        one_sided * windowed(last, bins[last - 1], bins[last].conj())
    };
}

/// The bins with neighbours on both sides, as a plain loop compiled for each instruction set.
struct InnerBins<'a> {
    bins: &'a [Complex<f64>],
    scale: f64,
    /// Amplitudes of the bins from 1 on.
    amplitude: &'a mut [f64],
}

impl WithSimd for InnerBins<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (amplitude, around) in self.amplitude.iter_mut().zip(self.bins.windows(3)) {
            // 4·(½X(k) − ¼(X(k−1) + X(k+1))).
            let re = 2.0 * around[1].re - (around[0].re + around[2].re);
            let im = 2.0 * around[1].im - (around[0].im + around[2].im);
            *amplitude = (re * re + im * im).sqrt() * self.scale;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::super::transform::Transforms;
    use super::*;

    fn spectrum(samples: &[f64]) -> Vec<f64> {
        let (mut bins, mut amplitude) = (Vec::new(), Vec::new());
        Transforms::default().forward(&mut samples.to_vec(), &mut bins);
        hann_amplitude(&bins, samples.len(), &mut amplitude);
        amplitude
    }

    /// The definition, term by term: 2/Σw · |Σ w·x·exp(−2πikn/N)|, once at zero and at half the sampling
    /// rate.
    fn by_definition(x: &[f64]) -> Vec<f64> {
        let n = x.len();
        let window: Vec<f64> = (0..n).map(|i| 0.5 - 0.5 * (2.0 * PI * i as f64 / n as f64).cos()).collect();
        (0..=n / 2)
            .map(|k| {
                let sum: Complex<f64> = (0..n)
                    .map(|i| {
                        Complex::from_polar(window[i] * x[i], -2.0 * PI * ((k * i) % n) as f64 / n as f64)
                    })
                    .sum();
                let sides = if k == 0 || 2 * k == n { 1.0 } else { 2.0 };
                sides * sum.norm() / window.iter().sum::<f64>()
            })
            .collect()
    }

    #[test]
    fn equals_the_definition_at_short_even_odd_and_prime_lengths() {
        for n in [2, 3, 4, 5, 8, 13, 30, 31] {
            let x: Vec<f64> = (0..n).map(|i| ((i * i * 7 + 3 * i) % 11) as f64 - 4.0).collect();
            for (k, (got, want)) in spectrum(&x).iter().zip(by_definition(&x)).enumerate() {
                assert!((got - want).abs() < 1e-12, "n {n} bin {k}: {got} {want}");
            }
        }
        assert_eq!(spectrum(&[1.0]), [0.0]);
    }

    #[test]
    fn a_sine_on_a_bin_reads_its_amplitude() {
        let x: Vec<f64> =
            (0..1000).map(|i| 3.0 * (2.0 * PI * 40.0 * i as f64 / 1000.0 + 0.3).sin()).collect();
        let amplitude = spectrum(&x);
        assert!((amplitude[40] - 3.0).abs() < 1e-12);
        // The Hann window shows half of it in the neighbours and nothing two bins away.
        assert!((amplitude[41] - 1.5).abs() < 1e-12 && amplitude[42] < 1e-12);
    }

    #[test]
    fn a_cosine_at_half_the_sampling_rate_reads_its_amplitude() {
        let x: Vec<f64> = (0..64).map(|i| if i % 2 == 0 { 2.0 } else { -2.0 }).collect();
        assert!((spectrum(&x)[32] - 2.0).abs() < 1e-14);
    }
}
