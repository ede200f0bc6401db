//! What a record of 10 s at 20 kHz costs, against one real Fourier transform of the same length:
//! `cargo bench --bench signal`. And how often memory is taken for it. `-- condition` times only what has
//! that word in its name.
//!
//! `scipy_signal.py` beside it does in SciPy a part of what `condition` does.

use std::hint::black_box;
use std::time::{Duration, Instant};

use flankwatch_signal::{
    AnalysisSettings, Analyzer, BearingSettings, ConditionSettings, MeshContext, OtherMeshes, Record,
};
use jiff::Timestamp;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use realfft::RealFftPlanner;

const SAMPLES: usize = 200_000;
const RATE_HZ: f64 = 20_000.0;
const SHAFT_HZ: f64 = 16.64;
const ROUNDS: usize = 60;

/// What the others are compared with.
const TRANSFORM: &str = "one real transform";

/// What is timed, and its name.
type Task<'a> = (&'a str, Box<dyn FnMut() + 'a>);

fn record(samples: usize) -> Record {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let signal = (0..samples).map(|i| {
        let turn = std::f64::consts::TAU * SHAFT_HZ * i as f64 / RATE_HZ;
        let lines: f64 = (1..=10)
            .map(|h| (1.0 + 0.2 * turn.cos()) / f64::from(h) * (24.0 * f64::from(h) * turn).sin())
            .sum();
        let noise: f64 = StandardNormal.sample(&mut random);
        (lines + 0.1 * noise) as f32
    });
    Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "m/s2", signal.collect()).expect("finite samples")
}

fn main() {
    let record = record(SAMPLES);
    let prime = crate::record(SAMPLES - 1);
    let mesh = MeshContext {
        teeth: 24,
        mate_teeth: 0,
        nominal_shaft_speed_hz: SHAFT_HZ,
        tolerance: 0.05,
        nominal_is_exact: false,
        others: OtherMeshes::NONE,
    };
    let analyzer = || Analyzer::new(AnalysisSettings::default());
    let (mut analyzing, mut tracking, mut of_prime, mut impulsive) =
        (analyzer(), analyzer(), analyzer(), analyzer());
    let plan = RealFftPlanner::<f64>::new().plan_fft_forward(SAMPLES);
    let (mut input, mut output, mut scratch) =
        (plan.make_input_vec(), plan.make_output_vec(), plan.make_scratch_vec());
    let samples: Vec<f64> = record.samples().iter().map(|&x| f64::from(x)).collect();

    let settings =
        ConditionSettings { mesh, bands: &[], gear_indicators: true, bearings: BearingSettings::default() };
    let mut tasks: Vec<Task> = Vec::new();
    tasks.push((
        TRANSFORM,
        Box::new(|| {
            input.copy_from_slice(&samples);
            plan.process_with_scratch(&mut input, &mut output, &mut scratch).expect("lengths of the plan");
            black_box(&output);
        }),
    ));
    tasks.push((
        "analyze: indicators of the record's spectrum and features, four narrow envelopes among them",
        Box::new(|| {
            black_box(analyzing.analyze(&record, &mesh));
        }),
    ));
    tasks.push((
        "condition: those and the indicators over the shaft's angle, as the service keeps them",
        Box::new(|| {
            black_box(tracking.condition(&record, &settings));
        }),
    ));
    tasks.push((
        "condition: the same of 199 999 samples, a prime",
        Box::new(|| {
            black_box(of_prime.condition(&prime, &settings));
        }),
    ));
    tasks.push((
        "kurtogram of 15 divisions",
        Box::new(|| {
            black_box(impulsive.kurtogram(&record).is_ok());
        }),
    ));
    let asked: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let is_wanted = |name: &str| asked.is_empty() || asked.iter().any(|word| name.contains(word.as_str()));
    tasks.retain(|(name, _)| *name == TRANSFORM || is_wanted(name));
    // The least of many rounds, taken in turn, so that other work on the machine touches all alike.
    let mut least = vec![Duration::MAX; tasks.len()];
    for _ in 0..ROUNDS {
        for ((_, task), least) in tasks.iter_mut().zip(&mut least) {
            let start = Instant::now();
            task();
            *least = (*least).min(start.elapsed());
        }
    }
    for ((name, task), time) in tasks.iter_mut().zip(&least) {
        let ratio = time.as_secs_f64() / least[0].as_secs_f64();
        let allocations = allocation_counter::measure(task).count_total;
        println!(
            "{:.3} ms, {ratio:.2} × one real transform, {allocations} allocations: {name}",
            1e3 * time.as_secs_f64()
        );
    }
}
