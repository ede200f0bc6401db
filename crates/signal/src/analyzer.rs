//! The analysis of one record, from a single transform of the whole record.

use super::band::Band;
use super::checks::{insert_checks, insert_shaft_lines};
use super::envelope::{BandError, BandSource, EnvelopeBand, EnvelopeSearch, band_bins};
use super::faults::fault;
use super::features::{Extent, Features};
use super::indicators::{Indicators, NotComputed};
use super::kurtogram::KurtogramWork;
use super::line::read_line;
use super::mesh_lines::{MeshLine, MeshPositions};
use super::moments::Moments;
use super::record::{OperatingPoint, RecordOf};
use super::record_spectrum::RecordSpectrum;
use super::resampling::Resampler;
use super::spectrum::Spectrum;
use super::speed::{LocatedMesh, MeshContext, ShaftSpeed, SpeedSource, given_speed, locate};
use super::speed_compensation::{Mesh, compensate};
use super::transform::spectrum_length;
use super::velocity::{VELOCITY_RMS, velocity_rms};

/// Half-width of the default envelope band around a mesh harmonic, in mesh frequencies.
const DEFAULT_BAND_MESHES: f64 = 1.5;

/// Buffers of records longer than this are freed after use, so that one long record does not hold memory
/// forever.
const MAX_RETAINED_SAMPLES: usize = 1 << 22;

/// Number of mesh harmonics among the features.
const FEATURE_HARMONICS: usize = 16;

/// Settings of an analysis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnalysisSettings {
    /// Number H of mesh harmonics used by indicators, 10 by default.
    pub harmonics: usize,
}

impl Default for AnalysisSettings {
    fn default() -> Self {
        Self { harmonics: 10 }
    }
}

/// The result of analysing one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Analysis {
    /// Condition indicators.
    pub indicators: Indicators,
    /// Features for the wear estimate.
    pub features: Features,
    /// The shaft speed; `None` if it is neither given nor found.
    pub shaft_speed: Option<ShaftSpeed>,
    /// The mesh harmonics that could be read, in ascending order.
    pub mesh_lines: Vec<MeshLine>,
}

/// Computes spectra, indicators and features of records. Reuses its transform plans and buffers from record
/// to record; use one per worker thread.
pub struct Analyzer {
    pub(super) settings: AnalysisSettings,
    pub(super) work: RecordSpectrum,
    pub(super) resampler: Resampler,
    pub(super) kurtogram: KurtogramWork,
}

impl Analyzer {
    /// Creates an analyzer without transform plans.
    pub fn new(settings: AnalysisSettings) -> Self {
        Self {
            settings,
            work: RecordSpectrum::default(),
            resampler: Resampler::default(),
            kurtogram: KurtogramWork::default(),
        }
    }

    /// Computes the indicators and features of a record. The shaft speed is the first one available of: the
    /// record's operating point, its tachometer, the asset's exact nominal speed, the mesh comb. Indicators
    /// that cannot be computed are omitted, with a reason.
    pub fn analyze(&mut self, record: &RecordOf<'_>, mesh: &MeshContext) -> Analysis {
        self.analyze_with_bands(record, mesh, &[])
    }

    /// Like [`analyze`](Self::analyze), with the values of `bands` among the indicators.
    pub fn analyze_with_bands(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        bands: &[Band],
    ) -> Analysis {
        let located = self.locate(record, mesh);
        let mut analysis = self.analyze_located(record, mesh, bands, &located);
        if located.1.mesh.is_ok() {
            let angle_record = self.angle_record_located(record, mesh, &located, analysis.features.fault);
            self.insert_tooth_checks(mesh, &angle_record, &mut analysis.features);
            self.recycle(angle_record);
        }
        self.release_large_buffers(record);
        analysis
    }

    /// Finds the shaft speed of a record, as [`analyze`](Self::analyze) does; `None` if it is not known.
    pub fn shaft_speed(&mut self, record: &RecordOf<'_>, mesh: &MeshContext) -> Option<ShaftSpeed> {
        self.locate(record, mesh).1.speed
    }

    /// Transforms a record and locates the mesh comb in its spectrum.
    pub(super) fn locate(&mut self, record: &RecordOf<'_>, mesh: &MeshContext) -> (Moments, LocatedMesh) {
        let work = &mut self.work;
        let moments = work.transform(record);
        let resolution_hz = work.resolution_hz(record);
        let given = given_speed(record);
        let located = locate(
            &work.amplitude,
            resolution_hz,
            given,
            mesh,
            moments.constant,
            &mut work.sorting,
            &mut work.log_ratios,
        );
        (moments, located)
    }

