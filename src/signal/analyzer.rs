//! One record's analysis: a single transform of the whole record serves everything.

use realfft::num_complex::Complex;
use serde::Serialize;

use super::envelope::{BandError, BandSource, Envelope, band_bins};
use super::features::Features;
use super::indicators::{Absence, Indicators};
use super::line::{background, fits, read_line};
use super::mesh_comb::SHAFT_RESOLVED_BINS;
use super::moments::Moments;
use super::record::Record;
use super::spectrum::{Spectrum, hann_amplitude};
use super::speed::{MeshContext, ShaftSpeed, locate};
use super::transform::{Transforms, spectrum_length};

/// Mesh harmonics whose sidebands and envelopes are features.
const SIDEBAND_HARMONICS: usize = 4;

/// Sidebands taken on each side of a harmonic.
const SIDEBANDS: usize = 2;

/// The envelope band's reach around a mesh harmonic: in shaft rates for the features, in mesh frequencies by default otherwise.
const FEATURE_BAND_SHAFTS: f64 = 2.5;
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

/// One mesh harmonic as it was found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeshLine {
    /// Its order h, from 1.
    pub order: u32,
    /// Its frequency in hertz, interpolated between bins.
    pub frequency_hz: f64,
    /// Its amplitude (peak) in the record's unit.
    pub amplitude: f64,
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
    work: Work,
}

/// Everything of a record's transform, and room to work in.
#[derive(Default)]
struct Work {
    transforms: Transforms,
    centred: Vec<f64>,
    bins: Vec<Complex<f64>>,
    amplitude: Vec<f64>,
    envelope: Envelope,
    sorting: Vec<f64>,
    length: usize,
}

impl Work {
    /// Transforms a record, its mean removed: `bins` without a window, `amplitude` with the Hann window.
    fn transform(&mut self, record: &Record) -> Moments {
        let moments = Moments::of(record.samples(), &mut self.centred);
        self.length = spectrum_length(self.centred.len());
        self.transforms.forward(&mut self.centred[..self.length], &mut self.bins);
        hann_amplitude(&self.bins, self.length, &mut self.amplitude);
        moments
    }

    fn resolution_hz(&self, record: &Record) -> f64 {
        record.sample_rate_hz() / self.length as f64
    }
}

impl Analyzer {
    /// An analyzer with nothing planned yet.
    pub fn new(settings: AnalysisSettings) -> Self {
        Self {
            settings,
            work: Work::default(),
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

        let mut mesh_lines = Vec::new();
        for order in 1..=self.settings.harmonics {
            let line = located
                .mesh
                .and_then(|mesh| read_line(&work.amplitude, order as f64 * mesh).ok_or(Absence::AboveNyquist));
            if let Ok(line) = line {
                mesh_lines.push(MeshLine {
                    order: order as u32,
                    frequency_hz: line.position * resolution_hz,
                    amplitude: line.amplitude,
                });
            }
            let amplitude = line.map(|line| line.amplitude);
            indicators.insert(format!("mesh_{order}"), amplitude);
            if order == 1 {
                indicators.insert("omx", amplitude);
            }
        }
        if let (Ok(mesh_bins), Ok(deviation)) = (located.mesh, deviation) {
            let shaft_bins = mesh_bins / f64::from(mesh.teeth);
            let shaft_bins = (shaft_bins >= SHAFT_RESOLVED_BINS).then_some(shaft_bins);
            let lines = MeshFeatures {
                mesh_bins,
                shaft_bins,
                deviation,
            };
            lines.mesh(work, &mesh_lines, &mut features);
            if let Some(shaft_bins) = shaft_bins {
                lines.sidebands(work, shaft_bins, &mut features);
                lines.envelopes(work, shaft_bins, &mut features);
            }
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
            self.work = Work::default();
        }
    }
}

/// The line features of one record. Positions are in bins.
struct MeshFeatures {
    mesh_bins: f64,
    /// The shaft rate, where the record resolves it.
    shaft_bins: Option<f64>,
    deviation: f64,
}

impl MeshFeatures {
    /// The noise in one bin beside mesh harmonic `order`.
    fn noise(&self, work: &mut Work, order: f64) -> Option<f64> {
        let reach = 0.5 * self.mesh_bins;
        background(&work.amplitude, order * self.mesh_bins, self.shaft_bins, reach, &mut work.sorting)
    }

    fn mesh(&self, work: &mut Work, lines: &[MeshLine], features: &mut Features) {
        for line in lines {
            let noise = self.noise(work, f64::from(line.order));
            features.insert_line(format!("ln_mesh_{}", line.order), line.amplitude, noise, self.deviation);
        }
    }

    fn sidebands(&self, work: &mut Work, shaft_bins: f64, features: &mut Features) {
        for order in 1..=SIDEBAND_HARMONICS {
            let centre = order as f64 * self.mesh_bins;
            let sidebands = (1..=SIDEBANDS).flat_map(|k| [centre - k as f64 * shaft_bins, centre + k as f64 * shaft_bins]);
            let energy: Option<f64> = sidebands
                .map(|position| read_line(&work.amplitude, position).map(|line| line.amplitude * line.amplitude))
                .sum();
            let Some(energy) = energy else { return };
            let noise = self.noise(work, order as f64).map(|noise| noise * (2.0 * SIDEBANDS as f64).sqrt());
            features.insert_line(format!("ln_sideband_{order}"), energy.sqrt(), noise, self.deviation);
        }
    }

    fn envelopes(&self, work: &mut Work, shaft_bins: f64, features: &mut Features) {
        let reach = FEATURE_BAND_SHAFTS * shaft_bins;
        for order in 1..=SIDEBAND_HARMONICS {
            let centre = order as f64 * self.mesh_bins;
            if centre <= reach + 1.0 || !fits(centre + reach, work.bins.len()) {
                return;
            }
            let band = [(centre - reach).ceil() as usize, (centre + reach).floor() as usize];
            work.envelope.compute(&work.bins, work.length, band, &mut work.transforms);
            let Some(line) = read_line(&work.envelope.amplitude, shaft_bins) else {
                return;
            };
            let noise = background(&work.envelope.amplitude, shaft_bins, Some(shaft_bins), reach, &mut work.sorting);
            features.insert_line(format!("ln_env_{order}"), line.amplitude, noise, self.deviation);
        }
    }
}
