//! The synchronous average of a record and the indicators over the angle of the driving shaft.

use super::analyzer::Analyzer;
use super::angle_record::AngleRecord;
use super::features::Features;
use super::foreign_lines::NEAR_ORDER_BINS;
use super::gear_indicators::AngleUsed;
use super::gear_signals::GearSignals;
use super::indicators::Indicators;
use super::mesh_context::MeshContext;
use super::not_computed::NotComputed;
use super::order_tracking::AngleRecordResult;
use super::record::RecordOf;
use super::tooth_contrast;
use super::transform::Transforms;

impl Analyzer {
    /// Returns the synchronous average of the driving shaft and its components; errors as for
    /// [`angle_record`](Self::angle_record).
    pub fn gear_signals(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> Result<GearSignals, NotComputed> {
        let angle_record = self.angle_record(record, mesh)?.without_other_meshes(mesh);
        split(&angle_record, mesh, &mut self.work.transforms)
    }

    /// Computes the indicators over the angle of a record as [`condition`](Self::condition) does.
    #[cfg(test)]
    pub(super) fn gear_indicators(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> (Indicators, Option<AngleUsed>) {
        let located = self.locate(record, mesh);
        let fault = self.analyze_located(record, mesh, &[], &located).features.fault;
        let angle_record = self.angle_record_located(record, mesh, &located, fault);
        let mut indicators = Indicators::default();
        let angle = self.insert_gear_indicators(mesh, &angle_record, &mut indicators);
        (indicators, angle)
    }

    /// Inserts the indicators over the angle of a record, and returns the angle. Those that cannot be
    /// computed are omitted, with a reason.
    pub(super) fn insert_gear_indicators(
        &mut self,
        mesh: &MeshContext,
        angle_record: &AngleRecordResult,
        indicators: &mut Indicators,
    ) -> Option<AngleUsed> {
        let angle_record = angle_record.as_ref().map_err(|reason| *reason);
        let angle = angle_record.and_then(|(angle_record, refused)| {
            self.indicate_angle_record(mesh, angle_record, indicators)?;
            Ok(AngleUsed {
                source: angle_record.angle,
                turns: angle_record.turns,
                tachometer_refused: refused.clone(),
            })
        });
        angle.map_err(|reason| indicators.insert_no_angle(reason)).ok()
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
                &mut self.work,
                features,
            );
        }
    }

