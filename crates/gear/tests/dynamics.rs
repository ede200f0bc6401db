//! The gear model's response against an independent integrator: Dormand and Prince's method of order 8 (crate
//! `ode_solvers`) at a tight tolerance on Eqs. (23) and (24) as they stand, with ė in the damper's force,
//! where the model integrates transformed velocities with fixed steps.
//!
//! Both are compared over one turn of the shaft after the start-up, which is a period of the response:
//! coefficients of the Fourier series up to 0.4 of the model's sampling rate, where its low-pass is flat.
#![cfg(test)]

use std::f64::consts::{PI, TAU};

use flankwatch_fourier::{Complex, Planned};
use flankwatch_gear::{ContactRule, FlankWear, GearPair, MeshCycle, PairSpec, RunSettings, simulate};
use ode_solvers::{Dop853, OutputType, System, Vector6};

/// Points of the mesh period from which the excitation is interpolated.
const POINTS: usize = 200_000;
/// Instants per turn at which the reference is kept.
const INSTANTS: usize = 96_000;
/// Places are integrated in tenths of a millimetre, so that one absolute tolerance serves places and
/// velocities.
const PLACE_M: f64 = 1e-4;
/// Relative tolerance, and absolute tolerance in units of the place and in m/s.
const TOLERANCE: f64 = 1e-9;
/// Turns before the compared one.
const SETTLING_TURNS: usize = 2;

/// k and e over the mesh period, cut where they jump.
struct Excitation {
    stiffness: Vec<f64>,
    /// R_b2 e_wear in m, and its derivative over the mesh period by central differences within the cuts.
    error: Vec<f64>,
    slope: Vec<f64>,
    /// Places in mesh periods, halfway between two points.
    cuts: Vec<f64>,
    long_m: f64,
    short_m: f64,
    shaft_hz: f64,
    mesh_hz: f64,
}

impl Excitation {
    fn new(pair: &GearPair, cycle: &MeshCycle) -> Self {
        let error: Vec<f64> =
            cycle.uste_rad.iter().map(|lag| lag * pair.gears[1].base_radius_mm * 1e-3).collect();
        let next = |i: usize| (i + 1) % POINTS;
        let mut steps: Vec<f64> = (0..POINTS).map(|i| (error[next(i)] - error[i]).abs()).collect();
        let jump: Vec<bool> = {
            let mut sorted = steps.clone();
            sorted.sort_by(f64::total_cmp);
            let usual = sorted[POINTS * 9 / 10];
            steps
                .drain(..)
                .enumerate()
                .map(|(i, step)| {
                    step > 50.0 * usual + 1e-13
                        || cycle.pairs_in_contact[i] != cycle.pairs_in_contact[next(i)]
                })
                .collect()
        };
        let slope = (0..POINTS)
            .map(|i| {
                let before = (i + POINTS - 1) % POINTS;
                let (from, to) = (if jump[before] { i } else { before }, if jump[i] { i } else { next(i) });
                let width = f64::from(u8::from(from != i) + u8::from(to != i)).max(1.0) / POINTS as f64;
                (error[to] - error[from]) / width
            })
            .collect();
        Self {
            stiffness: cycle.stiffness_n_per_m.clone(),
            error,
            slope,
            cuts: (0..POINTS).filter(|i| jump[*i]).map(|i| (i as f64 + 0.5) / POINTS as f64).collect(),
            long_m: pair.errors.long_period_um * 1e-6,
            short_m: pair.errors.short_period_um * 1e-6,
            shaft_hz: pair.spec.operation.shaft_speed_hz,
            mesh_hz: pair.spec.operation.shaft_speed_hz * f64::from(pair.gears[0].teeth),
        }
    }

