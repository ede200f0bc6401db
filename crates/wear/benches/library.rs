//! Benchmark of a library of 50 wear states, from the pair file to features, against a scalar Runge–Kutta
//! baseline in the same process, at 1 and at 25 operating points.
//!
//! `cargo bench --bench library`. Prints wall and processor time (the least of some runs, since other work on
//! the machine only adds to it), peak memory and the ratio to the baseline. The baseline integrates Eqs. (23)
//! and (24) directly with the classical method at the library's step, and interpolates k and e in a table at
//! every stage; it excludes geometry, filter and features.

use std::f64::consts::TAU;
use std::fs;
use std::hint::black_box;
use std::time::Instant;

use flankwatch_gear::{ContactRule, FlankWear, GearPair, MeshCycle, PairSpec};
use flankwatch_wear::library::{self, BuildControl, GridSettings};

const PAIR: &str = include_str!("../../../fixtures/pairs/shen2022.toml");
const REPEATS: usize = 5;
/// Steps per second of the baseline: eight for each sample at 20 kHz.
const BASELINE_RATE_HZ: f64 = 160_000.0;
const BASELINE_SECONDS: f64 = 1.0;
/// Clock ticks per second in `/proc/self/stat`.
const TICKS_PER_SECOND: f64 = 100.0;

fn main() {
    let spec = PairSpec::from_toml(PAIR).expect("the fixture is a pair file");
    let nominal = GridSettings::default();
    let points = GridSettings {
        torque_factors: vec![0.5, 0.75, 1.0, 1.25, 1.5],
        speed_factors: vec![0.8, 0.9, 1.0, 1.1, 1.2],
        ..GridSettings::default()
    };
    for (grid, repeats) in [(&nominal, REPEATS), (&points, 1)] {
        println!(
            "{} states × {} operating points of {} s at {} Hz",
            grid.states,
            grid.operating_points(),
            grid.seconds,
            grid.sample_rate_hz
        );
        let mut threshold = None;
        for contact in [ContactRule::Threshold, ContactRule::Loaded] {
            let mut spec = spec.clone();
            spec.dynamics.contact = contact;
            let build = || {
                black_box(
                    library::build(&spec, grid, &BuildControl::silent())
                        .expect("the fixture can be simulated"),
                )
            };
            let runs: Vec<(f64, f64)> = (0..repeats).map(|_| timed(build)).collect();
            let (wall, processor) =
                (least(runs.iter().map(|run| run.0)), least(runs.iter().map(|run| run.1)));
            let baseline = baseline_seconds(&spec, grid);
            println!(
                "  {contact}: wall {wall:.3} s, processor {processor:.2} s (least of {repeats}); baseline {baseline:.2} s, ratio {:.2}",
                baseline / processor
            );
            match threshold {
                None => threshold = Some(processor),
                Some(threshold) => println!("  loaded over threshold: {:.2}", processor / threshold),
            }
        }
        if let Some(peak_mb) = peak_memory_mb() {
            println!("  peak memory so far {peak_mb:.0} MB");
        }
    }
}

/// Processor seconds of the baseline for the same records, extrapolated from a part of one.
fn baseline_seconds(spec: &PairSpec, grid: &GridSettings) -> f64 {
    let pair = spec.resolve().expect("the fixture is a valid pair");
    let wear = FlankWear::from_shape(&pair, 0.1).expect("the teeth are thicker");
    let cycle = MeshCycle::compute(&pair, &wear, 1000).expect("the flanks touch");
    let runs = (0..REPEATS).map(|_| timed(|| black_box(baseline(&pair, &cycle))).1);
    least(runs) * grid.seconds / BASELINE_SECONDS * grid.simulations() as f64
}

/// Wall and processor seconds.
fn timed<T>(work: impl FnOnce() -> T) -> (f64, f64) {
    let (clock, before) = (Instant::now(), processor_seconds());
    work();
    let wall = clock.elapsed().as_secs_f64();
    (wall, processor_seconds().zip(before).map_or(wall, |(after, before)| after - before))
}

