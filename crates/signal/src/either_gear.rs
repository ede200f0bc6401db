//! The synchronous average of either gear of a mesh.

use super::analyzer::Analyzer;
use super::angle_record::AngleRecord;
use super::gear_analysis::split;
use super::gear_signals::GearSignals;
use super::mesh_context::MeshContext;
use super::not_computed::NotComputed;
use super::record::RecordOf;
use super::shaft_angle::{AngleSource, ShaftAngle};

/// One of the two gears of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Gear {
    /// The gear on the reference shaft: the pinion.
    #[default]
    Driving,
    /// Its mate.
    Driven,
}

/// The synchronous average over one turn of a gear.
#[derive(Debug, Clone, PartialEq)]
pub struct TurnAverage {
    /// Number of whole turns of the gear averaged.
    pub turns: usize,
    /// Source and accuracy of the gear's angle.
    pub angle: AngleSource,
    /// The average and its components.
    pub signals: GearSignals,
}

impl MeshContext {
    /// Refers the mesh to the driven gear's teeth, speed and orders; `None` if its number of teeth is
    /// unknown.
    fn referred_to_driven_gear(&self) -> Option<Self> {
        if self.teeth == 0 || self.mate_teeth == 0 {
            return None;
        }
        Some(Self {
            teeth: self.mate_teeth,
            mate_teeth: self.teeth,
            nominal_shaft_speed_hz: self.nominal_shaft_speed_hz * self.gear_ratio(),
            others: self.others.referred_to_shaft(self.gear_ratio()),
            ..*self
        })
    }

    /// Returns the turns of the driven gear per turn of the driving one.
    fn gear_ratio(&self) -> f64 {
        f64::from(self.teeth) / f64::from(self.mate_teeth)
    }
}

impl Analyzer {
    /// Computes the synchronous average of a gear and its components. The angle of the driving shaft is that
    /// of [`angle_record`](Self::angle_record). The driven gear's angle is this angle times the tooth ratio,
    /// so it has the same zero: a tachometer's first pulse, or the start of the record.
    ///
    /// # Errors
    /// As for [`angle_record`](Self::angle_record), with the turns of this gear; [`NotComputed::NoSpeed`] for
    /// a driven gear with an unknown number of teeth.
    pub fn turn_average(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        gear: Gear,
    ) -> Result<TurnAverage, NotComputed> {
        let (angle_record, gear_mesh) = match gear {
            Gear::Driving => (self.angle_record(record, mesh)?, *mesh),
            Gear::Driven => {
                let gear_mesh = mesh.referred_to_driven_gear().ok_or(NotComputed::NoSpeed)?;
                (self.driven_record(record, mesh, &gear_mesh)?, gear_mesh)
            }
        };
        let angle_record = angle_record.without_other_meshes(&gear_mesh);
        let signals = split(&angle_record, &gear_mesh, &mut self.work.transforms)?;
        Ok(TurnAverage { turns: angle_record.turns, angle: angle_record.angle, signals })
    }

    /// Resamples a record over the angle of the driven gear; `gear_mesh` is `mesh` referred to that gear.
    fn driven_record(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        gear_mesh: &MeshContext,
    ) -> Result<AngleRecord, NotComputed> {
        let ratio = mesh.gear_ratio();
        let geared = |angle: &ShaftAngle| angle.geared(ratio).ok_or(NotComputed::NoSpeed);
        if let Some(Ok(angle)) = record.tachometer_angle()
            && let Ok(angle_record) = self.resampled(record, gear_mesh, &geared(&angle)?)
        {
            return Ok(angle_record);
        }
        let angle = self.shaft_angle(record, mesh)?;
        self.resampled(record, gear_mesh, &geared(&angle)?)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use jiff::Timestamp;
    use serde::Deserialize;

    use super::super::{AnalysisSettings, OtherMesh, OtherMeshes, Tachometer};
    use super::*;
    use crate::Record;

    #[derive(Deserialize)]
    struct Vectors {
        cases: Vec<Case>,
    }

    #[derive(Deserialize)]
    struct Case {
        name: String,
        sample_rate_hz: f64,
        teeth: [u32; 2],
        samples: Vec<f32>,
        pulse_times_s: Vec<f64>,
        samples_per_turn: usize,
        turns: usize,
        average: Vec<f64>,
        residual: Vec<f64>,
        mesh_envelope: Vec<f64>,
    }

    fn mesh([teeth, mate_teeth]: [u32; 2], shaft_speed_hz: f64) -> MeshContext {
        MeshContext::new([teeth, mate_teeth], shaft_speed_hz, 0.05)
    }

    fn analyzer() -> Analyzer {
        Analyzer::new(AnalysisSettings::default())
    }

    /// NumPy's and SciPy's averages over the turns of a driven gear, by `make_driven_reference.py`.
    #[test]
    fn the_driven_gears_average_equals_scipys() {
        let vectors = include_str!("../../../fixtures/reference/signal/driven_vectors.json");
        let Vectors { cases } = serde_json::from_str(vectors).unwrap();
        for case in cases {
            let record = Record::new("1", Timestamp::UNIX_EPOCH, case.sample_rate_hz, "g", case.samples);
            let tachometer = Tachometer { pulse_times_s: case.pulse_times_s, pulses_per_revolution: 1 };
            let record = record.unwrap().with_tachometer(Some(tachometer));
            let mesh = mesh(case.teeth, 10.0);
            let got = analyzer().turn_average(&record, &mesh, Gear::Driven).unwrap();
            assert_eq!(
                (got.signals.average.len(), got.turns),
                (case.samples_per_turn, case.turns),
                "{}",
                case.name
            );
            for (part, got, want) in [
                ("average", &got.signals.average, &case.average),
                ("residual", &got.signals.residual, &case.residual),
                ("mesh_envelope", &got.signals.mesh_envelope, &case.mesh_envelope),
            ] {
                let largest = want.iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
                assert!(largest > 0.01, "{part} says nothing");
                for (k, (got, want)) in got.iter().zip(want).enumerate() {
                    let apart = (got - want).abs() / largest;
                    // The record is resampled in single precision.
                    assert!(apart <= 5e-7, "{}, {part}, {k}: {got}, SciPy has {want}", case.name);
                }
            }
        }
    }

    const RATE_HZ: f64 = 10_000.0;
    const TEETH: [u32; 2] = [19, 31];

    /// Twenty seconds of a mesh whose pinion turns at 25 Hz and swings by 1 %. Line by line `(order,
    /// amplitude)` of the driving and of the driven shaft.
    fn record(driving: &[(f64, f64)], driven: &[(f64, f64)]) -> Record {
        let samples = (0..200_000).map(|k| {
            let t = f64::from(k) / RATE_HZ;
            let turns = 25.0 * (t + 0.01 * (1.0 - (0.7 * t).cos()) / 0.7);
            let mate_turns = turns * f64::from(TEETH[0]) / f64::from(TEETH[1]);
            let lines = |all: &[(f64, f64)], turns: f64| -> f64 {
                all.iter().map(|(order, amplitude)| amplitude * (TAU * order * turns).cos()).sum()
            };
            let mesh = lines(&[(19.0, 1.0), (38.0, 0.5)], turns);
            (mesh + lines(driving, turns) + lines(driven, mate_turns)) as f32
        });
        Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "g", samples.collect()).unwrap()
    }