    /// k, e and ė at a time, on the side of any cut on which `inside`, another time, lies.
    fn at(&self, seconds: f64, inside: f64) -> [f64; 3] {
        let periods = seconds * self.mesh_hz;
        let place = periods * POINTS as f64;
        let (mut i, mut part) = (place.floor(), place - place.floor());
        let cut_here = self
            .cuts
            .iter()
            .any(|cut| (cut * POINTS as f64 - 0.5 - i.rem_euclid(POINTS as f64)).abs() < 0.25);
        if cut_here {
            // Not across the cut: carried on with the slope from the side that is integrated.
            if inside * self.mesh_hz * POINTS as f64 > i + 0.5 {
                i += 1.0;
                part -= 1.0;
            }
        }
        let this = i.rem_euclid(POINTS as f64) as usize % POINTS;
        let next = (this + 1) % POINTS;
        let between =
            |values: &[f64]| values[this] + if cut_here { 0.0 } else { part * (values[next] - values[this]) };
        let carried = if cut_here { part * self.slope[this] / POINTS as f64 } else { 0.0 };
        let (shaft, mesh) = (TAU * self.shaft_hz, TAU * self.mesh_hz);
        [
            between(&self.stiffness),
            between(&self.error)
                + carried
                + self.long_m * (shaft * seconds).sin()
                + self.short_m * (mesh * seconds).sin(),
            between(&self.slope) * self.mesh_hz
                + self.long_m * shaft * (shaft * seconds).cos()
                + self.short_m * mesh * (mesh * seconds).cos(),
        ]
    }
}

/// Numbers of Eq. (23).
struct Masses {
    inverse: [f64; 3],
    drive: f64,
    damping: f64,
    support: [f64; 2],
    /// Way in m from the teeth's working flanks to their backs, where teeth can part.
    backlash_m: Option<f64>,
}

impl Masses {
    fn new(pair: &GearPair, cycle: &MeshCycle) -> Self {
        let spec = &pair.spec;
        let radius = pair.gears.each_ref().map(|gear| gear.base_radius_mm * 1e-3);
        let inertia = pair.gears.each_ref().map(|gear| gear.inertia_kg_m2);
        let output = spec.operation.output_torque_nm.expect("the pair file gives it");
        let inverse_mesh = radius[0].powi(2) / inertia[0] + radius[1].powi(2) / inertia[1];
        let mean = cycle.stiffness_n_per_m.iter().sum::<f64>() / POINTS as f64;
        Self {
            inverse: [inverse_mesh, 1.0 / pair.gears[0].mass_kg, 1.0 / pair.gears[1].mass_kg],
            drive: spec.operation.torque_nm * radius[0] / inertia[0] + output * radius[1] / inertia[1],
            damping: 2.0 * spec.dynamics.mesh_damping_ratio * (mean / inverse_mesh).sqrt(),
            support: [pair.supports.stiffness_n_per_m, pair.supports.damping_n_s_per_m],
            // Table 1's pair has none but what wear makes.
            backlash_m: (spec.dynamics.contact == ContactRule::Loaded)
                .then(|| cycle.uste_rad.iter().sum::<f64>() / POINTS as f64 * radius[1]),
        }
    }
}

/// Eqs. (23) and (24) for R_b1 θ₁ − R_b2 θ₂, y₁, y₂ and their velocities, within one interval without a cut.
struct Interval<'a> {
    excitation: &'a Excitation,
    masses: &'a Masses,
    inside: f64,
}

impl System<f64, Vector6<f64>> for Interval<'_> {
    fn system(&self, seconds: f64, state: &Vector6<f64>, slope: &mut Vector6<f64>) {
        let [stiffness, error, error_rate] = self.excitation.at(seconds, self.inside);
        let masses = self.masses;
        let mesh = PLACE_M * (state[0] - state[1] + state[2]) - error;
        let mesh_rate = state[3] - state[4] + state[5] - error_rate;
        let force = match masses.backlash_m {
            Some(backlash) if mesh < -backlash => stiffness * (mesh + backlash) + masses.damping * mesh_rate,
            Some(_) if mesh < 0.0 => 0.0,
            _ => stiffness * mesh + masses.damping * mesh_rate,
        };
        let support = |i: usize| masses.support[0] * PLACE_M * state[i] + masses.support[1] * state[i + 3];
        *slope = Vector6::new(
            state[3] / PLACE_M,
            state[4] / PLACE_M,
            state[5] / PLACE_M,
            masses.drive - force * masses.inverse[0],
            (force - support(1)) * masses.inverse[1],
            (-force - support(2)) * masses.inverse[2],
        );
    }
}

