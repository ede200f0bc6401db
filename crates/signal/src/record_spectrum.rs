//! One record's transform and its buffers.

use flankwatch_fourier::Complex;

use super::envelope::Envelope;
use super::moments::Moments;
use super::record::RecordOf;
use super::shaft_angle::ShaftAngle;
use super::spectrum::hann_amplitude;
use super::transform::{Transforms, spectrum_length};

/// Records whose highest sample is outside this range are transformed in double precision, because sums over
/// them could leave the range of single precision.
const IN_SINGLE_PRECISION: std::ops::Range<f32> = 1e-25..1e25;

/// Transforms in single precision, and buffers of a record's own.
#[derive(Default)]
pub(super) struct SinglePrecision {
    pub(super) transforms: Transforms<f32>,
    samples: Vec<f32>,
    bins: Vec<Complex<f32>>,
}

/// One record's transform and reusable buffers.
#[derive(Default)]
pub(super) struct RecordSpectrum {
    pub(super) transforms: Transforms,
    samples: Vec<f64>,
    pub(super) single: SinglePrecision,
    pub(super) bins: Vec<Complex<f64>>,
    pub(super) amplitude: Vec<f64>,
    pub(super) envelope: Envelope,
    pub(super) sorting: Vec<f64>,
    /// Scratch for the logarithmic ratios of lines to the noise, by bin.
    pub(super) log_ratios: Vec<f64>,
    /// Buffers for bins and amplitudes at the compensated speed.
    pub(super) compensated: (Vec<Complex<f64>>, Vec<f64>),
    /// The mean mesh frequency in bins, if these buffers hold this record's compensated transform.
    pub(super) compensated_mesh_bins: Option<f64>,
    pub(super) length: usize,
    /// The shaft angle tracked near the located mesh, if it was requested; `Some(None)` if no line could be
    /// tracked.
    pub(super) tracked_angle: Option<Option<ShaftAngle>>,
}

impl RecordSpectrum {
    /// Transforms a record, its mean removed: `bins` without a window, `amplitude` with the Hann window.
    pub(super) fn transform(&mut self, record: &RecordOf<'_>) -> Moments {
        let moments = Moments::of(record.samples(), &mut self.samples);
        self.length = spectrum_length(self.samples.len());
        self.transforms.forward(&mut self.samples[..self.length], &mut self.bins);
        self.complete(moments)
    }

    /// Does the same in single precision, in which samples are stored.
    pub(super) fn transform_in_single_precision(&mut self, record: &RecordOf<'_>) -> Moments {
        let SinglePrecision { transforms, samples, bins } = &mut self.single;
        let moments = Moments::of(record.samples(), samples);
        let highest = moments.range[0].abs().max(moments.range[1].abs());
        if !IN_SINGLE_PRECISION.contains(&highest) {
            return self.transform(record);
        }
        self.length = spectrum_length(samples.len());
        transforms.forward(&mut samples[..self.length], bins);
        self.bins.clear();
        self.bins.extend(bins.iter().map(|bin| Complex::new(bin.re.into(), bin.im.into())));
        self.complete(moments)
    }

    /// Removes the mean from the bins and computes the amplitudes.
    fn complete(&mut self, moments: Moments) -> Moments {
        if let Some(Some(angle)) = self.tracked_angle.take() {
            angle.recycle(&mut self.transforms);
        }
        self.compensated_mesh_bins = None;
        // In the unwindowed transform an offset affects this bin only.
        self.bins[0] -= self.length as f64 * (moments.mean - moments.shift);
        hann_amplitude(&self.bins, self.length, &mut self.amplitude);
        moments
    }

    pub(super) fn resolution_hz(&self, record: &RecordOf<'_>) -> f64 {
        record.sample_rate_hz() / self.length as f64
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::Record;

    #[test]
    fn bins_in_single_precision_are_close() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        for noise in [0.0, 1e-3, 1.0] {
            let samples = (0..200_000).map(|i| {
                let white: f64 = StandardNormal.sample(&mut random);
                ((0.2 * f64::from(i)).sin() + 1e-4 * (0.7 * f64::from(i)).sin() + noise * white + 3.0) as f32
            });
            let record = Record::new("1", Timestamp::UNIX_EPOCH, 2e4, "g", samples.collect()).unwrap();
            let (mut single, mut double) = (RecordSpectrum::default(), RecordSpectrum::default());
            assert_eq!(single.transform_in_single_precision(&record), double.transform(&record));
            let highest = double.bins.iter().map(|bin| bin.norm()).fold(0.0, f64::max);
            let apart = single.bins.iter().zip(&double.bins).map(|(a, b)| (a - b).norm() / highest);
            let squares: f64 = apart.clone().map(|apart| apart * apart).sum();
            let (largest, mean) = (apart.fold(0.0, f64::max), (squares / double.bins.len() as f64).sqrt());
            assert!(largest < 2e-7 && mean < 1e-9, "{noise}: {largest} {mean}");
        }
    }
}