    /// Analyses the record that was transformed last.
    pub(super) fn analyze_located(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        bands: &[Band],
        (moments, located): &(Moments, LocatedMesh),
    ) -> Analysis {
        let work = &mut self.work;
        let resolution_hz = work.resolution_hz(record);
        let mut indicators = Indicators::default();
        moments.indicate(&mut indicators);
        for band in bands {
            let value = band.rms(&work.amplitude, work.length, resolution_hz, record.unit());
            indicators.insert(band.indicator(), value);
        }
        let mut features = Features::default();
        let deviation = moments.deviation();
        let velocity =
            deviation.and_then(|_| velocity_rms(&work.amplitude, work.length, resolution_hz, record.unit()));
        indicators.insert(VELOCITY_RMS, velocity);
        if let (Ok(deviation), Ok(kurtosis)) = (deviation, moments.kurtosis()) {
            features.values.insert("ln_rms".to_owned(), deviation.ln());
            features.values.insert("ln_kurtosis".to_owned(), kurtosis.ln());
        }

        let lines = located.mesh.map(|mesh_bins| MeshPositions::new(mesh_bins, mesh));
        let mut mesh_lines = Vec::new();
        let harmonics = if mesh.teeth > 0 { self.settings.harmonics } else { 0 };
        for order in 1..=harmonics {
            let line =
                lines.and_then(|lines| lines.read(work, order as f64).ok_or(NotComputed::AboveNyquist));
            let is_own = lines.is_ok_and(|lines| lines.is_own(order as f64, 0.0));
            let amplitude = line
                .and_then(|(line, _)| if is_own { Ok(line.amplitude) } else { Err(NotComputed::OtherMesh) });
            indicators.insert(format!("mesh_{order}"), amplitude);
            if order == 1 {
                indicators.insert("omx", amplitude);
            }
            let Ok((line, _)) = line else { continue };
            mesh_lines.push(MeshLine {
                order: order as u32,
                frequency_hz: line.position * resolution_hz,
                amplitude: line.amplitude,
            });
        }
        let mut speed = located.speed;
        let doubt = speed.and_then(|speed| Some((speed.source, speed.doubt_message()?)));
        match doubt {
            Some((SpeedSource::MeshComb, doubt)) => features.speed_doubt = Some(doubt),
            Some((_, doubt)) => features.given_speed_doubt = Some(doubt),
            None => {}
        }
        let certain = located.mesh.ok().filter(|_| features.speed_doubt.is_none());
        if let Ok(deviation) = deviation {
            let comb = certain.map(|mesh_bins| (mesh_bins, mesh));
            let uncertain = |speed: &ShaftSpeed| speed.source == SpeedSource::Nominal;
            let shaft = speed.filter(|speed| mesh.teeth == 0 && !uncertain(speed));
            let shaft_bins = match certain {
                Some(mesh_bins) => Some(mesh_bins / f64::from(mesh.teeth)),
                None => shaft.map(|speed| speed.shaft_speed_hz / resolution_hz),
            };
            insert_checks(work, resolution_hz, comb, deviation, &mut features);
            if let Some(shaft_bins) = shaft_bins {
                insert_shaft_lines(work, shaft_bins, mesh.others, deviation, &mut features);
            }
        }
        if let (Some(mesh_bins), Ok(deviation)) = (certain, deviation) {
            let speed_mesh =
                Mesh { bins: mesh_bins, teeth: mesh.teeth, sample_rate_hz: record.sample_rate_hz() };
            let harmonics = self.settings.harmonics.max(FEATURE_HARMONICS);
            let compensated = compensate(work, speed_mesh, harmonics);
            if let (Some(compensated), Some(found)) = (&compensated, &mut speed)
                && found.source == SpeedSource::MeshComb
            {
                found.mesh_frequency_hz = compensated.mesh_bins * resolution_hz;
                found.shaft_speed_hz = found.mesh_frequency_hz / f64::from(mesh.teeth);
            }
            let lines = MeshPositions::new(
                compensated.as_ref().map_or(mesh_bins, |compensated| compensated.mesh_bins),
                mesh,
            );
            for order in (1..=harmonics).filter(|order| lines.is_own(*order as f64, 0.0)) {
                if let Some((line, noise)) = lines.read(work, order as f64) {
                    features.insert_line(format!("ln_mesh_{order}"), line.amplitude, noise, deviation);
                }
            }
            lines.sidebands(work, deviation, &mut features);
            lines.envelopes(work, deviation, &mut features);
            if let Some(compensated) = compensated {
                compensated.undo(work);
            }
        }
        features.extent = Some(Extent {
            seconds: record.samples().len() as f64 / record.sample_rate_hz(),
            sample_rate_hz: record.sample_rate_hz(),
        });
        features.operating_point = OperatingPoint {
            shaft_speed_hz: speed.map(|speed| speed.shaft_speed_hz),
            torque_nm: record.operating_point().torque_nm,
            ..OperatingPoint::default()
        };
        let flagged = record.quality().clipped.then_some(NotComputed::Clipped);
        features.fault = fault(record.samples(), moments.range).or(flagged);
        Analysis { indicators, features, shaft_speed: speed, mesh_lines }
    }

