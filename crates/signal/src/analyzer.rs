//! The analysis of one record, from a single transform of the whole record.

use smol_str::format_smolstr;

use super::band::Band;
use super::by_name::ByName;
use super::checks::{insert_checks, insert_shaft_lines};
use super::comb::HARMONICS;
use super::faults::fault;
use super::features::{Extent, Features};
use super::indicators::Indicators;
use super::kurtogram::KurtogramWork;
use super::line::DETECTION_RATIO;
use super::mesh_context::MeshContext;
use super::mesh_lines::{MeshLine, MeshPositions};
use super::moments::Moments;
use super::not_computed::NotComputed;
use super::record::{OperatingPoint, RecordOf};
use super::record_spectrum::RecordSpectrum;
use super::resampling::Resampler;
use super::spectrum::Spectrum;
use super::speed::{LocatedMesh, ShaftSpeed, SpeedSource, given_speed, locate};
use super::speed_compensation::{Mesh, compensate};
use super::transform::spectrum_length;
use super::velocity::{VELOCITY_RMS, velocity_rms};

/// Buffers of records longer than this are freed after use, so that one long record does not hold memory
/// forever.
const MAX_RETAINED_SAMPLES: usize = 1 << 22;

/// Room for the indicators beside those of the mesh harmonics and of bands.
const INDICATORS_BESIDE_HARMONICS: usize = 22;

/// Room for each kind of a record's features.
const FEATURES: usize = 32;

/// Settings of an analysis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnalysisSettings {
    /// Number H of mesh harmonics used by indicators, 10 by default.
    pub harmonics: usize,
    /// Precision of the transform from which indicators and features come.
    pub precision: Precision,
}

impl Default for AnalysisSettings {
    fn default() -> Self {
        Self { harmonics: 10, precision: Precision::Single }
    }
}

/// Precision of a record's transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// That of the samples. Relative to the highest bin, the error of a bin is at most 2·10⁻⁷, and 10⁻⁹ root
    /// mean square: far below the noise of a measured record.
    Single,
    /// For simulated records without noise, whose weakest lines are 10⁻⁶ of the highest one.
    Double,
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

    /// Transforms a record and locates the mesh comb in its spectrum.
    pub(super) fn locate(&mut self, record: &RecordOf<'_>, mesh: &MeshContext) -> (Moments, LocatedMesh) {
        let moments = match self.settings.precision {
            Precision::Single => self.work.transform_in_single_precision(record),
            Precision::Double => self.work.transform(record),
        };
        let located = self.locate_transformed(record, mesh, &moments);
        (moments, located)
    }

    /// Locates the mesh comb in the spectrum of the record that was transformed last.
    fn locate_transformed(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        moments: &Moments,
    ) -> LocatedMesh {
        let work = &mut self.work;
        let resolution_hz = work.resolution_hz(record);
        let given = given_speed(record);
        let mut located = locate(
            &work.amplitude,
            resolution_hz,
            given,
            mesh,
            moments.constant,
            &mut work.sorting,
            &mut work.log_ratios,
        );
        if let (true, Ok(mesh_bins)) = (located.is_smeared, located.mesh) {
            located.verify(self.count_compensated_lines(record, mesh, mesh_bins));
        }
        located
    }

    /// Returns how many mesh harmonics stand out once the fluctuation of the speed is removed.
    fn count_compensated_lines(&mut self, record: &RecordOf<'_>, mesh: &MeshContext, mesh_bins: f64) -> u32 {
        let work = &mut self.work;
        let speed_mesh = Mesh { bins: mesh_bins, teeth: mesh.teeth, sample_rate_hz: record.sample_rate_hz() };
        let compensated = compensate(work, speed_mesh, self.settings.harmonics.max(HARMONICS));
        let mean_bins = compensated.as_ref().map_or(mesh_bins, |compensated| compensated.mesh_bins);
        let lines = MeshPositions::new(mean_bins, mesh);
        let found = (1..=HARMONICS)
            .map(|order| order as f64)
            .filter(|order| lines.is_own(*order, 0.0))
            .filter_map(|order| lines.read(work, order))
            .filter(|(line, noise)| noise.is_some_and(|noise| line.amplitude >= DETECTION_RATIO * noise))
            .count() as u32;
        if let Some(compensated) = compensated {
            compensated.undo(work);
        }
        found
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
        let harmonics = if mesh.teeth > 0 { self.settings.harmonics } else { 0 };
        let mut indicators = Indicators {
            values: ByName::with_capacity(INDICATORS_BESIDE_HARMONICS + harmonics + bands.len()),
            ..Indicators::default()
        };
        moments.indicate(&mut indicators);
        for band in bands {
            let value = band.rms(&work.amplitude, work.length, record.sample_rate_hz(), record.unit());
            indicators.insert(band.indicator(), value);
        }
        let mut features = Features {
            values: ByName::with_capacity(FEATURES),
            background: ByName::with_capacity(FEATURES),
            checks: ByName::with_capacity(FEATURES),
            ..Features::default()
        };
        let deviation = moments.deviation();
        let velocity = deviation
            .and_then(|_| velocity_rms(&work.amplitude, work.length, record.sample_rate_hz(), record.unit()));
        indicators.insert(VELOCITY_RMS, velocity);
        if let (Ok(deviation), Ok(kurtosis)) = (deviation, moments.kurtosis()) {
            features.values.insert("ln_rms", deviation.ln());
            features.values.insert("ln_kurtosis", kurtosis.ln());
        }

        let lines = located.mesh.map(|mesh_bins| MeshPositions::new(mesh_bins, mesh));
        let mut mesh_lines = Vec::with_capacity(harmonics);
        for order in 1..=harmonics {
            let line =
                lines.and_then(|lines| lines.read(work, order as f64).ok_or(NotComputed::AboveNyquist));
            let is_own = lines.is_ok_and(|lines| lines.is_own(order as f64, 0.0));
            let amplitude = line
                .and_then(|(line, _)| if is_own { Ok(line.amplitude) } else { Err(NotComputed::OtherMesh) });
            indicators.insert(format_smolstr!("mesh_{order}"), amplitude);
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
            let harmonics = self.settings.harmonics.max(HARMONICS);
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
                    features.insert_line(
                        format_smolstr!("ln_mesh_{order}"),
                        line.amplitude,
                        noise,
                        deviation,
                    );
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
        self.transformed_spectrum(record)
    }

    /// Returns the Hann amplitude spectrum of a record with its mean removed, and the shaft speed that
    /// [`analyze`](Self::analyze) finds; `None` if it is not known.
    pub fn spectrum_and_speed(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> (Spectrum, Option<ShaftSpeed>) {
        let moments = self.work.transform(record);
        let located = self.locate_transformed(record, mesh, &moments);
        (self.transformed_spectrum(record), located.speed)
    }

    /// Returns the spectrum of the record that was transformed last.
    fn transformed_spectrum(&mut self, record: &RecordOf<'_>) -> Spectrum {
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
mod tests;
