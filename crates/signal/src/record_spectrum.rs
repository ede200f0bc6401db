//! One record's transform and the room to work in.

use realfft::num_complex::Complex;

use super::envelope::Envelope;
use super::moments::Moments;
use super::record::Record;
use super::shaft_angle::ShaftAngle;
use super::spectrum::hann_amplitude;
use super::transform::{Transforms, spectrum_length};

/// Everything of a record's transform, and room to work in.
#[derive(Default)]
pub(super) struct RecordSpectrum {
    pub(super) transforms: Transforms,
    samples: Vec<f64>,
    pub(super) bins: Vec<Complex<f64>>,
    pub(super) amplitude: Vec<f64>,
    pub(super) envelope: Envelope,
    pub(super) sorting: Vec<f64>,
    /// What lines say for combs, by bin.
    pub(super) says: Vec<f64>,
    /// Room for bins and amplitudes at a compensated speed.
    pub(super) compensated: (Vec<Complex<f64>>, Vec<f64>),
    pub(super) length: usize,
    /// The shaft's angle by a line near the located mesh, once it was asked for: none inside where no line
    /// could be followed.
    pub(super) followed: Option<Option<ShaftAngle>>,
}

impl RecordSpectrum {
    /// Transforms a record, its mean removed: `bins` without a window, `amplitude` with the Hann window.
    pub(super) fn transform(&mut self, record: &Record) -> Moments {
        let moments = Moments::of(record.samples(), &mut self.samples);
        self.followed = None;
        self.length = spectrum_length(self.samples.len());
        self.transforms.forward(&mut self.samples[..self.length], &mut self.bins);
        // Of an offset the unwindowed transform has nothing in any other bin.
        self.bins[0] -= self.length as f64 * (moments.mean - moments.shift);
        hann_amplitude(&self.bins, self.length, &mut self.amplitude);
        moments
    }

    pub(super) fn resolution_hz(&self, record: &Record) -> f64 {
        record.sample_rate_hz() / self.length as f64
    }
}