/// ẏ₁ at `INSTANTS` + 1 even instants of the turn after the start-up.
fn reference_velocity(pair: &GearPair, cycle: &MeshCycle) -> Vec<f64> {
    let (excitation, masses) = (Excitation::new(pair, cycle), Masses::new(pair, cycle));
    let turn_s = 1.0 / excitation.shaft_hz;
    let force = masses.drive / masses.inverse[0];
    let [stiffness, error, _] = excitation.at(0.0, 1e-9);
    let support = force / masses.support[0];
    let mut state =
        Vector6::new(force / stiffness + 2.0 * support + error, support, -support, 0.0, 0.0, 0.0) / PLACE_M;
    let mut kept = Vec::with_capacity(INSTANTS + 1);
    let mut cut_places = excitation.cuts.clone();
    cut_places.sort_by(f64::total_cmp);
    for n in 0..=(SETTLING_TURNS + 1) * INSTANTS {
        if n >= SETTLING_TURNS * INSTANTS {
            kept.push(state[4]);
        }
        let (start, end) = (n as f64 * turn_s / INSTANTS as f64, (n + 1) as f64 * turn_s / INSTANTS as f64);
        let first_period = (start * excitation.mesh_hz).floor();
        let mut cuts: Vec<f64> = [0.0, 1.0]
            .iter()
            .flat_map(|period| {
                cut_places.iter().map(move |cut| (first_period + period + cut) / excitation.mesh_hz)
            })
            .filter(|cut| *cut > start && *cut <= end)
            .collect();
        cuts.push(end);
        let mut from = start;
        for (k, to) in cuts.iter().enumerate() {
            if to - from > 1e-13 {
                let interval =
                    Interval { excitation: &excitation, masses: &masses, inside: 0.5 * (from + to) };
                let mut solver = Dop853::new(interval, from, *to, to - from, state, TOLERANCE, TOLERANCE);
                solver.set_output(OutputType::Sparse);
                solver.integrate().unwrap();
                state = *solver.y_out().last().unwrap();
            }
            if k + 1 < cuts.len() {
                // ė is an impulse where e jumps: the damper passes it on.
                let jump = excitation.at(*to, to + 1e-9)[1] - excitation.at(*to, to - 1e-9)[1];
                for (i, sign) in [(0, 1.0), (1, -1.0), (2, 1.0)] {
                    state[3 + i] += sign * masses.damping * jump * masses.inverse[i];
                }
            }
            from = *to;
        }
    }
    kept
}

fn transform(mut values: Vec<f64>) -> Vec<Complex<f64>> {
    let count = values.len();
    let plan = f64::forward_plan(count);
    let mut bins = plan.make_output_vec();
    plan.process(&mut values, &mut bins).unwrap();
    bins.iter().map(|bin| bin / count as f64).collect()
}

/// Fourier coefficients of ÿ₁ over the turn. A difference of velocities is the mean acceleration over its
/// interval, jumps and impulses included; the mean's own transfer function is divided out.
fn reference_coefficients(velocity: &[f64]) -> Vec<Complex<f64>> {
    let rate = INSTANTS as f64;
    let means = velocity.windows(2).map(|two| (two[1] - two[0]) * rate).collect();
    let bins = transform(means);
    let mean_over_interval = |k: usize| {
        let half = PI * k as f64 / rate;
        Complex::from_polar(if k == 0 { 1.0 } else { half.sin() / half }, half)
    };
    bins.iter().enumerate().map(|(k, bin)| bin / mean_over_interval(k)).collect()
}

