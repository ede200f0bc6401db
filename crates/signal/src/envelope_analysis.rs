//! The kurtogram and envelope spectra of a record, and the choice of their band.

use super::analyzer::Analyzer;
use super::envelope::{BandError, BandSource, EnvelopeBand, EnvelopeSearch, band_bins};
use super::kurtogram::Kurtogram;
use super::line::read_line;
use super::not_computed::NotComputed;
use super::record::RecordOf;
use super::spectrum::Spectrum;
use super::speed::ShaftSpeed;
use super::transform::spectrum_length;

/// Half-width of the default envelope band around a mesh harmonic, in mesh frequencies.
const DEFAULT_BAND_MESHES: f64 = 1.5;

impl Analyzer {
    /// Computes the spectral kurtosis E|c|⁴/(E|c|²)² − 2 of the complex envelope c of every band of a
    /// binary-ternary division of the spectrum, and its maximum (J. Antoni, Fast computation of the kurtogram
    /// for the detection of transient faults, Mechanical Systems and Signal Processing 21, 2007, 108–124).
    ///
    /// Antoni filters with a tree of short filters. Here a band is a range of bins of the record's single
    /// transform: its edges are as sharp as the record allows, and frequencies do not drift down the tree.
    /// The envelope has more than two samples per bin, so the means of |c|² and |c|⁴ are exactly those at the
    /// full sampling rate. Division continues to 256 bands or while a band has 64 bins.
    ///
    /// # Errors
    /// [`NotComputed::Constant`], or [`NotComputed::TooShort`] below 129 samples.
    pub fn kurtogram(&mut self, record: &RecordOf<'_>) -> Result<Kurtogram, NotComputed> {
        let moments = self.work.transform(record);
        let kurtogram =
            if moments.constant { Err(NotComputed::Constant) } else { self.kurtogram_transformed(record) };
        self.release_large_buffers(record);
        kurtogram
    }

    /// Computes the kurtogram of the record that was transformed last, which is not constant.
    pub(super) fn kurtogram_transformed(&mut self, record: &RecordOf<'_>) -> Result<Kurtogram, NotComputed> {
        let resolution_hz = self.work.resolution_hz(record);
        let usable = (self.work.length - 1) / 2;
        let nyquist_hz = 0.5 * record.sample_rate_hz();
        self.kurtogram.of(&self.work.bins[1..=usable], resolution_hz, nyquist_hz)
    }

    /// Returns the Hann amplitude spectrum of the envelope of a band `[low, high]` in hertz: the modulus,
    /// mean removed, of the analytic signal of the band's bins. It reaches up to the band's width.
    pub fn envelope_spectrum(
        &mut self,
        record: &RecordOf<'_>,
        band_hz: [f64; 2],
    ) -> Result<Spectrum, BandError> {
        let band = band_bins(band_hz, spectrum_length(record.samples().len()), record.sample_rate_hz())?;
        let work = &mut self.work;
        work.transform(record);
        work.envelope.compute(&work.bins, work.length, band, &mut work.transforms);
        let spectrum =
            Spectrum::hann(record.unit(), work.resolution_hz(record), work.envelope.amplitude.clone());
        self.release_large_buffers(record);
        Ok(spectrum)
    }

    /// Chooses the envelope band if none is given.
    ///
    /// - `MeshHarmonic`: 1.5 mesh frequencies to either side of the strongest mesh harmonic (not below half
    ///   the mesh frequency), so that lines at the shaft rates and at the mesh frequency show; the whole
    ///   spectrum if there is no shaft speed or no readable harmonic.
    /// - `Kurtogram`: its best band; the whole spectrum if there is none.
    pub fn envelope_band(
        &mut self,
        record: &RecordOf<'_>,
        speed: Option<&ShaftSpeed>,
        search: EnvelopeSearch,
    ) -> EnvelopeBand {
        let whole = EnvelopeBand::given([0.0, 0.5 * record.sample_rate_hz()], BandSource::Whole);
        match search {
            EnvelopeSearch::Kurtogram => self.kurtogram(record).map_or(whole, |kurtogram| EnvelopeBand {
                band_hz: kurtogram.best.band_hz,
                source: BandSource::Kurtogram,
                spectral_kurtosis: Some(kurtogram.best.kurtosis),
            }),
            EnvelopeSearch::MeshHarmonic => {
                let Some(speed) = speed else { return whole };
                self.work.transform(record);
                let band = self.mesh_band(record, speed);
                self.release_large_buffers(record);
                band.unwrap_or(whole)
            }
        }
    }

    /// Returns the band around the strongest mesh harmonic of the record that was transformed last.
    pub(super) fn mesh_band(&self, record: &RecordOf<'_>, speed: &ShaftSpeed) -> Option<EnvelopeBand> {
        let mesh_hz = speed.mesh_frequency_hz;
        let mesh_bins = mesh_hz / self.work.resolution_hz(record);
        let (order, _) = (1..=self.settings.harmonics)
            .filter_map(|order| {
                read_line(&self.work.amplitude, order as f64 * mesh_bins)
                    .map(|line| (order as f64, line.amplitude))
            })
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        let low = (order - DEFAULT_BAND_MESHES).max(0.5) * mesh_hz;
        let high = ((order + DEFAULT_BAND_MESHES) * mesh_hz).min(0.5 * record.sample_rate_hz());
        Some(EnvelopeBand::given([low, high], BandSource::StrongestMeshHarmonic))
    }
}
