//! The dynamics with teeth that differ: Eqs. (23) and (24) with less stiffness in one mesh period per turn,
//! as with a crack, and with an error of each tooth's position.
//!
//! All teeth of the gear model are alike, so this module integrates the same equations from the cycle's
//! tables: velocities in x_m = x − y₁ + y₂ − e take e by differences over a step. The driven torque balances
//! the driving one, and teeth that part do not touch with their back flanks.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use flankwatch_gear::{GearPair, MeshCycle, ResponseCoordinate, RunSettings};

/// Integration steps per sample.
const OVERSAMPLING: usize = 8;

/// Transient in seconds that is discarded.
const SETTLING_S: f64 = 0.1;

/// What distinguishes the driving gear's teeth.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct UnevenTeeth<'a> {
    /// Part of the stiffness that is missing at the middle of one tooth's mesh period.
    pub(super) loss: f64,
    /// Position error of each tooth in m, cyclic; empty for teeth in their places.
    pub(super) pitch_errors_m: &'a [f64],
}

struct Cycle<'a> {
    cycle: &'a MeshCycle,
    pair: &'a GearPair,
    run: &'a RunSettings,
    teeth: UnevenTeeth<'a>,
    random: Vec<f64>,
}

impl Cycle<'_> {
    /// Returns k in N/m and e in m.
    fn at(&self, seconds: f64) -> (f64, f64) {
        let teeth = f64::from(self.pair.gears[0].teeth);
        let turns = self.run.start_phase_turns + self.run.shaft_speed_hz * (seconds + 1.0);
        let periods = turns * teeth;
        let place = periods.rem_euclid(1.0) * self.cycle.stiffness_n_per_m.len() as f64;
        let points = self.cycle.stiffness_n_per_m.len();
        let (i, part) = (place as usize % points, place.fract());
        let between = |values: &[f64]| values[i] + part * (values[(i + 1) % points] - values[i]);
        let weak = (periods.floor() as i64).rem_euclid(i64::from(self.pair.gears[0].teeth)) == 0;
        // The load moves onto and off the tooth gradually.
        let bend = (TAU / 2.0 * periods.rem_euclid(1.0)).sin().powi(2);
        let left = if weak { 1.0 - self.teeth.loss * bend } else { 1.0 };
        let errors = &self.pair.errors;
        let clock = (seconds + SETTLING_S) * errors.random_clock_hz;
        let (tick, fraction) = ((clock.max(0.0) as usize).min(self.random.len() - 2), clock.fract());
        let random = self.random[tick] + fraction * (self.random[tick + 1] - self.random[tick]);
        let error = self.pair.gears[1].base_radius_mm * 1e-3 * between(&self.cycle.uste_rad)
            + errors.long_period_um * 1e-6 * (TAU * turns).sin()
            + errors.short_period_m(periods)
            + errors.random_um * 1e-6 * random
            + self.pitch_error_m(periods);
        (left * between(&self.cycle.stiffness_n_per_m), error)
    }

    /// The error of the teeth that carry the load. While two pairs share it, it passes from one to the other.
    fn pitch_error_m(&self, periods: f64) -> f64 {
        let errors_m = self.teeth.pitch_errors_m;
        if errors_m.is_empty() {
            return 0.0;
        }
        let tooth = periods.floor();
        let of = |tooth: f64| errors_m[tooth.rem_euclid(errors_m.len() as f64) as usize];
        let shared = (self.pair.contact_ratio() - 1.0).clamp(f64::MIN_POSITIVE, 1.0);
        let part = ((periods - tooth) / shared).min(1.0);
        of(tooth - 1.0) + part * (of(tooth) - of(tooth - 1.0))
    }
}

