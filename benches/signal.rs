//! What a record of 10 s at 20 kHz costs, against one real Fourier transform of the same length: `cargo bench --bench signal`.

use std::hint::black_box;
use std::time::{Duration, Instant};

use flankwatch::signal::{AnalysisSettings, Analyzer, MeshContext, Record};
use jiff::Timestamp;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use realfft::RealFftPlanner;

const SAMPLES: usize = 200_000;
const RATE_HZ: f64 = 20_000.0;
const SHAFT_HZ: f64 = 16.64;
const ROUNDS: usize = 60;

/// What is timed, and its name.
type Task<'a> = (&'a str, Box<dyn FnMut() + 'a>);

fn record() -> Record {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let signal = (0..SAMPLES).map(|i| {
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
    let record = record();
    let mesh = MeshContext {
        teeth: 24,
        nominal_shaft_speed_hz: SHAFT_HZ,
        tolerance: 0.05,
        nominal_is_exact: false,
    };
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let mut tracking = Analyzer::new(AnalysisSettings::default());
    let plan = RealFftPlanner::<f64>::new().plan_fft_forward(SAMPLES);
    let (mut input, mut output, mut scratch) = (plan.make_input_vec(), plan.make_output_vec(), plan.make_scratch_vec());
    let samples: Vec<f64> = record.samples().iter().map(|&x| f64::from(x)).collect();

    let mut tasks: Vec<Task> = Vec::new();
    tasks.push((
        "one real transform",
        Box::new(|| {
            input.copy_from_slice(&samples);
            plan.process_with_scratch(&mut input, &mut output, &mut scratch)
                .expect("lengths of the plan");
            black_box(&output);
        }),
    ));
    tasks.push((
        "analyze: RMS, Kur, lines, amplitude and envelope spectra",
        Box::new(|| {
            black_box(analyzer.analyze(&record, &mesh));
        }),
    ));
    tasks.push((
        "gear_indicators: order tracking, average, FM4 …",
        Box::new(|| {
            black_box(tracking.gear_indicators(&record, &mesh, None));
        }),
    ));
    // The least of many rounds, taken in turn, so that other work on the machine touches all alike.
    let mut least = vec![Duration::MAX; tasks.len()];
    for _ in 0..ROUNDS {
        for ((_, task), least) in tasks.iter_mut().zip(&mut least) {
            let start = Instant::now();
            task();
            *least = (*least).min(start.elapsed());
        }
    }
    for ((name, _), time) in tasks.iter().zip(&least) {
        let ratio = time.as_secs_f64() / least[0].as_secs_f64();
        println!("{name}: {:.3} ms, {ratio:.2} × one real transform", 1e3 * time.as_secs_f64());
    }
}