fn processor_seconds() -> Option<f64> {
    let text = fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    Some((fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?) / TICKS_PER_SECOND)
}

fn peak_memory_mb() -> Option<f64> {
    let text = fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.split_whitespace().next()?.parse::<f64>().ok()? / 1024.0)
}

fn least(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(f64::INFINITY, f64::min)
}

/// Integrates x (of θ₁ and θ₂) and the supports, with ẋ_m and ė explicitly; returns the last ÿ₁.
fn baseline(pair: &GearPair, cycle: &MeshCycle) -> f64 {
    let [driving, driven] = &pair.gears;
    let spec = &pair.spec;
    let mesh_mass = pair.mesh_mass_kg();
    let damping =
        2.0 * spec.dynamics.mesh_damping_ratio * (cycle.mean_stiffness_n_per_m() * mesh_mass).sqrt();
    let force = spec.operation.torque_nm / (driving.base_radius_mm * 1e-3);
    let points = cycle.stiffness_n_per_m.len();
    let mesh_hz = spec.operation.shaft_speed_hz * f64::from(driving.teeth);
    let lag: Vec<f64> = cycle.uste_rad.iter().map(|lag| lag * driven.base_radius_mm * 1e-3).collect();
    let interpolate = |table: &[f64], seconds: f64| {
        let place = (seconds * mesh_hz).fract() * points as f64;
        let cell = (place as usize).min(points - 1);
        let (before, after) = (table[cell], table[(cell + 1) % points]);
        (before + (place - cell as f64) * (after - before), (after - before) * points as f64 * mesh_hz)
    };
    let derivative = |seconds: f64, s: &[f64; 6]| -> [f64; 6] {
        let (stiffness, _) = interpolate(&cycle.stiffness_n_per_m, seconds);
        let (lag, lag_rate) = interpolate(&lag, seconds);
        let long = TAU * spec.operation.shaft_speed_hz;
        let (sin, cos) = (long * seconds).sin_cos();
        let (short_sin, short_cos) = (TAU * mesh_hz * seconds).sin_cos();
        let error = lag + 1e-6 * (pair.errors.long_period_um * sin + pair.errors.short_period_um * short_sin);
        let error_rate = lag_rate
            + 1e-6
                * (pair.errors.long_period_um * long * cos
                    + pair.errors.short_period_um * TAU * mesh_hz * short_cos);
        let mesh = s[0] - s[1] + s[2] - error;
        let mesh_rate = s[3] - s[4] + s[5] - error_rate;
        let push = stiffness * mesh + damping * mesh_rate;
        let support =
            |i: usize| pair.supports.stiffness_n_per_m * s[i] + pair.supports.damping_n_s_per_m * s[3 + i];
        [
            s[3],
            s[4],
            s[5],
            (force - push) / mesh_mass,
            (push - support(1)) / driving.mass_kg,
            (-push - support(2)) / driven.mass_kg,
        ]
    };
    let step = 1.0 / BASELINE_RATE_HZ;
    let mut state = [0.0; 6];
    let mut last = 0.0;
    for n in 0..(BASELINE_SECONDS * BASELINE_RATE_HZ) as usize {
        let t = n as f64 * step;
        let ahead = |slope: &[f64; 6], length: f64| -> [f64; 6] {
            std::array::from_fn(|i| state[i] + length * slope[i])
        };
        let k1 = derivative(t, &state);
        let k2 = derivative(t + 0.5 * step, &ahead(&k1, 0.5 * step));
        let k3 = derivative(t + 0.5 * step, &ahead(&k2, 0.5 * step));
        let k4 = derivative(t + step, &ahead(&k3, step));
        state = std::array::from_fn(|i| state[i] + step / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]));
        last = k1[4];
    }
    last
}
