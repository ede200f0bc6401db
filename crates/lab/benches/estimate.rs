//! Benchmark of updating one asset's estimate with one record, comparing all members of the ensemble.
//!
//! `cargo bench -p flankwatch-lab --bench estimate`. Prints the time itself and in relation to computing the
//! record's features in the same process, and the largest size of the channel's state as JSON.

use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

use flankwatch_gear::PairSpec;
use flankwatch_lab::evaluation::{Bank, BankPlan, Observation, RunShape, observe};
use flankwatch_signal::{AnalysisSettings, Analyzer, MeshContext, Record};
use flankwatch_wear::estimate::{EstimatorSettings, Tracker};
use flankwatch_wear::library::{BuildControl, Ensemble, EnsembleSettings, GridSettings, build};
use jiff::{SignedDuration, Timestamp};

const RECORDS: usize = 120;
const BASELINE: usize = 20;
const REPEATS: usize = 7;

fn main() {
    let pair = PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml"))
        .expect("the pair file is valid");
    let library =
        build(&pair, &GridSettings::default(), &BuildControl::silent()).expect("the pair can be simulated");
    let ensemble = Ensemble::build(Arc::new(library), &EnsembleSettings::default(), &BuildControl::silent())
        .expect("the pair can be simulated");
    let bank = Bank::build(BankPlan {
        pair,
        worn: 60,
        healthy: 20,
        seconds: 1.4,
        sample_rate_hz: 20_000.0,
        max_wear_um: 245.0,
        speed_variation: 0.03,
        torque_variation: 0.1,
        weak_tooth: None,
        seed: 1,
    })
    .expect("the pair can be simulated");
    let shape = RunShape {
        records: RECORDS,
        drawn: RECORDS,
        seconds: 1.0,
        snr_db: 10.0,
        wander: 0.005,
        last_wear_um: 245.0,
        fault: None,
    };
    let mut run = observe(&bank, None, &shape, 1);
    let settings = EstimatorSettings { baseline_records: BASELINE as u32, limit_um: Some(200.0) };
    let tracker = Tracker::new(settings, Some(Arc::new(ensemble)));
    let given = update(&tracker, &run);
    run.iter_mut().for_each(|observation| observation.features.operating_point.torque_nm = None);
    let not_given = update(&tracker, &run);
    let reading = reading();
    println!(
        "update of one asset: {:.0} µs a record with its torque, {:.0} µs without; features of a record of 10 s: {:.0} µs; ratios {:.2} and {:.2}",
        given.as_secs_f64() * 1e6,
        not_given.as_secs_f64() * 1e6,
        reading.as_secs_f64() * 1e6,
        given.as_secs_f64() / reading.as_secs_f64(),
        not_given.as_secs_f64() / reading.as_secs_f64()
    );
    println!("state of a channel: {} kB at most", largest_state(&tracker, &run).div_ceil(1000));
}

/// Largest size of the state as JSON, in bytes.
fn largest_state(tracker: &Tracker, run: &[Observation]) -> usize {
    let mut state = tracker.start();
    let size = |(index, observation): (usize, &Observation)| {
        tracker.update(&mut state, at(index), &observation.features);
        serde_json::to_string(&state).expect("a state is valid JSON").len()
    };
    run.iter().enumerate().map(size).max().unwrap_or_default()
}

fn at(index: usize) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_hours(index as i64)
}

/// Mean time of an update, the best of some runs.
fn update(tracker: &Tracker, run: &[Observation]) -> Duration {
    let once = |_| {
        let mut state = tracker.start();
        let mut took = Duration::ZERO;
        for (index, observation) in run.iter().enumerate() {
            let began = Instant::now();
            black_box(tracker.update(&mut state, at(index), &observation.features));
            // The first record after the baseline also fits the healthy model.
            if index > BASELINE {
                took += began.elapsed();
            }
        }
        took / (RECORDS - BASELINE - 1) as u32
    };
    (0..REPEATS).map(once).min().unwrap_or_default()
}

/// Indicators and features of one record of 10 s at 20 kHz.
fn reading() -> Duration {
    let samples = (0..200_000).map(|i| {
        let t = f64::from(i) / 20_000.0;
        (399.4 * std::f64::consts::TAU * t).sin() as f32 + 0.1 * f64::from(i * i % 977) as f32 / 977.0
    });
    let record = Record::new("1", Timestamp::UNIX_EPOCH, 20_000.0, "m/s2", samples.collect())
        .expect("the samples are finite");
    let mesh = MeshContext::new([24, 0], 16.64, 0.05);
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let once = |analyzer: &mut Analyzer| {
        let began = Instant::now();
        black_box(analyzer.analyze(&record, &mesh));
        began.elapsed()
    };
    (0..REPEATS).map(|_| once(&mut analyzer)).min().unwrap_or_default()
}