    /// Returns the Hann amplitude spectrum of a record with its mean removed.
    pub fn amplitude_spectrum(&mut self, record: &RecordOf<'_>) -> Spectrum {
        self.work.transform(record);
        let spectrum =
            Spectrum::hann(record.unit(), self.work.resolution_hz(record), self.work.amplitude.clone());
        self.release_large_buffers(record);
        spectrum
    }

    /// Returns the power spectral density of a record with its mean removed, under one Hann window over the
    /// whole record.
    pub fn power_spectral_density(&mut self, record: &RecordOf<'_>) -> Spectrum {
        self.amplitude_spectrum(record).into_density(spectrum_length(record.samples().len()))
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

    /// Frees the buffers if the record is a very long one.
    pub(super) fn release_large_buffers(&mut self, record: &RecordOf<'_>) {
        if record.samples().len() > MAX_RETAINED_SAMPLES {
            self.work = RecordSpectrum::default();
            self.resampler.release();
            self.kurtogram = KurtogramWork::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, SQRT_2};

    use jiff::Timestamp;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::{OperatingPoint, OtherMeshes, SpeedSource};
    use super::*;
    use crate::Record;

    const RATE_HZ: f64 = 20_000.0;
    const SHAFT_HZ: f64 = 16.71;

    const MESH: MeshContext = MeshContext {
        teeth: 24,
        mate_teeth: 0,
        nominal_shaft_speed_hz: 16.64,
        tolerance: 0.05,
        nominal_is_exact: false,
        others: OtherMeshes::NONE,
    };

    /// Harmonics of amplitude 1/h, once-per-turn amplitude modulation of depth 0.2, and white noise of this
    /// deviation.
    fn gear(samples: usize, noise: f64, offset: f64) -> Record {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let signal = (0..samples).map(|i| {
            let turn = 2.0 * PI * SHAFT_HZ * i as f64 / RATE_HZ;
            let lines: f64 = (1..=10)
                .map(|h| {
                    (1.0 + 0.2 * turn.cos()) / f64::from(h)
                        * (24.0 * f64::from(h) * turn + f64::from(h * h)).sin()
                })
                .sum();
            let normal: f64 = StandardNormal.sample(&mut random);
            (offset + lines + noise * normal) as f32
        });
        record(signal.collect())
    }

    fn record(samples: Vec<f32>) -> Record {
        Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "m/s2", samples).unwrap()
    }

    fn at_speed(record: Record, shaft_speed_hz: f64) -> Record {
        let point = OperatingPoint {
            shaft_speed_hz: Some(shaft_speed_hz),
            torque_nm: None,
            ..OperatingPoint::default()
        };
        record.with_operating_point(point).unwrap()
    }

    fn analyze(record: &Record, mesh: MeshContext) -> Analysis {
        Analyzer::new(AnalysisSettings::default()).analyze(record, &mesh)
    }

    /// The amplitudes put in: A_h = 1/h; each sideband 0.1/h, two of them; the envelope's shaft line 0.2/h.
    /// With and without noise.
    #[test]
    fn generated_lines_are_measured() {
        for noise in [0.0, 0.05] {
            let got = analyze(&gear(40_000, noise, 0.0), MESH);
            let speed = got.shaft_speed.unwrap();
            assert_eq!(speed.source, SpeedSource::MeshComb);
            assert!((speed.shaft_speed_hz - SHAFT_HZ).abs() < 1e-3, "{speed:?}");
            let within = 2e-3 + 0.1 * noise;
            for order in 1..=10 {
                let want = 1.0 / f64::from(order);
                let line = got.indicators.values[&format!("mesh_{order}")];
                assert!((line / want - 1.0).abs() < within, "{order}: {line}");
            }
            assert_eq!(got.indicators.values["omx"], got.indicators.values["mesh_1"]);
            assert_eq!(got.mesh_lines.len(), 10);
            assert!((got.mesh_lines[9].frequency_hz - 240.0 * SHAFT_HZ).abs() < 0.1);
            for order in 1..=4 {
                let sideband = got.features.values[&format!("ln_sideband_{order}")].exp();
                assert!(
                    (sideband * f64::from(order) / (0.1 * SQRT_2) - 1.0).abs() < 10.0 * within,
                    "{order}: {sideband}"
                );
                let envelope = got.features.values[&format!("ln_env_{order}")].exp();
                assert!(
                    (envelope * f64::from(order) / 0.2 - 1.0).abs() < 10.0 * within,
                    "{order}: {envelope}"
                );
            }
        }
    }

    /// White noise of deviation s: root-mean-square amplitude s·√(4·1.5/N) in a Hann bin, twice that in four
    /// sidebands.
    #[test]
    fn backgrounds_match_the_generated_noise() {
        let got = analyze(&gear(40_000, 0.05, 0.0), MESH);
        let bin = 0.05 * (6.0_f64 / 40_000.0).sqrt();
        for order in 1..=4 {
            for (name, want) in [("ln_mesh", bin), ("ln_sideband", 2.0 * bin)] {
                let background = got.features.background[&format!("{name}_{order}")];
                assert!((background - want.ln()).abs() < 0.3, "{name} {order}: {background} {}", want.ln());
            }
        }
        let Features { values, checks, background, .. } = &got.features;
        assert!(background.keys().all(|name| values.contains_key(name) || checks.contains_key(name)));
        // Without lines of the shaft its checks are read in noise alone.
        for order in 1..=3 {
            let name = format!("ln_shaft_{order}");
            assert!(
                (checks[&name] - background[&name]).abs() < 0.3,
                "{name}: {} {}",
                checks[&name],
                background[&name]
            );
        }
    }

    /// A gain shifts every feature but the kurtosis by its logarithm; an offset changes none.
    #[test]
    fn gain_is_an_offset_and_an_offset_has_no_effect() {
        let plain = analyze(&gear(20_000, 0.05, 0.0), MESH).features;
        let record_with_gain = gear(20_000, 0.05, 0.0).samples().iter().map(|x| 8.0 * x).collect();
        let gained = analyze(&record(record_with_gain), MESH).features;
        let moved = analyze(&gear(20_000, 0.05, 3.0), MESH).features;
        assert_eq!(plain.values.len(), 16 + 4 + 4 + 2);
        for (name, value) in &plain.values {
            let gain = if name == "ln_kurtosis" { 0.0 } else { 8.0_f64.ln() };
            assert!((gained.values[name] - value - gain).abs() < 1e-9, "{name}");
            assert!((moved.values[name] - value).abs() < 1e-3, "{name}");
        }
    }

    #[test]
    fn a_given_speed_is_kept_and_its_lines_are_located() {
        let got = analyze(&at_speed(gear(200_000, 0.05, 0.0), 16.7), MESH);
        let speed = got.shaft_speed.unwrap();
        assert_eq!((speed.shaft_speed_hz, speed.source), (16.7, SpeedSource::Record));
        assert!((got.mesh_lines[0].frequency_hz - 24.0 * SHAFT_HZ).abs() < 0.01);
        let exact = MeshContext { nominal_is_exact: true, nominal_shaft_speed_hz: SHAFT_HZ, ..MESH };
        assert_eq!(analyze(&gear(20_000, 0.05, 0.0), exact).shaft_speed.unwrap().source, SpeedSource::Asset);
    }

    #[test]
    fn missing_indicators_have_a_reason() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let noise = record((0..20_000).map(|_| StandardNormal.sample(&mut random)).collect());
        let got = analyze(&noise, MESH);
        assert_eq!((got.shaft_speed, got.mesh_lines.len()), (None, 0));
        assert_eq!(got.indicators.absent["omx"], NotComputed::NoSpeed);
        assert_eq!(got.features.values.keys().collect::<Vec<_>>(), ["ln_kurtosis", "ln_rms"]);

        for (samples, reason) in [
            (vec![0.0; 20_000], NotComputed::Constant),
            (vec![-9.81; 199_999], NotComputed::Constant),
            (vec![1.0], NotComputed::Constant),
            (vec![1.0, 2.0], NotComputed::TooShort),
            (noise.samples()[..150].to_vec(), NotComputed::TooShort),
        ] {
            for given in [false, true] {
                let record = record(samples.clone());
                let record = if given { at_speed(record, SHAFT_HZ) } else { record };
                let got = analyze(&record, MESH);
                assert_eq!(got.indicators.absent["omx"], reason, "{} samples", samples.len());
                assert_eq!(got.shaft_speed.is_some(), given);
            }
        }

        let got = analyze(&at_speed(gear(20_000, 0.05, 0.0), 100.0), MESH);
        assert_eq!(got.indicators.absent["mesh_5"], NotComputed::AboveNyquist);
        assert!(got.indicators.get("mesh_4").is_some());
        for shaft_speed_hz in [1e5, 1e6, 1e-300] {
            assert_eq!(analyze(&at_speed(gear(2000, 0.05, 0.0), shaft_speed_hz), MESH).mesh_lines, []);
        }
        for nominal_shaft_speed_hz in [0.0, -5.0, f64::NAN, f64::INFINITY] {
            for nominal_is_exact in [false, true] {
                let mesh = MeshContext { nominal_shaft_speed_hz, nominal_is_exact, ..MESH };
                assert_eq!(analyze(&noise, mesh).indicators.absent["omx"], NotComputed::NoSpeed);
            }
        }
    }

