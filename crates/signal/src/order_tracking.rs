//! Analysis over the angle of the driving shaft (order tracking), for records at any speed.

use super::analyzer::Analyzer;
use super::angle_record::{AngleRecord, OrderSpectrum};
use super::faults::fault;
use super::features::Features;
use super::foreign_lines::NEAR_ORDER_BINS;
use super::gear_indicators::{AngleUsed, GearAnalysis};
use super::gear_signals::GearSignals;
use super::indicators::NotComputed;
use super::mesh_phase::MeshBand;
use super::moments::Moments;
use super::record::RecordOf;
use super::resampling::MIN_TURNS;
use super::shaft_angle::ShaftAngle;
use super::speed::{LocatedMesh, MeshContext, given_speed};
use super::tooth_contrast;
use super::transform::Transforms;

/// A record over its shaft angle, with the reason if it has a tachometer that was not used; or why there is
/// no angle.
pub(super) type AngleRecordResult = Result<(AngleRecord, Option<String>), NotComputed>;

impl Analyzer {
    /// Determines the angle of the driving shaft without a tachometer: from the phase of a mesh harmonic near
    /// the mesh comb; if the line leaves that band, anywhere within the tolerance of the speed; else from the
    /// record's constant speed. [`ShaftAngle::source`] tells which.
    ///
    /// # Errors
    /// Why there is no shaft speed, as for the mesh lines of [`analyze`](Self::analyze).
    pub fn shaft_angle(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> Result<ShaftAngle, NotComputed> {
        let (moments, located) = self.locate(record, mesh);
        let angle = self.tracked_angle(record, mesh, moments.constant, located.mesh);
        self.release_large_buffers(record);
        angle
    }

    /// Determines the angle for the record that was transformed last, with its mesh frequency at `located`
    /// bins.
    fn tracked_angle(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        constant: bool,
        located: Result<f64, NotComputed>,
    ) -> Result<ShaftAngle, NotComputed> {
        let work = &mut self.work;
        let resolution_hz = work.resolution_hz(record);
        let speed_hz = given_speed(record).map_or(mesh.nominal_shaft_speed_hz, |(speed_hz, _)| speed_hz);
        let band = |mesh_hz: f64| MeshBand {
            bins: &work.bins,
            length: work.length,
            sample_rate_hz: record.sample_rate_hz(),
            teeth: mesh.teeth,
            mesh_hz,
        };
        let located_hz = located.map(|bins| bins * resolution_hz);
        let usable = mesh.teeth > 0 && speed_hz > 0.0 && speed_hz.is_finite() && !constant;
        let mut angle = None;
        if let Ok(mesh_hz) = located_hz
            && usable
        {
            angle = match work.tracked_angle.take() {
                Some(angle) => angle,
                None => band(mesh_hz).track_known(&mut work.transforms),
            };
        }
        if angle.is_none() && usable {
            angle = band(f64::from(mesh.teeth) * speed_hz)
                .track_wide(mesh.tolerance.max(0.0), &mut work.transforms);
        }
        match (angle, located_hz) {
            (Some(angle), _) => Ok(angle),
            (None, Ok(mesh_hz)) => ShaftAngle::constant(mesh_hz / f64::from(mesh.teeth), record.duration_s())
                .ok_or(NotComputed::NoSpeed),
            (None, Err(reason)) => Err(reason),
        }
    }

    /// Resamples a record over the angle of the driving shaft: `angle` if given, else that of the record's
    /// tachometer if its pulses are usable, else [`shaft_angle`](Self::shaft_angle).
    ///
    /// # Errors
    /// Why there is no angle, or [`NotComputed::TooFewTurns`], [`NotComputed::AboveNyquist`],
    /// [`NotComputed::SpeedVaries`].
    pub fn angle_record(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        angle: Option<&ShaftAngle>,
    ) -> Result<AngleRecord, NotComputed> {
        if let Some(angle) = angle {
            return self.resampled(record, mesh, angle);
        }
        if let Some(Ok(angle_record)) = self.by_tachometer(record, mesh) {
            return Ok(angle_record);
        }
        let angle = self.shaft_angle(record, mesh)?;
        self.resampled(record, mesh, &angle)
    }

    pub(super) fn resampled(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        angle: &ShaftAngle,
    ) -> Result<AngleRecord, NotComputed> {
        self.resampler.resample(record, angle, f64::from(mesh.teeth) + 1.0)
    }

    /// Resamples a record over its tachometer's angle; an error tells why its pulses cannot be used. `None`
    /// without a tachometer.
    fn by_tachometer(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> Option<Result<AngleRecord, String>> {
        Some(match record.tachometer_angle()? {
            Ok(angle) => self.resampled(record, mesh, &angle).map_err(|reason| match reason {
                NotComputed::TooFewTurns => {
                    format!("its pulses cover fewer than {MIN_TURNS} whole turns of the record")
                }
                NotComputed::AboveNyquist => {
                    "at its speed the mesh frequency lies above half the sampling rate".to_owned()
                }
                _ => "its speed varies too much".to_owned(),
            }),
            Err(error) => Err(error.to_string()),
        })
    }

    /// Returns the amplitude spectrum over orders of the driving shaft; arguments and errors as for
    /// [`angle_record`](Self::angle_record).
    pub fn order_spectrum(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        angle: Option<&ShaftAngle>,
    ) -> Result<OrderSpectrum, NotComputed> {
        let angle_record = self.angle_record(record, mesh, angle)?;
        Ok(angle_record.order_spectrum(&mut self.work.transforms))
    }

    /// Returns the synchronous average of the driving shaft and its components; arguments and errors as for
    /// [`angle_record`](Self::angle_record).
    pub fn gear_signals(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        angle: Option<&ShaftAngle>,
    ) -> Result<GearSignals, NotComputed> {
        let angle_record = self.angle_record(record, mesh, angle)?.without_other_meshes(mesh);
        split(&angle_record, mesh, &mut self.work.transforms)
    }

    /// Computes the indicators over the driving shaft's angle (see [`Indicators`](super::Indicators));
    /// arguments as for [`angle_record`](Self::angle_record). A record that is clipped or has gaps has none,
    /// as its waveform is not the machine's.
    pub fn gear_indicators(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        angle: Option<&ShaftAngle>,
    ) -> GearAnalysis {
        self.try_gear_indicators(record, mesh, angle).unwrap_or_else(GearAnalysis::absent)
    }

    fn try_gear_indicators(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        angle: Option<&ShaftAngle>,
    ) -> Result<GearAnalysis, NotComputed> {
        let (moments, located) = self.locate(record, mesh);
        let angle_record = usable(record, &moments).and_then(|()| match angle {
            Some(angle) => self
                .resampled(record, mesh, angle)
                .map(|angle_record| (angle_record.without_other_meshes(mesh), None)),
            None => self.best_angle_record(record, mesh, &moments, &located),
        });
        self.release_large_buffers(record);
        let (angle_record, refused) = angle_record?;
        let analysis = self.indicate_angle_record(mesh, &angle_record, refused);
        self.resampler.recycle(angle_record);
        analysis
    }

    /// Resamples the record that was transformed last over the best available angle, or returns its `fault`.
    pub(super) fn angle_record_located(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        (moments, located): &(Moments, LocatedMesh),
        fault: Option<NotComputed>,
    ) -> AngleRecordResult {
        match fault {
            Some(fault) => Err(fault),
            None => self.best_angle_record(record, mesh, moments, located),
        }
    }

    /// Recycles the buffer of a record over an angle.
    pub(super) fn recycle(&mut self, angle_record: AngleRecordResult) {
        if let Ok((angle_record, _)) = angle_record {
            self.resampler.recycle(angle_record);
        }
    }

    /// Computes the indicators over the angle of a record.
    pub(super) fn gear_indicators_of(
        &mut self,
        mesh: &MeshContext,
        angle_record: &AngleRecordResult,
    ) -> GearAnalysis {
        let angle_record = angle_record.as_ref().map_err(|reason| *reason);
        angle_record
            .and_then(|(angle_record, refused)| {
                self.indicate_angle_record(mesh, angle_record, refused.clone())
            })
            .unwrap_or_else(GearAnalysis::absent)
    }

    /// Inserts the checks for differing teeth, if the record has an angle and its mesh was found.
    pub(super) fn insert_tooth_checks(
        &mut self,
        mesh: &MeshContext,
        angle_record: &AngleRecordResult,
        features: &mut Features,
    ) {
        if let Ok((angle_record, _)) = angle_record
            && features.has_mesh()
        {
            tooth_contrast::insert_tooth_checks(
                angle_record,
                mesh,
                self.settings.harmonics,
                &mut self.work.transforms,
                features,
            );
        }
    }

    /// Resamples the record over the best available angle, without the lines of other meshes.
    fn best_angle_record(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        moments: &Moments,
        located: &LocatedMesh,
    ) -> AngleRecordResult {
        let refused = match self.by_tachometer(record, mesh) {
            Some(Ok(angle_record)) => return Ok((angle_record.without_other_meshes(mesh), None)),
            Some(Err(reason)) => Some(reason),
            None => None,
        };
        let angle = self.tracked_angle(record, mesh, moments.constant, located.mesh)?;
        Ok((self.resampled(record, mesh, &angle)?.without_other_meshes(mesh), refused))
    }

    fn indicate_angle_record(
        &mut self,
        mesh: &MeshContext,
        angle_record: &AngleRecord,
        refused: Option<String>,
    ) -> Result<GearAnalysis, NotComputed> {
        let transforms = &mut self.work.transforms;
        let tracked = angle_record
            .mesh_line(mesh.teeth, transforms)
            .map(|line| line.amplitude)
            .ok_or(NotComputed::AboveNyquist);
        let signals = split(angle_record, mesh, transforms)?;
        let angle =
            AngleUsed { source: angle_record.angle, turns: angle_record.turns, tachometer_refused: refused };
        let analysis = GearAnalysis::of(&signals, tracked, angle, self.settings.harmonics);
        signals.recycle(transforms);
        Ok(analysis)
    }
}

/// Splits the average of a record's turns.
pub(super) fn split(
    angle_record: &AngleRecord,
    mesh: &MeshContext,
    transforms: &mut Transforms,
) -> Result<GearSignals, NotComputed> {
    let [mut average, mut odd] = [transforms.buffer(), transforms.buffer()];
    angle_record.average_into([&mut average, &mut odd]);
    // Lines between two orders were removed before; those near an order cannot be distinguished from it.
    let near = NEAR_ORDER_BINS / angle_record.turns as f64;
    let is_foreign = |order: usize| mesh.others.has_line_near(order as f64, near);
    let signals = GearSignals::split(&average, mesh.teeth, &is_foreign, transforms);
    transforms.recycle(average);
    transforms.recycle(odd);
    signals.ok_or(NotComputed::AboveNyquist)
}

/// Returns an error if a record is clipped or has gaps.
fn usable(record: &RecordOf<'_>, moments: &Moments) -> Result<(), NotComputed> {
    let flagged = record.quality().clipped.then_some(NotComputed::Clipped);
    match fault(record.samples(), moments.range).or(flagged) {
        Some(fault) => Err(fault),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use jiff::Timestamp;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::{AnalysisSettings, AngleSource, OperatingPoint, OtherMeshes};
    use super::*;
    use crate::Record;

    const RATE_HZ: f64 = 20_000.0;
    const SAMPLES: usize = 200_000;
    const SHAFT_HZ: f64 = 16.64;
    const TEETH: u32 = 24;

    const MESH: MeshContext = MeshContext {
        teeth: TEETH,
        mate_teeth: 0,
        nominal_shaft_speed_hz: SHAFT_HZ,
        tolerance: 0.05,
        nominal_is_exact: false,
        others: OtherMeshes::NONE,
    };

    /// Revolutions after `t` seconds at 16.64 Hz·(1 + s·sin(2π·0.13·t)).
    fn revolutions(t: f64, swing: f64) -> f64 {
        let rate = TAU * 0.13;
        SHAFT_HZ * (t + swing * (1.0 - (rate * t).cos()) / rate)
    }

    /// Mesh harmonics of amplitude 1/h with 20 % amplitude modulation once per turn, and white noise.
    fn record(swing: f64, noise: f64) -> Record {
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let signal = (0..SAMPLES).map(|i| {
            let turn = TAU * revolutions(i as f64 / RATE_HZ, swing);
            let lines: f64 = (1..=5)
                .map(|h| {
                    (1.0 + 0.2 * turn.cos()) / f64::from(h)
                        * (f64::from(TEETH * h) * turn + f64::from(h * h)).sin()
                })
                .sum();
            let normal: f64 = StandardNormal.sample(&mut random);
            (lines + noise * normal) as f32
        });
        Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "m/s2", signal.collect()).unwrap()
    }

    fn analyzer() -> Analyzer {
        Analyzer::new(AnalysisSettings::default())
    }

    fn tracked(record: &Record, angle: Option<&ShaftAngle>) -> GearAnalysis {
        analyzer().gear_indicators(record, &MESH, angle)
    }

    /// The amplitude put in is 1. Without order tracking the line of a speed that swings by 5 % is smeared to
    /// less than a fifth.
    #[test]
    fn a_swinging_speed_reads_as_a_constant_one() {
        let constant = tracked(&record(0.0, 0.3), None).indicators.values["omx_tracked"];
        assert!((constant - 1.0).abs() < 0.005, "{constant}");
        for (swing, noise) in [(0.05, 0.0), (0.05, 0.3), (0.03, 1.0), (0.01, 0.3), (-0.05, 0.3)] {
            let swept = record(swing, noise);
            let got = tracked(&swept, None);
            let omx = got.indicators.values["omx_tracked"];
            assert!((omx / constant - 1.0).abs() < 0.01, "{swing} {noise}: {omx} {:?}", got.angle);
            assert!(matches!(got.source(), Some(AngleSource::MeshPhase { .. })));
            let untracked = analyzer().analyze(&swept, &MESH).indicators.get("omx").unwrap_or(0.0);
            assert!(untracked < 0.5, "{untracked}");
        }
    }

    /// One pulse a turn, from 1 s before the record to 1 s after it; the pulses are where the angle is whole.
    #[test]
    fn a_tachometer_gives_the_angle() {
        let mut pulses = Vec::new();
        let mut t = -1.0;
        let mut next = revolutions(t, 0.05).ceil();
        while t < 11.0 {
            for _ in 0..40 {
                t += (next - revolutions(t, 0.05)) / SHAFT_HZ;
            }
            pulses.push(t);
            next += 1.0;
        }
        let angle = ShaftAngle::from_pulses(&pulses, 1).unwrap();
        let got = tracked(&record(0.05, 0.3), Some(&angle));
        assert!(
            matches!(got.source(), Some(AngleSource::Tachometer { pulses: count, .. }) if count == pulses.len())
        );
        let omx = got.indicators.values["omx_tracked"];
        assert!((omx - 1.0).abs() < 0.01, "{omx}");
        // The modulation's phase is that of the pulses: cos at zero angle.
        let signals = analyzer().gear_signals(&record(0.05, 0.3), &MESH, Some(&angle)).unwrap();
        let turn = signals.mesh_envelope.len() as f64;
        for (i, modulation) in signals.mesh_envelope.iter().enumerate() {
            let want = 0.2 * (TAU * i as f64 / turn).cos();
            assert!((modulation - want).abs() < 0.06, "{i}: {modulation} {want}");
        }
    }

    /// Amplitudes put in: mesh 1, sidebands 0.1 each; σ² of the average Σ (1 + 0.02)/2h².
    #[test]
    fn sidebands_and_ratios_match_the_generated_ones() {
        let got = tracked(&record(0.04, 0.1), None).indicators.values;
        let deviation = ((1..=5).map(|h| 1.02 / f64::from(2 * h * h)).sum::<f64>()).sqrt();
        let level = got["sideband_level_factor"];
        assert!((level / (0.2 / deviation) - 1.0).abs() < 0.03, "{level}");
        let energy = got["sideband_energy_ratio"];
        assert!((0.19..0.28).contains(&energy), "{energy}");
    }

    #[test]
    fn untrackable_records_report_the_reason() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let noise: Vec<f32> = (0..SAMPLES).map(|_| StandardNormal.sample(&mut random)).collect();
        let with =
            |samples: Vec<f32>| Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "g", samples).unwrap();
        let reason = |record: &Record, mesh: &MeshContext| {
            let got = analyzer().gear_indicators(record, mesh, None);
            assert!(got.indicators.values.is_empty() && got.angle.is_none());
            let reasons: std::collections::BTreeSet<String> =
                got.indicators.absent.values().map(|reason| format!("{reason:?}")).collect();
            reasons.into_iter().collect::<Vec<_>>().join(" ")
        };
        assert_eq!(reason(&with(noise.clone()), &MESH), "NoSpeed");
        assert_eq!(reason(&with(vec![1.5; 20_000]), &MESH), "Constant");
        assert_eq!(reason(&record(0.0, 0.1), &MeshContext::unknown()), "NoSpeed");
        let short = with(record(0.0, 0.1).samples()[..4000].to_vec());
        let exact = MeshContext { nominal_is_exact: true, ..MESH };
        assert_eq!(reason(&short, &exact), "TooFewTurns");
        let clipped = record(0.0, 0.01).samples().iter().map(|x| x.clamp(-0.8, 0.8)).collect();
        assert_eq!(reason(&with(clipped), &MESH), "Clipped");
        let mut gap = record(0.0, 0.1).samples().to_vec();
        gap[5000..6000].fill(0.0);
        assert_eq!(reason(&with(gap), &MESH), "Gaps");
        let fast =
            OperatingPoint { shaft_speed_hz: Some(500.0), torque_nm: None, ..OperatingPoint::default() };
        assert_eq!(reason(&with(noise.clone()).with_operating_point(fast).unwrap(), &MESH), "AboveNyquist");
        // A given speed without a trackable line is taken as constant, and reported as such.
        let got = analyzer().gear_indicators(&with(noise), &exact, None);
        assert_eq!(got.source(), Some(AngleSource::ConstantSpeed));
    }
}