    fn indicate_angle_record(
        &mut self,
        mesh: &MeshContext,
        angle_record: &AngleRecord,
        indicators: &mut Indicators,
    ) -> Result<(), NotComputed> {
        let transforms = &mut self.work.transforms;
        let (line, average) = angle_record.mesh_line_and_average(mesh.teeth, transforms);
        let tracked = line.map(|line| line.amplitude).ok_or(NotComputed::AboveNyquist);
        let signals = split_average(average, angle_record, mesh, transforms)?;
        indicators.insert_over_angle(&signals, tracked, self.settings.harmonics);
        signals.recycle(transforms);
        Ok(())
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
    transforms.recycle(odd);
    split_average(average, angle_record, mesh, transforms)
}

/// Splits the average of a record's turns, and recycles its buffer.
fn split_average(
    average: Vec<f64>,
    angle_record: &AngleRecord,
    mesh: &MeshContext,
    transforms: &mut Transforms,
) -> Result<GearSignals, NotComputed> {
    // Lines between two orders were removed before; those near an order cannot be distinguished from it.
    let near = NEAR_ORDER_BINS / angle_record.turns as f64;
    let is_foreign = |order: usize| mesh.others.has_line_near(order as f64, near);
    let signals =
        GearSignals::split(&average, mesh.teeth, angle_record.highest_order, &is_foreign, transforms);
    transforms.recycle(average);
    signals.ok_or(NotComputed::AboveNyquist)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use jiff::Timestamp;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::super::{AnalysisSettings, AngleSource, OperatingPoint};
    use super::*;
    use crate::{Record, Tachometer};

    const RATE_HZ: f64 = 20_000.0;
    const SAMPLES: usize = 200_000;
    const SHAFT_HZ: f64 = 16.64;
    const TEETH: u32 = 24;

    const MESH: MeshContext = MeshContext::new([TEETH, 0], SHAFT_HZ, 0.05);

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

    fn source(angle: Option<AngleUsed>) -> Option<AngleSource> {
        angle.map(|angle| angle.source)
    }

    fn tracked(record: &Record) -> (Indicators, Option<AngleUsed>) {
        analyzer().gear_indicators(record, &MESH)
    }

    /// The amplitude put in is 1. Without order tracking the line of a speed that swings by 5 % is smeared to
    /// less than a fifth.
    #[test]
    fn a_swinging_speed_reads_as_a_constant_one() {
        let constant = tracked(&record(0.0, 0.3)).0.values["omx_tracked"];
        assert!((constant - 1.0).abs() < 0.005, "{constant}");
        for (swing, noise) in [(0.05, 0.0), (0.05, 0.3), (0.03, 1.0), (0.01, 0.3), (-0.05, 0.3)] {
            let swept = record(swing, noise);
            let (indicators, angle) = tracked(&swept);
            let omx = indicators.values["omx_tracked"];
            assert!((omx / constant - 1.0).abs() < 0.01, "{swing} {noise}: {omx} {angle:?}");
            assert!(matches!(source(angle), Some(AngleSource::MeshPhase { .. })));
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
        let count = pulses.len();
        let tachometer = Tachometer { pulse_times_s: pulses, pulses_per_revolution: 1 };
        let record = record(0.05, 0.3).with_tachometer(Some(tachometer));
        let (indicators, angle) = tracked(&record);
        assert!(matches!(source(angle), Some(AngleSource::Tachometer { pulses, .. }) if pulses == count));
        let omx = indicators.values["omx_tracked"];
        assert!((omx - 1.0).abs() < 0.01, "{omx}");
        // The modulation's phase is that of the pulses: cos at zero angle.
        let signals = analyzer().gear_signals(&record, &MESH).unwrap();
        let turn = signals.mesh_envelope.len() as f64;
        for (i, modulation) in signals.mesh_envelope.iter().enumerate() {
            let want = 0.2 * (TAU * i as f64 / turn).cos();
            assert!((modulation - want).abs() < 0.06, "{i}: {modulation} {want}");
        }
    }

    /// Amplitudes put in: mesh 1, sidebands 0.1 each; σ² of the average Σ (1 + 0.02)/2h².
    #[test]
    fn sidebands_and_ratios_match_the_generated_ones() {
        let got = tracked(&record(0.04, 0.1)).0.values;
        let deviation = ((1..=5).map(|h| 1.02 / f64::from(2 * h * h)).sum::<f64>()).sqrt();
        let level = got["sideband_level_factor"];
        assert!((level / (0.2 / deviation) - 1.0).abs() < 0.03, "{level}");
        let energy = got["sideband_energy_ratio"];
        assert!((0.19..0.28).contains(&energy), "{energy}");
    }

    /// The interpolation attenuates lines above 0.42 of the sampling rate.
    #[test]
    fn lines_above_the_passband_are_absent() {
        let indicators = |part: f64| {
            let shaft_hz = part * RATE_HZ / f64::from(TEETH);
            let lines = |i: usize| {
                let turn = TAU * shaft_hz * i as f64 / RATE_HZ;
                ((f64::from(TEETH) * turn).sin() + 0.5 * (f64::from(2 * TEETH) * turn).sin()) as f32
            };
            let point = OperatingPoint { shaft_speed_hz: Some(shaft_hz), ..OperatingPoint::default() };
            let record =
                Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "g", (0..40_000).map(lines).collect())
                    .unwrap()
                    .with_operating_point(point)
                    .unwrap();
            analyzer().gear_indicators(&record, &MESH).0
        };
        let read = indicators(0.4).values["omx_tracked"];
        assert!((read - 1.0).abs() < 1e-3, "{read}");
        for part in [0.41, 0.44, 0.46, 0.47] {
            assert_eq!(indicators(part).absent["omx_tracked"], NotComputed::AboveNyquist, "{part}");
        }
        // FM0 leaves out a second harmonic there.
        let [inside, beside] = [0.205, 0.225].map(|part| indicators(part).values["fm0"]);
        assert!((beside / inside - 1.5).abs() < 0.1, "{inside} {beside}");
    }

    #[test]
    fn untrackable_records_report_the_reason() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let noise: Vec<f32> = (0..SAMPLES).map(|_| StandardNormal.sample(&mut random)).collect();
        let with =
            |samples: Vec<f32>| Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "g", samples).unwrap();
        let reason = |record: &Record, mesh: &MeshContext| {
            let (indicators, angle) = analyzer().gear_indicators(record, mesh);
            assert!(indicators.values.is_empty() && angle.is_none());
            let reasons: std::collections::BTreeSet<String> =
                indicators.absent.values().map(|reason| format!("{reason:?}")).collect();
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
        let fast = OperatingPoint { shaft_speed_hz: Some(500.0), ..OperatingPoint::default() };
        assert_eq!(reason(&with(noise.clone()).with_operating_point(fast).unwrap(), &MESH), "AboveNyquist");
        // A given speed without a trackable line is taken as constant, and reported as such.
        let (_, angle) = analyzer().gear_indicators(&with(noise), &exact);
        assert_eq!(source(angle), Some(AngleSource::ConstantSpeed));
    }
}
