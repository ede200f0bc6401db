//! The fast kurtogram: the band in which a record is most impulsive.

use flankwatch_fourier::Complex;
use serde::Serialize;

use super::not_computed::NotComputed;
use super::transform::{Transforms, smooth_at_least};

/// Fewest bins of a band: the kurtosis of noise scatters by 2/√64 = 0.25 there.
const MIN_BINS: usize = 64;

/// The finest division: 2⁸ bands.
const MAX_BANDS: usize = 256;

/// Number of cached plans: one per division.
const MAX_PLANS: usize = 18;

/// A band whose mean power is below this fraction of the strongest one's contains only rounding errors.
const MIN_POWER_FRACTION: f64 = 1e-18;

/// Spectral kurtosis of a record over bands of several widths.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Kurtogram {
    /// The divisions of the spectrum, the coarsest first: 1, 2, 3, 4, 6, 8, 12 … bands.
    pub levels: Vec<KurtogramLevel>,
    /// The band with the highest kurtosis.
    pub best: KurtogramBand,
}

/// One division of the spectrum into bands of one width.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KurtogramLevel {
    /// Width of a band in hertz.
    pub bandwidth_hz: f64,
    /// Kurtosis of each band's envelope, from the lowest frequency up: 0 in Gaussian noise, −1 for a steady
    /// sine, and 0 for an empty band.
    pub kurtosis: Vec<f64>,
}

/// One band of a kurtogram.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KurtogramBand {
    /// Lowest and highest frequency in hertz.
    pub band_hz: [f64; 2],
    /// Kurtosis of its envelope.
    pub kurtosis: f64,
}

/// Buffers for kurtograms.
pub(super) struct KurtogramWork {
    transforms: Transforms,
    packed: Vec<Complex<f64>>,
    real: Vec<f64>,
    imaginary: Vec<f64>,
}

impl Default for KurtogramWork {
    fn default() -> Self {
        Self {
            transforms: Transforms::with_max_plans(MAX_PLANS),
            packed: Vec::new(),
            real: Vec::new(),
            imaginary: Vec::new(),
        }
    }
}

impl KurtogramWork {
    /// Computes the kurtogram of the bins from 1 on, `resolution_hz` apart, the last one below `nyquist_hz`.
    pub(super) fn of(
        &mut self,
        bins: &[Complex<f64>],
        resolution_hz: f64,
        nyquist_hz: f64,
    ) -> Result<Kurtogram, NotComputed> {
        let mut levels = Vec::new();
        let mut best: Option<(f64, KurtogramBand)> = None;
        let strongest = bins.iter().map(|bin| bin.norm_sqr()).fold(0.0, f64::max);
        for bands in divisions(bins.len()) {
            let edge = |band: usize| band * bins.len() / bands;
            // Bands differ in width by one bin at most.
            let samples = smooth_at_least(2 * bins.len().div_ceil(bands) + 1, &[2, 3, 5]);
            let kurtosis: Vec<f64> = (0..bands)
                .map(|band| self.kurtosis(&bins[edge(band)..edge(band + 1)], samples, strongest))
                .collect();
            for (band, &kurtosis) in kurtosis.iter().enumerate() {
                // On a tie the wider band wins, as it comes first.
                if best.is_none_or(|(highest, _)| kurtosis > highest) {
                    let band_hz = [edge(band), edge(band + 1)]
                        .map(|edge| ((edge as f64 + 0.5) * resolution_hz).min(nyquist_hz));
                    best = Some((kurtosis, KurtogramBand { band_hz, kurtosis }));
                }
            }
            let bandwidth_hz = bins.len() as f64 / bands as f64 * resolution_hz;
            levels.push(KurtogramLevel { bandwidth_hz, kurtosis });
        }
        let (_, best) = best.ok_or(NotComputed::TooShort)?;
        Ok(Kurtogram { levels, best })
    }

    /// Returns the kurtosis of the complex envelope of these bins over `samples` samples.
    fn kurtosis(&mut self, bins: &[Complex<f64>], samples: usize, strongest: f64) -> f64 {
        let power: f64 = bins.iter().map(|bin| bin.norm_sqr()).sum();
        if power <= MIN_POWER_FRACTION * strongest * bins.len() as f64 {
            return 0.0;
        }
        // Scaled to a mean power of 1; the real and the imaginary part are two real signals.
        let scale = power.sqrt().recip();
        for (output, factor) in [
            (&mut self.real, Complex::new(0.5 * scale, 0.0)),
            (&mut self.imaginary, Complex::new(0.0, -0.5 * scale)),
        ] {
            self.packed.clear();
            self.packed.resize(samples / 2 + 1, Complex::default());
            for (packed, bin) in self.packed[1..].iter_mut().zip(bins) {
                *packed = bin * factor;
            }
            output.resize(samples, 0.0);
            self.transforms.inverse(&mut self.packed, output);
        }
        let mut fourth = 0.0;
        for (real, imaginary) in self.real.chunks(64).zip(self.imaginary.chunks(64)) {
            let sum: f64 = real.iter().zip(imaginary).map(|(re, im)| (re * re + im * im).powi(2)).sum();
            fourth += sum;
        }
        fourth / samples as f64 - 2.0
    }
}

