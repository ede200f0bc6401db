//! The envelope spectrum of a band, computed from the band's bins alone.

use flankwatch_fourier::{Complex, FftDirection};
use pulp::{Arch, Simd, WithSimd};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::not_computed::NotComputed;
use super::spectrum::{hann_amplitude, position_of};
use super::sums::mean_of;
use super::transform::Transforms;

/// Samples of the envelope per bin of the band. The modulus of a signal of B bins is not limited to B bins;
/// the more samples, the less of it is aliased.
const OVERSAMPLING: usize = 4;

/// The fewest bins in a band.
const MIN_BINS: usize = 3;

/// How the band of an envelope was chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum BandSource {
    /// Configured for the asset.
    Asset,
    /// 1.5 mesh frequencies to either side of the strongest mesh harmonic.
    StrongestMeshHarmonic,
    /// The most impulsive band of the record's kurtogram.
    Kurtogram,
    /// From 1/16 to 45 % of the sampling rate, where bearing impacts ring; for a machine without a mesh.
    Impacts,
    /// The whole spectrum, if the shaft speed is unknown or no kurtogram can be computed.
    Whole,
    /// Given in the query.
    Query,
}

/// How to choose the band of an envelope if none is given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum EnvelopeSearch {
    /// Around the strongest mesh harmonic.
    #[default]
    MeshHarmonic,
    /// The most impulsive band, by the fast kurtogram.
    Kurtogram,
}

impl EnvelopeSearch {
    /// Returns whether this is the default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// The band of an envelope.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct EnvelopeBand {
    /// Lowest and highest frequency in hertz.
    pub band_hz: [f64; 2],
    /// How it was chosen.
    #[serde(rename = "band_source")]
    pub source: BandSource,
    /// Kurtosis of the band's envelope if the kurtogram chose it: 0 in noise.
    pub spectral_kurtosis: Option<f64>,
}

/// Impacts ring far above the lines of shafts and meshes, and below the range of anti-aliasing filters. Both
/// limits are fractions of the sampling rate.
const IMPACT_BAND: [f64; 2] = [1.0 / 16.0, 0.45];

impl EnvelopeBand {
    /// Returns the band of bearing impacts in a record with this sampling rate.
    pub fn of_impacts(sample_rate_hz: f64) -> Self {
        Self::given(IMPACT_BAND.map(|part| part * sample_rate_hz), BandSource::Impacts)
    }

    /// Creates a band chosen without a kurtogram.
    pub fn given(band_hz: [f64; 2], source: BandSource) -> Self {
        Self { band_hz, source, spectral_kurtosis: None }
    }
}

/// Why a band has no envelope spectrum.
#[derive(Debug, Clone, Copy, Error, PartialEq)]
pub enum BandError {
    /// The two frequencies are not finite, negative or not ascending.
    #[error("band_hz is [{low}, {high}], expected two finite, ascending frequencies of at least 0 Hz")]
    Order {
        /// The first frequency in hertz.
        low: f64,
        /// The second frequency in hertz.
        high: f64,
    },
    /// The band reaches above half the sampling rate.
    #[error("band_hz is [{low}, {high}], expected at most half the sampling rate, {nyquist_hz} Hz")]
    AboveNyquist {
        /// The first frequency in hertz.
        low: f64,
        /// The second frequency in hertz.
        high: f64,
        /// Half the sampling rate in hertz.
        nyquist_hz: f64,
    },
    /// The band contains fewer bins than an envelope needs.
    #[error(
        "band_hz is [{low}, {high}], which contains {bins} bins of {resolution_hz} Hz, expected at least {MIN_BINS}: widen the band or use a longer record"
    )]
    TooNarrow {
        /// The first frequency in hertz.
        low: f64,
        /// The second frequency in hertz.
        high: f64,
        /// Number of bins within the band.
        bins: usize,
        /// Bin spacing in hertz.
        resolution_hz: f64,
    },
}

impl BandError {
    /// Returns the reason for the band's missing indicators.
    pub(super) fn not_computed(self) -> NotComputed {
        match self {
            Self::AboveNyquist { .. } => NotComputed::AboveNyquist,
            Self::Order { .. } | Self::TooNarrow { .. } => NotComputed::TooShort,
        }
    }
}

/// Returns the first and the last bin of a band in a spectrum of `length` samples. The bins at zero and at
/// half the sampling rate are excluded, as they have no phase.
pub(super) fn band_bins(
    [low, high]: [f64; 2],
    length: usize,
    sample_rate_hz: f64,
) -> Result<[usize; 2], BandError> {
    if !(low >= 0.0 && high > low && high.is_finite()) {
        return Err(BandError::Order { low, high });
    }
    let nyquist_hz = 0.5 * sample_rate_hz;
    if high > nyquist_hz {
        return Err(BandError::AboveNyquist { low, high, nyquist_hz });
    }
    let [first, last] = [low, high].map(|frequency| position_of(frequency, length, sample_rate_hz));
    let first = (first.ceil() as usize).max(1);
    let last = (last.floor() as usize).min((length - 1) / 2);
    let bins = (last + 1).saturating_sub(first);
    if bins < MIN_BINS {
        let resolution_hz = sample_rate_hz / length as f64;
        return Err(BandError::TooNarrow { low, high, bins, resolution_hz });
    }
    Ok([first, last])
}

/// Buffers and result of an envelope spectrum.
#[derive(Default)]
pub(super) struct Envelope {
    analytic: Vec<Complex<f64>>,
    modulus: Vec<f64>,
    bins: Vec<Complex<f64>>,
    /// Amplitudes, one per bin of the band, with the record's own bin spacing.
    pub(super) amplitude: Vec<f64>,
}

