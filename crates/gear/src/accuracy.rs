//! How far a response's indicators and features are from those of a far shorter step of the integrator.

use flankwatch_signal::{
    Analysis, AnalysisSettings, Analyzer, MeshContext, OperatingPoint, Precision, Record,
};
use jiff::Timestamp;

use crate::response::{is_stiff, simulate_refined};
use crate::testing::shen2022_spec;
use crate::{ContactRule, FlankWear, MeshCycle, PairSpec, RunSettings, simulate_together};

/// Steps of the reference for one sample: eight times the usual.
const REFINED: usize = 64;

/// Every amplitude, moment and ratio, worn or not, teeth parting (half the torque, loaded) or not, within 0.1
/// %. The lines of the shaft's sidebands, a thousandth of the mesh lines, are the hardest.
#[test]
fn features_match_those_of_a_refined_step() {
    let mut analyzer = analyzer();
    for (contact, torque) in
        [(ContactRule::Threshold, 1.0), (ContactRule::Loaded, 1.0), (ContactRule::Loaded, 0.5)]
    {
        let mut spec = shen2022_spec();
        spec.dynamics.contact = contact;
        spec.operation.torque_nm *= torque;
        spec.operation.output_torque_nm = spec.operation.output_torque_nm.map(|output| output * torque);
        let pair = spec.resolve().unwrap();
        let worn = |depth_mm: f64| {
            MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth_mm).unwrap(), 1000).unwrap()
        };
        let cycles = [0.0, 0.05, 0.1, 0.245].map(worn);
        let cycles = cycles.each_ref();
        let run = RunSettings::nominal(&pair, 20_000.0, 1.0);
        let usual = simulate_together(&pair, &cycles, &run, None).unwrap();
        let refined = simulate_refined(&pair, &cycles, &run, REFINED);
        let mut worst = (0.0, String::new());
        for (state, (usual, refined)) in usual.iter().zip(&refined).enumerate() {
            let [usual, refined] =
                [usual, refined].map(|response| analyze(&mut analyzer, pair.gears[0].teeth, &run, response));
            assert_eq!(usual.features.values.len(), 26);
            for (name, value) in &usual.features.values {
                let error = (value - refined.features.values[name]).exp() - 1.0;
                worst = greater(worst, error, || format!("{name} of state {state}"));
            }
            for (name, value) in &usual.indicators.values {
                let error = value / refined.indicators.values[name] - 1.0;
                worst = greater(worst, error, || format!("{name} of state {state}"));
            }
        }
        println!("{contact}, {torque} of the torque: {:.4} % at {}", 100.0 * worst.0, worst.1);
        assert!(worst.0 < 1e-3, "{contact}, {torque} of the torque: {worst:?}");
    }
}

/// Single precision would move the weakest lines by more than the step does.
fn analyzer() -> Analyzer {
    Analyzer::new(AnalysisSettings { precision: Precision::Double, ..AnalysisSettings::default() })
}

fn greater(worst: (f64, String), error: f64, name: impl Fn() -> String) -> (f64, String) {
    // Not a number must not pass.
    if error.abs() <= worst.0 { worst } else { (error.abs(), name()) }
}

fn analyze(analyzer: &mut Analyzer, teeth: u32, run: &RunSettings, response: &[f64]) -> Analysis {
    let samples = response.iter().map(|&a| a as f32).collect();
    let point = OperatingPoint {
        shaft_speed_hz: Some(run.shaft_speed_hz),
        torque_nm: Some(run.torque_nm),
        ..OperatingPoint::default()
    };
    let record =
        Record::new("simulated", Timestamp::UNIX_EPOCH, run.sample_rate_hz, "m/s2", samples).unwrap();
    let record = record.with_operating_point(point).unwrap();
    let mesh = MeshContext::at_exact_speed([teeth, 0], run.shaft_speed_hz);
    analyzer.analyze(&record, &mesh)
}

/// A module 1 pair of steel: its teeth vibrate far above the record's band, which an explicit step has to
/// resolve and the implicit one has not.
fn module_1_spec() -> PairSpec {
    let mut spec = shen2022_spec();
    (spec.geometry.module_mm, spec.geometry.face_width_mm) = (1.0, 8.0);
    (spec.geometry.teeth, spec.geometry.bore_radius_mm) = ([20, 40], Some([3.0, 5.0]));
    spec.geometry.centre_distance_mm = None;
    (spec.operation.torque_nm, spec.operation.output_torque_nm) = (5.0, None);
    spec.operation.shaft_speed_hz = 24.37;
    (spec.supports, spec.errors) = Default::default();
    spec
}

/// The lines of the mesh and the moments of small pairs, by steps that do not resolve the teeth's own
/// vibration, within 0.3 % of those by explicit steps that do, supports as stiff as a gearbox's among them;
/// within 5 % by the threshold rule, whose jumps are sharper than the step and leave some lines weak.
#[test]
fn features_of_small_pairs_match_those_of_a_refined_step() {
    let mut analyzer = analyzer();
    let cases = [
        (ContactRule::Loaded, None, None, 0.05, 3e-3),
        (ContactRule::Loaded, Some(6.56e7), Some(2e4), 0.2, 3e-3),
        (ContactRule::Threshold, None, None, 0.1, 5e-2),
    ];
    for (contact, stiffness_n_per_m, damping_n_s_per_m, damping_ratio, limit) in cases {
        let mut spec = module_1_spec();
        (spec.supports.stiffness_n_per_m, spec.supports.damping_n_s_per_m) =
            (stiffness_n_per_m, damping_n_s_per_m);
        (spec.dynamics.contact, spec.dynamics.mesh_damping_ratio) = (contact, damping_ratio);
        let pair = spec.resolve().unwrap();
        let cycles = [0.0, 0.015, 0.04].map(|depth_mm| {
            MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth_mm).unwrap(), 1000).unwrap()
        });
        let cycles = cycles.each_ref();
        let run = RunSettings::nominal(&pair, 20_000.0, 0.5);
        assert!(is_stiff(&pair, &cycles, &run));
        let usual = simulate_together(&pair, &cycles, &run, None).unwrap();
        let refined = simulate_refined(&pair, &cycles, &run, 512);
        let mut worst = (0.0, String::new());
        for (state, (usual, refined)) in usual.iter().zip(&refined).enumerate() {
            let [usual, refined] = [usual, refined]
                .map(|response| analyze(&mut analyzer, pair.gears[0].teeth, &run, response).features.values);
            let lines = usual.iter().filter(|(name, _)| {
                name.starts_with("ln_mesh") || name.ends_with("rms") || name.ends_with("kurtosis")
            });
            for (name, value) in lines {
                worst = greater(worst, (value - refined[name]).exp() - 1.0, || {
                    format!("{name} of state {state}")
                });
            }
        }
        println!("{contact}, supports {stiffness_n_per_m:?}: {:.4} % at {}", 100.0 * worst.0, worst.1);
        assert!(worst.0 < limit, "{worst:?}");
    }
}
