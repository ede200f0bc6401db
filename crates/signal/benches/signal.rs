//! Cost of analysing a record of 10 s at 20 kHz, and of its parts, relative to one real Fourier transform of
//! the same length: `cargo bench --bench signal`. Also counts memory allocations. `-- condition` times only
//! benchmarks with that word in their name.
//!
//! `scipy_signal.py` in this folder does a part of `condition` in SciPy.

use std::hint::black_box;
use std::sync::{Barrier, OnceLock};
use std::time::{Duration, Instant};

use flankwatch_fourier::Planned;
use flankwatch_signal::{
    AnalysisSettings, Analyzer, BearingSettings, ConditionSettings, MeshContext, Record, Tachometer,
};
use jiff::Timestamp;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

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

/// What this thread has had of the processor; wall time where the system does not say.
fn processor_seconds() -> f64 {
    // The system counts when a thread gives way.
    std::thread::yield_now();
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let counted = text.split(' ').next().and_then(|field| field.parse::<f64>().ok());
    counted.map_or_else(|| started().elapsed().as_secs_f64(), |nanoseconds| 1e-9 * nanoseconds)
}

/// A moment before all that is measured.
fn started() -> Instant {
    static STARTED: OnceLock<Instant> = OnceLock::new();
    *STARTED.get_or_init(Instant::now)
}

fn main() {
    let record = record(SAMPLES);
    let prime = crate::record(SAMPLES - 1);
    let mesh = MeshContext::new([24, 0], SHAFT_HZ, 0.05);
    let analyzer = || Analyzer::new(AnalysisSettings::default());
    let (mut analyzing, mut tracking, mut of_prime, mut impulsive) =
        (analyzer(), analyzer(), analyzer(), analyzer());
    let (mut transforming, mut following, mut turning) = (analyzer(), analyzer(), analyzer());
    let tachometer = Tachometer {
        pulse_times_s: (0..=167).map(|turn| f64::from(turn) / SHAFT_HZ).collect(),
        pulses_per_revolution: 1,
    };
    let with_pulses = record.clone().with_tachometer(Some(tachometer));
    let plan = f64::forward_plan(SAMPLES);
    let samples: Vec<f64> = record.samples().iter().map(|&x| f64::from(x)).collect();
    let transform = || {
        let (mut input, mut output, mut scratch) =
            (plan.make_input_vec(), plan.make_output_vec(), plan.make_scratch_vec());
        let (plan, samples) = (&plan, &samples);
        move || {
            input.copy_from_slice(samples);
            plan.process_with_scratch(&mut input, &mut output, &mut scratch).expect("lengths of the plan");
            black_box(&output);
        }
    };

    let settings =
        ConditionSettings { mesh, bands: &[], gear_indicators: true, bearings: BearingSettings::default() };
    let mut tasks: Vec<Task> = Vec::new();
    tasks.push((TRANSFORM, Box::new(transform())));
    tasks.push((
        "part: moments, that transform and the Hann amplitudes",
        Box::new(|| {
            black_box(transforming.amplitude_spectrum(&record));
        }),
    ));
    tasks.push((
        "part: those, the mesh that is found and the shaft's angle by its phase",
        Box::new(|| {
            black_box(following.shaft_angle(&record, &mesh).is_ok());
        }),
    ));
    tasks.push((
        "part: resampling over the shaft's angle alone",
        Box::new(|| {
            black_box(turning.angle_record(&with_pulses, &mesh).is_ok());
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
    let condition = analyzer().condition(&record, &settings);
    let own = allocation_counter::measure(|| {
        black_box(condition.clone());
    });
    let asked: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let is_wanted = |name: &str| asked.is_empty() || asked.iter().any(|word| name.contains(word.as_str()));
    tasks.retain(|(name, _)| *name == TRANSFORM || is_wanted(name));
    // The least of many rounds, taken in turn, so that other work on the machine touches all alike.
    // And the mean of the processor's time, in which work that interrupts a task does not count.
    let mut least = vec![Duration::MAX; tasks.len()];
    let mut processor_s = vec![0.0; tasks.len()];
    for _ in 0..ROUNDS {
        for (index, (_, task)) in tasks.iter_mut().enumerate() {
            let before_s = processor_seconds();
            let start = Instant::now();
            task();
            least[index] = least[index].min(start.elapsed());
            processor_s[index] += (processor_seconds() - before_s) / ROUNDS as f64;
        }
    }
    for (index, (name, task)) in tasks.iter_mut().enumerate() {
        let time = least[index];
        let ratio = time.as_secs_f64() / least[0].as_secs_f64();
        let (processor_ms, processor_ratio) = (1e3 * processor_s[index], processor_s[index] / processor_s[0]);
        let allocations = allocation_counter::measure(task).count_total;
        println!(
            "{:.3} ms, {ratio:.2} × one real transform; on the processor {processor_ms:.3} ms, {processor_ratio:.2} ×; \
             {allocations} allocations: {name}",
            1e3 * time.as_secs_f64()
        );
    }
    println!("a copy of the answer of `condition` takes {} allocations", own.count_total);
    let transform_ms = on_all_cores_ms(transform);
    let condition_ms = on_all_cores_ms(|| {
        let (mut analyzer, record, settings) = (analyzer(), &record, &settings);
        move || {
            black_box(analyzer.condition(record, settings));
        }
    });
    println!("on all cores at once: {transform_ms:.3} ms one real transform, {condition_ms:.3} ms condition");
}

/// Milliseconds that each core takes for a task while all others have the same one, in the best of some
/// rounds.
fn on_all_cores_ms<T: FnMut()>(task: impl Fn() -> T + Sync) -> f64 {
    const REPEATS: u32 = 40;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let round = |_| {
        let start = Barrier::new(cores);
        std::thread::scope(|scope| {
            let timed = || {
                let mut task = task();
                task();
                start.wait();
                let began = Instant::now();
                (0..REPEATS).for_each(|_| task());
                1e3 * began.elapsed().as_secs_f64() / f64::from(REPEATS)
            };
            let threads: Vec<_> = (0..cores).map(|_| scope.spawn(timed)).collect();
            threads.into_iter().map(|thread| thread.join().expect("a task ends")).fold(0.0, f64::max)
        })
    };
    (0..5).map(round).fold(f64::INFINITY, f64::min)
}