    #[test]
    fn every_short_length_is_analysed() {
        let mut analyzer = Analyzer::new(AnalysisSettings::default());
        let long = gear(1200, 0.05, 1.0);
        for length in 1..=1200 {
            let record = at_speed(record(long.samples()[..length].to_vec()), SHAFT_HZ);
            let got = analyzer.analyze(&record, &MESH);
            let numbers = got.indicators.values.values().chain(got.features.values.values());
            assert!(numbers.chain(got.features.background.values()).all(|x| x.is_finite()), "{length}");
            assert_eq!(got.indicators.values.len() + got.indicators.absent.len(), 16);
            let spectrum = analyzer.amplitude_spectrum(&record);
            assert_eq!(spectrum.amplitude.len(), length / 2 + 1);
            let band =
                analyzer.envelope_band(&record, got.shaft_speed.as_ref(), EnvelopeSearch::MeshHarmonic);
            let envelope = analyzer.envelope_spectrum(&record, band.band_hz);
            let too_short = length < 60 && matches!(envelope, Err(BandError::TooNarrow { .. }));
            assert!(envelope.is_ok() || too_short, "{length}: {envelope:?}");
        }
    }

    proptest! {
        #[test]
        fn any_finite_samples_give_finite_numbers(
            samples in prop::collection::vec(prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO, 1..600),
            shaft_speed_hz in prop::option::of(1e-3..1e4),
            teeth in 0_u32..300,
            tolerance in 0.0..1.5,
        ) {
            let point = OperatingPoint { shaft_speed_hz, torque_nm: None, ..OperatingPoint::default() };
            let record = record(samples).with_operating_point(point).unwrap();
            let got = analyze(&record, MeshContext { teeth, tolerance, ..MESH });
            prop_assert!(got.indicators.values.values().all(|x| x.is_finite()), "{:?}", got.indicators);
            prop_assert!(got.features.values.values().all(|x| x.is_finite()), "{:?}", got.features);
            let of_mesh = if teeth > 0 { 11 } else { 0 };
            prop_assert_eq!(got.indicators.values.len() + got.indicators.absent.len(), 5 + of_mesh);
        }
    }

    #[test]
    fn the_default_band_is_around_the_strongest_harmonic() {
        let mut analyzer = Analyzer::new(AnalysisSettings::default());
        let record = gear(20_000, 0.05, 0.0);
        let speed = analyzer.analyze(&record, &MESH).shaft_speed.unwrap();
        let mesh_hz = speed.mesh_frequency_hz;
        let mut band = |speed| analyzer.envelope_band(&record, speed, EnvelopeSearch::MeshHarmonic);
        assert_eq!(
            band(Some(&speed)),
            EnvelopeBand::given([0.5 * mesh_hz, 2.5 * mesh_hz], BandSource::StrongestMeshHarmonic)
        );
        assert_eq!(band(None), EnvelopeBand::given([0.0, 10_000.0], BandSource::Whole));
    }
}