impl Envelope {
    /// Computes the Hann amplitude spectrum of the modulus, mean removed, of the analytic signal formed by
    /// the bins `first` to `last` of the unwindowed transform of `length` samples.
    ///
    /// The band is shifted down to start at bin 1, which does not change the modulus, and transformed back
    /// with only as many samples as its width requires: 4 per bin, rounded up to a power of two, or `length`
    /// if that is less.
    pub(super) fn compute(
        &mut self,
        bins: &[Complex<f64>],
        length: usize,
        [first, last]: [usize; 2],
        transforms: &mut Transforms,
    ) {
        let width = last - first + 1;
        let samples = (OVERSAMPLING * width).next_power_of_two().min(length);
        // The real part is the band itself, in which each bin occurs twice.
        let scale = 2.0 / length as f64;
        self.analytic.clear();
        self.analytic.resize(samples, Complex::default());
        for (target, bin) in self.analytic[1..].iter_mut().zip(&bins[first..=last]) {
            *target = bin * scale;
        }
        transforms.complex(&mut self.analytic, FftDirection::Inverse);
        self.modulus.resize(samples, 0.0);
        Arch::new().dispatch(Moduli { analytic: &self.analytic, modulus: &mut self.modulus });
        transforms.forward(&mut self.modulus, &mut self.bins);
        // Bins beyond the band's width are not needed, except two for the window.
        self.bins.truncate((width + 2).min(samples / 2 + 1));
        hann_amplitude(&self.bins, samples, &mut self.amplitude);
        self.amplitude.truncate(width);
    }
}

/// The modulus of a signal with its mean removed, as plain loops compiled for each instruction set.
struct Moduli<'a> {
    analytic: &'a [Complex<f64>],
    modulus: &'a mut [f64],
}

impl WithSimd for Moduli<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (modulus, z) in self.modulus.iter_mut().zip(self.analytic) {
            *modulus = z.norm_sqr().sqrt();
        }
        let mean = mean_of(self.modulus, |modulus| *modulus);
        for modulus in self.modulus {
            *modulus -= mean;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn envelope(mut x: Vec<f64>, band: [f64; 2], rate: f64) -> Vec<f64> {
        let (length, mut bins, mut transforms) = (x.len(), Vec::new(), Transforms::default());
        transforms.forward(&mut x, &mut bins);
        let mut envelope = Envelope::default();
        envelope.compute(&bins, length, band_bins(band, length, rate).unwrap(), &mut transforms);
        envelope.amplitude
    }

    /// Closed form: x = (1 + m·cos Ωt)·a·cos ωt has the envelope a·(1 + m·cos Ωt), a line of m·a at Ω. The
    /// rest is outside the band.
    #[test]
    fn amplitude_modulation_reads_its_depth() {
        for length in [4096, 5000, 4999] {
            let x: Vec<f64> = (0..length)
                .map(|i| {
                    let turn = 2.0 * PI * i as f64 / length as f64;
                    2.0 * (1.0 + 0.4 * (12.0 * turn).cos()) * (600.0 * turn + 0.4).cos()
                        + 7.0 * (900.0 * turn).sin()
                        + 3.0
                })
                .collect();
            let amplitude = envelope(x, [560.0, 640.0], length as f64);
            assert_eq!(amplitude.len(), 81);
            assert!((amplitude[12] - 0.8).abs() < 1e-12, "{}", amplitude[12]);
            assert!((amplitude[11] - 0.4).abs() < 1e-12 && (amplitude[13] - 0.4).abs() < 1e-12);
            assert!(amplitude.iter().enumerate().all(|(k, a)| (11..=13).contains(&k) || *a < 1e-12));
        }
    }

    #[test]
    fn the_widest_band_of_the_shortest_record_works() {
        assert_eq!(band_bins([0.0, 4.0], 8, 8.0), Ok([1, 3]));
        assert_eq!(band_bins([0.0, 3.5], 7, 7.0), Ok([1, 3]));
        // The bin spacing 1/49 Hz is rounded.
        assert_eq!(band_bins([10.0, 20.0], 98_000, 2000.0), Ok([490, 980]));
        assert_eq!(envelope(vec![1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0, 0.0], [0.0, 4.0], 8.0).len(), 3);
        assert_eq!(envelope(vec![0.0; 7], [0.0, 3.5], 7.0), [0.0; 3]);
    }

    #[test]
    fn invalid_bands_are_rejected() {
        assert_eq!(band_bins([5.0, 2.0], 100, 100.0), Err(BandError::Order { low: 5.0, high: 2.0 }));
        assert!(matches!(band_bins([f64::NAN, 2.0], 100, 100.0), Err(BandError::Order { .. })));
        assert!(matches!(band_bins([0.0, f64::INFINITY], 100, 100.0), Err(BandError::Order { .. })));
        assert!(matches!(band_bins([0.0, 50.5], 100, 100.0), Err(BandError::AboveNyquist { .. })));
        assert!(matches!(band_bins([10.0, 11.5], 100, 100.0), Err(BandError::TooNarrow { bins: 2, .. })));
        assert!(matches!(band_bins([10.2, 10.4], 100, 100.0), Err(BandError::TooNarrow { bins: 0, .. })));
        assert!(matches!(band_bins([0.0, 0.5], 1, 1.0), Err(BandError::TooNarrow { bins: 0, .. })));
    }
}