    fn residual(record: &Record, mesh: &MeshContext, gear: Gear) -> (Vec<f64>, AngleSource) {
        let got = analyzer().turn_average(record, mesh, gear).unwrap();
        (got.signals.residual, got.angle)
    }

    /// Root mean square.
    fn strength(signal: &[f64]) -> f64 {
        (signal.iter().map(|x| x * x).sum::<f64>() / signal.len() as f64).sqrt()
    }

    /// A line at order 7 of one shaft is in the residual of that shaft's gear with its amplitude, and next to
    /// nothing of it in the other's.
    #[test]
    fn each_gears_lines_are_in_its_own_average() {
        let line = [(7.0, 0.3)];
        for (record, own, other) in [
            (record(&[], &line), Gear::Driven, Gear::Driving),
            (record(&line, &[]), Gear::Driving, Gear::Driven),
        ] {
            let (of_own, angle) = residual(&record, &mesh(TEETH, 25.0), own);
            assert!(matches!(angle, AngleSource::MeshPhase { .. }), "{angle:?}");
            assert!((strength(&of_own) / (0.3 / f64::sqrt(2.0)) - 1.0).abs() < 0.02, "{own:?}");
            let (of_other, _) = residual(&record, &mesh(TEETH, 25.0), other);
            assert!(strength(&of_other) < 0.02, "{other:?}: {}", strength(&of_other));
        }
    }

    /// The same error of the pinion's angle is less of a turn of the slower gear.
    #[test]
    fn the_driven_angle_has_the_scaled_error() {
        let record = record(&[], &[]);
        let error = |gear| match residual(&record, &mesh(TEETH, 25.0), gear).1 {
            AngleSource::MeshPhase { angle_error_deg, .. } => angle_error_deg,
            other => panic!("{other:?}"),
        };
        let ratio = error(Gear::Driven) / error(Gear::Driving);
        assert!((ratio - 19.0 / 31.0).abs() < 1e-12, "{ratio}");
    }

    /// A line of another mesh has another order of the driven shaft, and is removed there too.
    #[test]
    fn lines_of_other_meshes_are_removed_from_the_driven_average() {
        // 14 teeth on the driving shaft with 50 on another, and a sideband of theirs.
        let beside = 14.0 + 14.0 / 50.0;
        let record = record(&[(14.0, 0.8), (beside, 0.4)], &[(7.0, 0.3)]);
        let other = OtherMesh { mesh_orders: 14.0, shaft_orders: [1.0, 14.0 / 50.0] };
        let known = MeshContext { others: OtherMeshes::of([other]), ..mesh(TEETH, 25.0) };
        let (clean, _) = residual(&record, &known, Gear::Driven);
        assert!((strength(&clean) / (0.3 / f64::sqrt(2.0)) - 1.0).abs() < 0.02, "{}", strength(&clean));
    }

    #[test]
    fn a_driven_gear_of_unknown_teeth_has_no_average() {
        let record = record(&[], &[]);
        let alone = MeshContext { mate_teeth: 0, ..mesh(TEETH, 25.0) };
        let got = analyzer().turn_average(&record, &alone, Gear::Driven);
        assert_eq!(got, Err(NotComputed::NoSpeed));
        assert!(analyzer().turn_average(&record, &alone, Gear::Driving).is_ok());
    }
}
