//! One record's analysis: a single transform of the whole record serves everything.

use super::envelope::{BandError, BandSource, band_bins};
use super::features::Features;
use super::indicators::{Absence, Indicators};
use super::line::read_line;
use super::mesh_lines::{MeshLine, MeshPositions};
use super::record::Record;
use super::record_spectrum::RecordSpectrum;
use super::spectrum::Spectrum;
use super::speed::{MeshContext, ShaftSpeed, locate};
use super::transform::spectrum_length;

/// The default envelope band's reach around a mesh harmonic in mesh frequencies.
const DEFAULT_BAND_MESHES: f64 = 1.5;

/// Work space for records above this length is given back after use: one long record must not hold its memory for ever.
const KEPT_SAMPLES: usize = 1 << 22;

/// What is to be worked out of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnalysisSettings {
    /// Mesh harmonics H to be read, 10 by default.
    pub harmonics: usize,
}

impl Default for AnalysisSettings {
    fn default() -> Self {
        Self { harmonics: 10 }
    }
}

/// What one record says.
#[derive(Debug, Clone, PartialEq)]
pub struct Analysis {
    /// Condition indicators.
    pub indicators: Indicators,
    /// Features for the wear estimate.
    pub features: Features,
    /// The shaft speed; `None` where it is neither given nor found.
    pub shaft_speed: Option<ShaftSpeed>,
    /// The mesh harmonics that could be read, in rising order.
    pub mesh_lines: Vec<MeshLine>,
}

/// Turns records into spectra, indicators and features. Keeps its transform plans and work space from record to record, so one
/// belongs to each worker thread.
pub struct Analyzer {
    settings: AnalysisSettings,
    work: RecordSpectrum,
}

impl Analyzer {
    /// An analyzer with nothing planned yet.
    pub fn new(settings: AnalysisSettings) -> Self {
        Self {
            settings,
            work: RecordSpectrum::default(),
        }
    }

    /// Indicators and features of a record. Its shaft speed is that of its operating point, else the asset's where that is
    /// exact, else the one found from the mesh comb. What cannot be computed is absent with its reason.
    pub fn analyze(&mut self, record: &Record, mesh: &MeshContext) -> Analysis {
        let work = &mut self.work;
        let moments = work.transform(record);
        let resolution_hz = work.resolution_hz(record);
        let given_hz = record.operating_point().shaft_speed_hz;
        let located = locate(&work.amplitude, resolution_hz, given_hz, mesh, moments.constant, &mut work.sorting);

        let mut indicators = Indicators::default();
        moments.indicate(&mut indicators);
        let mut features = Features::default();
        let deviation = moments.deviation();
        if let (Ok(deviation), Ok(kurtosis)) = (deviation, moments.kurtosis()) {
            features.values.insert("ln_rms".to_owned(), deviation.ln());
            features.values.insert("ln_kurtosis".to_owned(), kurtosis.ln());
        }

        let lines = located.mesh.map(|mesh_bins| MeshPositions::new(mesh_bins, mesh.teeth));
        let mut mesh_lines = Vec::new();
        for order in 1..=self.settings.harmonics {
            let line = lines.and_then(|lines| lines.read(work, order as f64).ok_or(Absence::AboveNyquist));
            let amplitude = line.map(|(line, _)| line.amplitude);
            indicators.insert(format!("mesh_{order}"), amplitude);
            if order == 1 {
                indicators.insert("omx", amplitude);
            }
            let Ok((line, noise)) = line else { continue };
            mesh_lines.push(MeshLine {
                order: order as u32,
                frequency_hz: line.position * resolution_hz,
                amplitude: line.amplitude,
            });
            if let Ok(deviation) = deviation {
                features.insert_line(format!("ln_mesh_{order}"), line.amplitude, noise, deviation);
            }
        }
        if let (Ok(lines), Ok(deviation)) = (lines, deviation) {
            lines.sidebands(work, deviation, &mut features);
            lines.envelopes(work, deviation, &mut features);
        }
        self.give_back(record);
        Analysis {
            indicators,
            features,
            shaft_speed: located.speed,
            mesh_lines,
        }
    }

    /// The Hann amplitude spectrum of a record with its mean removed.
    pub fn amplitude_spectrum(&mut self, record: &Record) -> Spectrum {
        self.work.transform(record);
        let spectrum = Spectrum::hann(record.unit(), self.work.resolution_hz(record), self.work.amplitude.clone());
        self.give_back(record);
        spectrum
    }

    /// The Hann amplitude spectrum of the envelope of a band `[low, high]` in hertz: the modulus, mean removed, of the analytic
    /// signal of the band's bins. It reaches up to the band's width.
    pub fn envelope_spectrum(&mut self, record: &Record, band_hz: [f64; 2]) -> Result<Spectrum, BandError> {
        let band = band_bins(band_hz, spectrum_length(record.samples().len()), record.sample_rate_hz())?;
        let work = &mut self.work;
        work.transform(record);
        work.envelope.compute(&work.bins, work.length, band, &mut work.transforms);
        let spectrum = Spectrum::hann(record.unit(), work.resolution_hz(record), work.envelope.amplitude.clone());
        self.give_back(record);
        Ok(spectrum)
    }

    /// The envelope's band in hertz where none is asked for: one and a half mesh frequencies to either side of the strongest mesh
    /// harmonic (not below half the mesh frequency), so that lines at the shaft rates and at the mesh frequency show; the whole
    /// spectrum where there is no shaft speed or no harmonic to be read.
    pub fn envelope_band(&mut self, record: &Record, speed: Option<&ShaftSpeed>) -> ([f64; 2], BandSource) {
        let nyquist_hz = 0.5 * record.sample_rate_hz();
        let whole = ([0.0, nyquist_hz], BandSource::Whole);
        let Some(speed) = speed else { return whole };
        let mesh_hz = speed.mesh_frequency_hz;
        self.work.transform(record);
        let mesh_bins = mesh_hz / self.work.resolution_hz(record);
        let strongest = (1..=self.settings.harmonics)
            .filter_map(|order| read_line(&self.work.amplitude, order as f64 * mesh_bins).map(|line| (order as f64, line.amplitude)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        self.give_back(record);
        let Some((order, _)) = strongest else { return whole };
        let low = (order - DEFAULT_BAND_MESHES).max(0.5) * mesh_hz;
        let high = ((order + DEFAULT_BAND_MESHES) * mesh_hz).min(nyquist_hz);
        ([low, high], BandSource::StrongestMeshHarmonic)
    }

    /// Drops work space that only a very long record needs.
    fn give_back(&mut self, record: &Record) {
        if record.samples().len() > KEPT_SAMPLES {
            self.work = RecordSpectrum::default();
        }
    }
}
