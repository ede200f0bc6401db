//! What one transform says of a record, without memory being taken: for those who look at very many.

use super::analyzer::Analyzer;
use super::envelope::{BandError, BandSource, EnvelopeBand, band_bins};
use super::indicators::Absence;
use super::mesh_lines::{MeshLine, MeshPositions};
use super::record::Record;
use super::speed::{MeshContext, ShaftSpeed};

/// A record's numbers and spectra. The spectra lie in the analyzer's work space, which the next record writes over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading<'a> {
    /// Root mean square, the mean not removed.
    pub rms: f64,
    /// Kurtosis, not excess.
    pub kurtosis: Result<f64, Absence>,
    /// The shaft speed, where it is given or found.
    pub shaft_speed: Option<ShaftSpeed>,
    /// Amplitude of the first mesh line.
    pub omx: Result<f64, Absence>,
    /// The mesh harmonics that could be read, in rising order.
    pub mesh_lines: &'a [MeshLine],
    /// Distance of the bins of both spectra in hertz.
    pub resolution_hz: f64,
    /// Hann amplitude (peak) spectrum.
    pub amplitude: &'a [f64],
    /// The envelope's band.
    pub band: EnvelopeBand,
    /// Hann amplitude (peak) spectrum of the band's envelope, or why there is none.
    pub envelope: Result<&'a [f64], BandError>,
}

impl Analyzer {
    /// The same numbers and spectra as [`analyze`](Self::analyze), [`amplitude_spectrum`](Self::amplitude_spectrum) and
    /// [`envelope_spectrum`](Self::envelope_spectrum) give, in `band_hz` or else around the strongest mesh harmonic. From the second record
    /// of one length on no memory is taken.
    pub fn read(&mut self, record: &Record, mesh: &MeshContext, band_hz: Option<[f64; 2]>) -> Reading<'_> {
        let (moments, located) = self.locate(record, mesh);
        let resolution_hz = self.work.resolution_hz(record);
        let lines = located.mesh.map(|mesh_bins| MeshPositions::new(mesh_bins, mesh));
        self.lines.clear();
        let mut omx = lines.map(|_| 0.0);
        for order in 1..=self.settings.harmonics {
            let line = lines.and_then(|lines| lines.read(&mut self.work, order as f64).ok_or(Absence::AboveNyquist));
            if order == 1 {
                omx = line.map(|(line, _)| line.amplitude);
            }
            let Ok((line, _)) = line else { break };
            self.lines.push(MeshLine {
                order: order as u32,
                frequency_hz: line.position * resolution_hz,
                amplitude: line.amplitude,
            });
        }
        let band = match (band_hz, located.speed) {
            (Some(band_hz), _) => Some(EnvelopeBand::given(band_hz, BandSource::Query)),
            (None, Some(speed)) => self.mesh_band(record, &speed),
            (None, None) => None,
        };
        let whole = [0.0, 0.5 * record.sample_rate_hz()];
        let band = band.unwrap_or(EnvelopeBand::given(whole, BandSource::Whole));
        let work = &mut self.work;
        let bins = band_bins(band.band_hz, work.length, record.sample_rate_hz());
        let envelope = bins.map(|bins| work.envelope.compute(&work.bins, work.length, bins, &mut work.transforms));
        Reading {
            rms: moments.rms,
            kurtosis: moments.kurtosis(),
            shaft_speed: located.speed,
            omx,
            mesh_lines: &self.lines,
            resolution_hz,
            amplitude: &self.work.amplitude,
            band,
            envelope: envelope.map(|()| &self.work.envelope.amplitude[..]),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use jiff::Timestamp;

    use super::super::{AnalysisSettings, EnvelopeSearch, OtherMeshes};
    use super::*;

    /// The same bits as the methods that give each by itself, also after a record of another length.
    #[test]
    fn a_reading_is_what_the_single_methods_give() {
        let mesh = MeshContext {
            teeth: 24,
            nominal_shaft_speed_hz: 16.64,
            tolerance: 0.05,
            nominal_is_exact: false,
            others: OtherMeshes::NONE,
        };
        let mut analyzer = Analyzer::new(AnalysisSettings::default());
        for samples in [20_000, 7919, 20_000, 50] {
            let signal = (0..samples).map(|i| {
                let turn = TAU * 16.7 * f64::from(i) / 20_000.0;
                (0.3 + (1.0 + 0.2 * turn.cos()) * ((24.0 * turn).sin() + 0.5 * (48.0 * turn).sin()) + 0.01 * f64::from(i * i % 19)) as f32
            });
            let record = Record::new("1", Timestamp::UNIX_EPOCH, 20_000.0, "g", signal.collect()).unwrap();
            let mut other = Analyzer::new(AnalysisSettings::default());
            let want = other.analyze(&record, &mesh);
            let spectrum = other.amplitude_spectrum(&record);
            let band = other.envelope_band(&record, want.shaft_speed.as_ref(), EnvelopeSearch::MeshHarmonic);
            let envelope = other.envelope_spectrum(&record, band.band_hz).map(|spectrum| spectrum.amplitude);
            let got = analyzer.read(&record, &mesh, None);
            assert_eq!(Some(got.rms), want.indicators.get("rms"));
            assert_eq!(got.kurtosis.ok(), want.indicators.get("kurtosis"));
            assert_eq!(got.omx.ok(), want.indicators.get("omx"));
            assert_eq!((got.mesh_lines, got.shaft_speed), (&want.mesh_lines[..], want.shaft_speed));
            assert_eq!((got.amplitude, got.band), (&spectrum.amplitude[..], band));
            assert_eq!(got.envelope.map(<[f64]>::to_vec), envelope);
        }
    }

    /// Work space and plans come with the first record; from the second one on nothing is allocated, whatever the band.
    #[test]
    fn a_second_reading_takes_no_memory() {
        let mesh = MeshContext {
            teeth: 24,
            nominal_shaft_speed_hz: 16.64,
            tolerance: 0.05,
            nominal_is_exact: false,
            others: OtherMeshes::NONE,
        };
        let record = |n: u32| {
            let signal = (0..20_000u32).map(|i| {
                let turn = TAU * 16.7 * f64::from(i) / 20_000.0;
                ((1.0 + 0.2 * turn.cos()) * (24.0 * turn).sin() + 0.01 * f64::from((i * i + n) % 19)) as f32
            });
            Record::new("1", Timestamp::UNIX_EPOCH, 20_000.0, "g", signal.collect()).unwrap()
        };
        let mut analyzer = Analyzer::new(AnalysisSettings::default());
        assert!(analyzer.read(&record(0), &mesh, None).envelope.is_ok());
        for n in 1..4 {
            let record = record(n);
            let counted = allocation_counter::measure(|| {
                let reading = analyzer.read(&record, &mesh, None);
                assert!(reading.envelope.is_ok() && reading.mesh_lines.len() == 10);
            });
            assert_eq!(counted.count_total, 0);
        }
    }
}
