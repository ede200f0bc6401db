//! Estimates wear over a simulated run to failure and prints it beside the true wear.
//!
//! `cargo run -p flankwatch-wear --example wear_of_a_run`

use std::error::Error;
use std::sync::Arc;

use flankwatch_gear::PairSpec;
use flankwatch_signal::{AnalysisSettings, Analyzer, MeshContext};
use flankwatch_wear::estimate::{EstimatorSettings, Tracker};
use flankwatch_wear::library::{BuildControl, Ensemble, GridSettings, build};
use flankwatch_wear::simulation::{Run, RunPlan};
use jiff::Timestamp;

const PAIR: &str = r#"
    [geometry]
    teeth = [24, 26]
    module_mm = 6.0
    face_width_mm = 50.0
    bore_radius_mm = [20.0, 20.0]
    centre_distance_mm = 150.0

    [operation]
    torque_nm = 1300.0
    shaft_speed_hz = 16.64
"#;

fn main() -> Result<(), Box<dyn Error>> {
    let pair = PairSpec::from_toml(PAIR)?;

    // The effect of wear on this pair's vibration, simulated once.
    let grid = GridSettings { states: 25, max_wear_um: 240.0, seconds: 1.0, ..GridSettings::default() };
    let library = Arc::new(build(&pair, &grid, &BuildControl::silent())?);

    // A machine: the same pair with noise, behind a transmission path that the estimator does not know.
    let run = Run::new(RunPlan {
        pair: pair.clone(),
        records: 40,
        seconds: 1.0,
        sample_rate_hz: 20_000.0,
        max_wear_um: 200.0,
        wear_exponent: 2.0,
        start_time: Timestamp::UNIX_EPOCH,
        interval_s: 86_400.0,
        snr_db: 20.0,
        speed_variation: 0.01,
        torque_variation: 0.02,
        seed: 1,
        channel: "1".to_owned(),
    })?;

    let settings = EstimatorSettings { baseline_records: 10, limit_um: Some(200.0) };
    let tracker = Tracker::new(settings, Some(Arc::new(Ensemble::of(library))));
    let mesh = MeshContext::new([pair.geometry.teeth[0], 0], pair.operation.shaft_speed_hz, 0.05);
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let mut state = tracker.start();
    println!("record  true µm  estimate µm  (90 % interval)");
    for index in 0..run.plan().records {
        let simulated = run.record(index)?;
        let analysis = analyzer.analyze(&simulated.record, &mesh);
        let estimate = tracker.update(&mut state, simulated.record.start_time(), &analysis.features);
        match (estimate.median_um, estimate.low_um, estimate.high_um) {
            (Some(median), Some(low), Some(high)) => {
                println!("{index:6} {:8.1} {median:12.1}  ({low:.1} to {high:.1})", simulated.wear_um);
            }
            _ => println!("{index:6} {:8.1}  {}", simulated.wear_um, estimate.reason),
        }
    }
    Ok(())
}