/// Returns the numbers of bands 1, 2, 3, 4, 6, 8, 12 … while each band has enough bins.
fn divisions(bins: usize) -> impl Iterator<Item = usize> {
    let binary = (0..).map(|level| 1_usize << level);
    binary
        .flat_map(|bands| [bands, bands + bands / 2])
        // One band has no half more.
        .skip(1)
        .take_while(move |bands| *bands <= MAX_BANDS && bins / bands >= MIN_BINS)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use jiff::Timestamp;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use serde::Deserialize;

    use super::super::analyzer::Analyzer;
    use super::super::{AnalysisSettings, BandSource, EnvelopeSearch};
    use super::*;
    use crate::Record;

    const RATE_HZ: f64 = 20_000.0;

    fn record(samples: Vec<f32>) -> Record {
        Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "g", samples).unwrap()
    }

    fn analyzer() -> Analyzer {
        Analyzer::new(AnalysisSettings::default())
    }

    /// A resonance at 6 kHz that rings for 1 ms is struck 87 times a second, under noise twice its strength
    /// and a strong low tone.
    fn struck(samples: usize) -> Record {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let signal = (0..samples).map(|i| {
            let t = i as f64 / RATE_HZ;
            let since = t % (1.0 / 87.0);
            let ringing = (-since / 1e-3).exp() * (TAU * 6000.0 * since).sin();
            let noise: f64 = StandardNormal.sample(&mut random);
            (ringing + 0.3 * noise + 2.0 * (TAU * 411.0 * t).sin()) as f32
        });
        record(signal.collect())
    }

    #[derive(Deserialize)]
    struct Case {
        name: String,
        samples: Vec<f32>,
        sample_rate_hz: f64,
        levels: Vec<Vec<f64>>,
        best_kurtosis: f64,
        best_band_hz: [f64; 2],
    }

    /// Each band filtered and raised to its powers at the full sampling rate by NumPy.
    #[test]
    fn every_band_equals_numpy() {
        let text = include_str!("../../../fixtures/reference/signal/kurtogram_vectors.json");
        let cases: Vec<Case> = serde_json::from_str(text).unwrap();
        assert_eq!(cases.len(), 4);
        for case in cases {
            let record =
                Record::new("1", Timestamp::UNIX_EPOCH, case.sample_rate_hz, "g", case.samples).unwrap();
            let got = analyzer().kurtogram(&record).unwrap();
            assert_eq!(got.levels.len(), case.levels.len(), "{}", case.name);
            for (got, want) in got.levels.iter().zip(&case.levels) {
                assert_eq!(got.kurtosis.len(), want.len());
                for (got, want) in got.kurtosis.iter().zip(want) {
                    assert!((got - want).abs() <= 1e-9 * (want.abs() + 2.0), "{}: {got} {want}", case.name);
                }
            }
            assert!((got.best.kurtosis - case.best_kurtosis).abs() < 1e-8);
            for (got, want) in got.best.band_hz.iter().zip(case.best_band_hz) {
                assert!((got - want).abs() < 1e-9 * want, "{}: {:?}", case.name, got);
            }
        }
    }

    #[test]
    fn a_struck_resonance_is_found_and_its_rate_read() {
        let record = struck(40_000);
        let mut analyzer = analyzer();
        let found = analyzer.kurtogram(&record).unwrap();
        let [low, high] = found.best.band_hz;
        assert!(low < 6000.0 && 6000.0 < high && high - low < 3500.0, "{:?}", found.best);
        assert!(found.best.kurtosis > 1.0, "{:?}", found.best);
        let band = analyzer.envelope_band(&record, None, EnvelopeSearch::Kurtogram);
        assert_eq!((band.band_hz, band.source), (found.best.band_hz, BandSource::Kurtogram));
        assert_eq!(band.spectral_kurtosis, Some(found.best.kurtosis));
        let envelope = analyzer.envelope_spectrum(&record, band.band_hz).unwrap();
        let highest =
            (20..1000).max_by(|&a, &b| envelope.amplitude[a].total_cmp(&envelope.amplitude[b])).unwrap();
        assert!((envelope.frequency_hz(highest) - 87.0).abs() < 1.0);
    }

    /// Gaussian noise has 0 within four of its standard errors 2/√bins, a steady sine −1.
    #[test]
    fn noise_and_a_sine_have_their_kurtosis() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let noise = record((0..40_000).map(|_| StandardNormal.sample(&mut random)).collect());
        let found = analyzer().kurtogram(&noise).unwrap();
        assert_eq!(
            found.levels.iter().map(|level| level.kurtosis.len()).collect::<Vec<_>>(),
            divisions(19_999).collect::<Vec<_>>()
        );
        assert_eq!(found.levels.last().unwrap().kurtosis.len(), 256);
        for level in &found.levels {
            let bins = 19_999.0 / level.kurtosis.len() as f64;
            assert!(level.kurtosis.iter().all(|k| k.abs() < 4.5 * 2.0 / f64::sqrt(bins)), "{level:?}");
        }
        let sine =
            record((0..40_000).map(|i| (TAU * 3001.7 * f64::from(i) / RATE_HZ).sin() as f32).collect());
        assert!((analyzer().kurtogram(&sine).unwrap().levels[0].kurtosis[0] + 1.0).abs() < 1e-3);
    }

    #[test]
    fn short_and_constant_records_report_the_reason() {
        assert_eq!(analyzer().kurtogram(&record(vec![1.0; 1000])), Err(NotComputed::Constant));
        let short =
            |samples: usize| analyzer().kurtogram(&record((0..samples).map(|i| (i % 7) as f32).collect()));
        assert_eq!(short(128), Err(NotComputed::TooShort));
        assert_eq!(short(129).unwrap().levels.len(), 1);
        let band = analyzer().envelope_band(&record(vec![1.0, 2.0]), None, EnvelopeSearch::Kurtogram);
        assert_eq!((band.source, band.spectral_kurtosis), (BandSource::Whole, None));
    }
}
