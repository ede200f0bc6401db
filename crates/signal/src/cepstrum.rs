//! The real cepstrum, which turns a family of equally spaced lines into a single peak.

use flankwatch_fourier::Complex;
use serde::Serialize;

use super::analyzer::Analyzer;
use super::not_computed::NotComputed;
use super::record::RecordOf;

/// Lowest amplitude relative to the highest, to avoid the logarithm of zero.
const AMPLITUDE_FLOOR: f64 = 1e-9;

/// The real cepstrum of a record, dimensionless.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cepstrum {
    /// Spacing of the values in seconds: that of the samples.
    pub resolution_s: f64,
    /// Value at quefrency n × `resolution_s`, up to half the record's length.
    pub value: Vec<f64>,
}

impl Analyzer {
    /// Computes the inverse transform of the natural logarithm of a record's Hann amplitude spectrum.
    /// Amplitudes below 10⁻⁹ of the highest are raised to that. Sidebands one shaft rate apart show as a peak
    /// at the duration of one turn.
    ///
    /// # Errors
    /// [`NotComputed::Constant`] if all samples are equal.
    pub fn cepstrum(&mut self, record: &RecordOf<'_>) -> Result<Cepstrum, NotComputed> {
        let work = &mut self.work;
        let moments = work.transform(record);
        let highest = work.amplitude.iter().copied().fold(0.0, f64::max);
        let cepstrum = if moments.constant || highest == 0.0 {
            Err(NotComputed::Constant)
        } else {
            let floor = AMPLITUDE_FLOOR * highest;
            let mut logarithms: Vec<Complex<f64>> =
                work.amplitude.iter().map(|a| Complex::new(a.max(floor).ln(), 0.0)).collect();
            let mut value = vec![0.0; work.length];
            work.transforms.inverse(&mut logarithms, &mut value);
            value.truncate(work.length / 2 + 1);
            value.iter_mut().for_each(|value| *value /= work.length as f64);
            Ok(Cepstrum { resolution_s: record.sample_rate_hz().recip(), value })
        };
        self.release_large_buffers(record);
        cepstrum
    }
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::super::AnalysisSettings;
    use super::*;
    use crate::Record;

    /// An impulse train with a period of 50 samples has its first rahmonic there.
    #[test]
    fn a_family_of_lines_is_a_peak_at_its_period() {
        let samples = (0..5000).map(|i| if i % 50 == 7 { 1.0 } else { 0.001 * (i % 13) as f32 }).collect();
        let record = Record::new("1", Timestamp::UNIX_EPOCH, 1000.0, "g", samples).unwrap();
        let got = Analyzer::new(AnalysisSettings::default()).cepstrum(&record).unwrap();
        assert_eq!((got.value.len(), got.resolution_s), (2501, 1e-3));
        let highest = (20..100).max_by(|&a, &b| got.value[a].total_cmp(&got.value[b])).unwrap();
        assert_eq!(highest, 50);
    }

    #[test]
    fn a_constant_has_no_cepstrum() {
        let record = Record::new("1", Timestamp::UNIX_EPOCH, 1000.0, "g", vec![2.0; 100]).unwrap();
        assert_eq!(Analyzer::new(AnalysisSettings::default()).cepstrum(&record), Err(NotComputed::Constant));
    }
}
