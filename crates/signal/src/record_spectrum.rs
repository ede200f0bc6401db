//! One record's transform and its buffers.

use realfft::num_complex::Complex;

use super::envelope::Envelope;
use super::moments::Moments;
use super::record::RecordOf;
use super::shaft_angle::ShaftAngle;
use super::spectrum::hann_amplitude;
use super::transform::{Transforms, spectrum_length};

/// One record's transform and reusable buffers.
#[derive(Default)]
pub(super) struct RecordSpectrum {
    pub(super) transforms: Transforms,
    samples: Vec<f64>,
    pub(super) bins: Vec<Complex<f64>>,
    pub(super) amplitude: Vec<f64>,
    pub(super) envelope: Envelope,
    pub(super) sorting: Vec<f64>,
    /// Scratch for the logarithmic ratios of lines to the noise, by bin.
    pub(super) log_ratios: Vec<f64>,
    /// Buffers for bins and amplitudes at the compensated speed.
    pub(super) compensated: (Vec<Complex<f64>>, Vec<f64>),
    pub(super) length: usize,
    /// The shaft angle tracked near the located mesh, if it was requested; `Some(None)` if no line could be
    /// tracked.
    pub(super) tracked_angle: Option<Option<ShaftAngle>>,
}

impl RecordSpectrum {
    /// Transforms a record, its mean removed: `bins` without a window, `amplitude` with the Hann window.
    pub(super) fn transform(&mut self, record: &RecordOf<'_>) -> Moments {
        let moments = Moments::of(record.samples(), &mut self.samples);
        self.tracked_angle = None;
        self.length = spectrum_length(self.samples.len());
        self.transforms.forward(&mut self.samples[..self.length], &mut self.bins);
        // In the unwindowed transform an offset affects this bin only.
        self.bins[0] -= self.length as f64 * (moments.mean - moments.shift);
        hann_amplitude(&self.bins, self.length, &mut self.amplitude);
        moments
    }

    pub(super) fn resolution_hz(&self, record: &RecordOf<'_>) -> f64 {
        record.sample_rate_hz() / self.length as f64
    }
}