/// One turn's waveform from Fourier coefficients 1 to `last`.
fn waveform(coefficients: &[Complex<f64>], last: usize, count: usize) -> Vec<f64> {
    let plan = f64::inverse_plan(count);
    let mut bins = plan.make_input_vec();
    bins[1..=last].copy_from_slice(&coefficients[1..=last]);
    let mut values = plan.make_output_vec();
    plan.process(&mut bins, &mut values).unwrap();
    values
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// Holds one state against the reference at both sampling rates.
fn compare(contact: ContactRule, wear_mm: f64, mesh_damping_ratio: f64) {
    let mut spec = PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml")).unwrap();
    spec.errors.random_um = Some(0.0);
    (spec.dynamics.contact, spec.dynamics.mesh_damping_ratio) = (contact, mesh_damping_ratio);
    let pair = spec.resolve().unwrap();
    let wear = FlankWear::from_shape(&pair, wear_mm).unwrap();
    let fine = MeshCycle::compute(&pair, &wear, POINTS).unwrap();
    let shaft_hz = spec.operation.shaft_speed_hz;
    // Velocities per second, so that a turn's coefficients are in m/s².
    let velocity: Vec<f64> = reference_velocity(&pair, &fine).iter().map(|v| v * shaft_hz).collect();
    let reference = reference_coefficients(&velocity);

    let cycle = MeshCycle::compute(&pair, &wear, 1000).unwrap();
    // Whole samples a turn: 19 968 Hz, near the 20 kHz of records, and five times that. Loaded contact has
    // kinks where the threshold rule has jumps at known places; what a cell of the cycle rounds off them
    // shows above 8 kHz (0.5 % of the worn pair's RMS at the higher rate).
    let rates: &[usize] = if contact == ContactRule::Loaded { &[1200] } else { &[1200, 6000] };
    for &per_turn in rates {
        let run = RunSettings::nominal(&pair, shaft_hz * per_turn as f64, 1.0 / shaft_hz);
        let signal = simulate(&pair, &cycle, &run).unwrap();
        assert_eq!(signal.len(), per_turn);
        let last = per_turn * 2 / 5;
        let (got, wanted) =
            (waveform(&transform(signal), last, per_turn), waveform(&reference, last, per_turn));
        let peak = wanted.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        let worst = got.iter().zip(&wanted).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
        let (rms_error, waveform_error) = (rms(&got) / rms(&wanted) - 1.0, worst / peak);
        println!(
            "{contact}, wear {wear_mm} mm, damping ratio {mesh_damping_ratio}, {:.0} Hz: RMS {:.4} m/s2, off by {:+.5} %; waveform off by {:.4} % of its peak",
            run.sample_rate_hz,
            rms(&wanted),
            100.0 * rms_error,
            100.0 * waveform_error
        );
        assert!(rms_error.abs() < 1e-3, "RMS off by {rms_error:.2e}");
        assert!(waveform_error < 1e-2, "waveform off by {waveform_error:.2e} of its peak");
    }
}

#[test]
fn unworn_response_matches_the_independent_solver() {
    compare(ContactRule::Threshold, 0.0, 0.5);
}

#[test]
fn slightly_worn_response_matches_the_independent_solver() {
    compare(ContactRule::Threshold, 0.05, 0.5);
}

#[test]
fn heavily_worn_response_matches_the_independent_solver() {
    compare(ContactRule::Threshold, 0.2, 0.5);
}

#[test]
fn weakly_damped_response_matches_the_independent_solver() {
    compare(ContactRule::Threshold, 0.1, 0.07);
}

#[test]
fn loaded_contact_matches_the_independent_solver() {
    compare(ContactRule::Loaded, 0.0, 0.5);
    compare(ContactRule::Loaded, 0.1, 0.5);
}

/// Teeth part here, and strike.
#[test]
fn weakly_damped_loaded_contact_matches_the_independent_solver() {
    compare(ContactRule::Loaded, 0.1, 0.07);
}