/// Simulates like [`flankwatch_gear::simulate`], with teeth that differ.
pub(super) fn simulate(
    pair: &GearPair,
    cycle: &MeshCycle,
    run: &RunSettings,
    teeth: UnevenTeeth<'_>,
) -> Vec<f64> {
    let samples = (run.seconds * run.sample_rate_hz).round() as usize;
    let step = 1.0 / (run.sample_rate_hz * OVERSAMPLING as f64);
    let mut rng = ChaCha8Rng::seed_from_u64(run.seed);
    let ticks = ((run.seconds + 2.0 * SETTLING_S) * pair.errors.random_clock_hz) as usize + 4;
    let excitation =
        Cycle { cycle, pair, run, teeth, random: (0..ticks).map(|_| rng.random::<f64>()).collect() };
    let mesh_mass = pair.mesh_mass_kg();
    let inverse = [1.0 / mesh_mass, 1.0 / pair.gears[0].mass_kg, 1.0 / pair.gears[1].mass_kg];
    let damping =
        2.0 * pair.spec.dynamics.mesh_damping_ratio * (cycle.mean_stiffness_n_per_m() * mesh_mass).sqrt();
    let force = run.torque_nm / (pair.gears[0].base_radius_mm * 1e-3);
    let drive = force * inverse[0];
    let supports = pair.supports;
    // The velocities minus the damper's part c·x_m/m are continuous even where e is not.
    let slope = |s: &[f64; 6], (k, e): (f64, f64)| -> [f64; 6] {
        let mesh = (s[0] - s[1] + s[2] - e).max(0.0);
        let damped = damping * mesh;
        let v = [s[3] - damped * inverse[0], s[4] + damped * inverse[1], s[5] - damped * inverse[2]];
        let push = k * mesh;
        let bearing = |i: usize| supports.damping_n_s_per_m * v[i] + supports.stiffness_n_per_m * s[i];
        [
            v[0],
            v[1],
            v[2],
            drive - push * inverse[0],
            (push - bearing(1)) * inverse[1],
            (-push - bearing(2)) * inverse[2],
        ]
    };
    let (k, e) = excitation.at(-SETTLING_S);
    let (mesh, support) = (force / k, force / supports.stiffness_n_per_m);
    let part = inverse.map(|inverse| damping * mesh * inverse);
    let mut state = [mesh + 2.0 * support + e, support, -support, part[0], -part[1], part[2]];
    let ahead = |s: &[f64; 6], d: &[f64; 6], h: f64| -> [f64; 6] { std::array::from_fn(|i| s[i] + h * d[i]) };
    let settling = (SETTLING_S * run.sample_rate_hz) as usize;
    let mut positions = Vec::with_capacity((samples + settling) * OVERSAMPLING + 2);
    let mut start = excitation.at(-SETTLING_S);
    for n in 0..(samples + settling) * OVERSAMPLING + 2 {
        let t = n as f64 * step - SETTLING_S;
        let (middle, end) = (excitation.at(t + 0.5 * step), excitation.at(t + step));
        let k1 = slope(&state, start);
        let k2 = slope(&ahead(&state, &k1, 0.5 * step), middle);
        let k3 = slope(&ahead(&state, &k2, 0.5 * step), middle);
        let k4 = slope(&ahead(&state, &k3, step), end);
        state = std::array::from_fn(|i| state[i] + step / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]));
        start = end;
        positions.push(match pair.spec.dynamics.response {
            ResponseCoordinate::Bearing1 => state[1],
            ResponseCoordinate::Bearing2 => state[2],
            ResponseCoordinate::Mesh => state[0] - state[1] + state[2],
        });
    }
    let acceleration: Vec<f64> =
        positions.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]) / (step * step)).collect();
    // A Hann-weighted mean over three samples' length, then decimation by eight.
    let reach = 3 * OVERSAMPLING / 2;
    let weights: Vec<f64> = (0..=2 * reach)
        .map(|i| (TAU / 2.0 * (i as f64 + 1.0) / (2 * reach + 2) as f64).sin().powi(2))
        .collect();
    let total: f64 = weights.iter().sum();
    (0..samples)
        .map(|n| {
            let at = (n + settling) * OVERSAMPLING - reach;
            let sum: f64 = weights.iter().zip(&acceleration[at..]).map(|(w, a)| w * a).sum();
            sum / total
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use flankwatch_gear::{ContactRule, FlankWear, PairSpec};
    use flankwatch_signal::{AnalysisSettings, Analyzer, ByName, MeshContext};
    use flankwatch_wear::library::response_record;
    use rand_distr::{Distribution, StandardNormal};
    use rayon::prelude::*;

    use super::*;

    /// Depths in µm.
    const DEPTHS_UM: [f64; 6] = [0.0, 10.0, 20.0, 50.0, 120.0, 220.0];

    /// Noise 30 dB below the vibration.
    const NOISE: f64 = 0.03;

    /// Returns the checks of the teeth by depth, for pitch errors of this standard deviation.
    fn checks(contact: ContactRule, pitch_um: f64, seed: u64) -> Vec<ByName<f64>> {
        let mut spec = PairSpec::from_toml(include_str!("../../../../fixtures/pairs/shen2022.toml")).unwrap();
        (spec.dynamics.contact, spec.dynamics.mesh_damping_ratio) = (contact, 0.08);
        let pair = spec.resolve().unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let errors: Vec<f64> = (0..pair.gears[0].teeth).map(|_| 1e-6 * pitch_um * normal()).collect();
        let mut run = RunSettings::nominal(&pair, 20_000.0, 2.2);
        run.seed = seed;
        let checks = |depth_um: &f64| {
            let worn = FlankWear::from_shape(&pair, depth_um * 1e-3).unwrap();
            let cycle = MeshCycle::compute(&pair, &worn, 1000).unwrap();
            let teeth = UnevenTeeth { loss: 0.0, pitch_errors_m: &errors };
            let mut samples = simulate(&pair, &cycle, &run, teeth);
            let power = samples.iter().map(|a| a * a).sum::<f64>() / samples.len() as f64;
            let mut random = ChaCha8Rng::seed_from_u64(seed + 1);
            for sample in &mut samples {
                let normal: f64 = StandardNormal.sample(&mut random);
                *sample += NOISE * power.sqrt() * normal;
            }
            let mesh = MeshContext::at_exact_speed([pair.gears[0].teeth, 0], run.shaft_speed_hz);
            let record = response_record(&run, &samples).unwrap();
            let features = Analyzer::new(AnalysisSettings::default()).analyze(&record, &mesh).features;
            let of_teeth = |name: &str| name.starts_with("ln_tooth_") && name.ends_with("_32");
            features.checks.into_iter().filter(|(name, _)| of_teeth(name)).collect::<ByName<f64>>()
        };
        DEPTHS_UM.par_iter().map(checks).collect()
    }

    #[test]
    fn the_error_of_a_tooth_begins_at_its_phase() {
        let mut spec = PairSpec::from_toml(include_str!("../../../../fixtures/pairs/shen2022.toml")).unwrap();
        (spec.errors.random_um, spec.errors.short_period_phase) = (Some(0.0), 0.25);
        let pair = spec.resolve().unwrap();
        let cycle = MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, 0.0).unwrap(), 1000).unwrap();
        let run = RunSettings::nominal(&pair, 20_000.0, 1.0);
        let teeth = UnevenTeeth::default();
        let start = Cycle { cycle: &cycle, pair: &pair, run: &run, teeth, random: vec![0.0; 2] }.at(-1.0);
        let expected = cycle.uste_rad[0] * pair.gears[1].base_radius_mm * 1e-3 + 15e-6;
        assert!((start.1 - expected).abs() < 1e-12, "{} m", start.1);
    }

    /// The estimate allows for a rise of 0.25 (`healthy_checks.rs` in the package `wear`).
    #[test]
    fn wear_raises_the_checks_of_uneven_teeth_by_less_than_a_quarter() {
        for contact in [ContactRule::Threshold, ContactRule::Loaded] {
            for (pitch_um, seed) in [(2.0, 1), (5.0, 2), (5.0, 3)] {
                let by_depth = checks(contact, pitch_um, seed);
                assert_eq!(by_depth[0].len(), 3);
                assert!(by_depth[0]["ln_tooth_repeated_32"] > 0.2, "the errors stand out of the noise");
                for (name, unworn) in &by_depth[0] {
                    let rises = by_depth.iter().map(|worn| worn[name] - unworn);
                    let most = rises.fold(0.0, f64::max);
                    assert!(most < 0.25, "{contact:?}, {pitch_um} µm: {name} rises by {most}");
                }
            }
        }
    }
}
