//! Tests of simulated runs.

use std::f64::consts::TAU;

use nalgebra::{Complex, Matrix3, Vector3};

use crate::mesh_cycle::CyclePiece;
use crate::testing::{shen2022, shen2022_spec};
use std::sync::atomic::AtomicBool;

use super::{Motion, RunSettings, simulate, simulate_refined, simulate_together};
use crate::{FlankWear, MeshCycle, ResponseCoordinate};

fn rms(signal: &[f64]) -> f64 {
    (signal.iter().map(|value| value * value).sum::<f64>() / signal.len() as f64).sqrt()
}

fn worn(depth_mm: f64) -> (crate::GearPair, MeshCycle) {
    let pair = shen2022();
    let cycle = MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth_mm).unwrap(), 1000).unwrap();
    (pair, cycle)
}

#[test]
fn with_constant_stiffness_the_response_is_the_transfer_function() {
    let mut spec = shen2022_spec();
    spec.errors.random_um = Some(0.0);
    spec.errors.long_period_um = Some(0.0);
    let (k, f) = (6e8, 16.64 * 24.0);
    for (response, row) in
        [(ResponseCoordinate::Bearing1, 1), (ResponseCoordinate::Bearing2, 2), (ResponseCoordinate::Mesh, 3)]
    {
        spec.dynamics.response = response;
        let pair = spec.resolve().unwrap();
        let mut cycle = MeshCycle::compute(&pair, &FlankWear::none(), 1000).unwrap();
        cycle.pieces = vec![CyclePiece {
            start: 0.0,
            end: 1.0,
            stiffness_n_per_m: vec![k; 1025],
            uste_rad: vec![0.0; 1025],
        }];
        let motion = Motion::new(&pair, &cycle, 1300.0);
        // m_j q̈_j = s_j F_m − support, F_m = (k + iωc)(x − y₁ + y₂ − e), for e = 15 µm e^{iωt}.
        let omega = TAU * f;
        let mesh = Complex::new(k, omega * motion.mesh_damping_n_s_per_m);
        let support =
            Complex::new(motion.support_stiffness_n_per_m, omega * motion.support_damping_n_s_per_m);
        let signs = [1.0, -1.0, 1.0];
        let mut dynamic = Matrix3::from_fn(|i, j| mesh * signs[i] * signs[j]);
        for i in 0..3 {
            dynamic[(i, i)] += -omega * omega / motion.inverse_mass_per_kg[i];
        }
        dynamic[(1, 1)] += support;
        dynamic[(2, 2)] += support;
        let force = Vector3::from_fn(|i, _| mesh * signs[i] * 15e-6);
        let solved = dynamic.lu().solve(&force).unwrap();
        let q = if row == 3 { solved[0] - solved[1] + solved[2] } else { solved[row] };
        let wanted = -omega * omega * q;

        let run = RunSettings::nominal(&pair, 20_000.0, 0.5);
        let signal = simulate(&pair, &cycle, &run).unwrap();
        // e = A sin: the imaginary part of wanted·e^{iωt}.
        let worst = signal.iter().enumerate().map(|(n, value)| {
            (value - (wanted * Complex::from_polar(1.0, omega * n as f64 / 20_000.0)).im).abs()
        });
        let worst = worst.fold(0.0, f64::max);
        assert!(worst < 1e-4 * wanted.norm(), "{response:?}: {worst} of {}", wanted.norm());
    }
}

#[test]
fn halving_the_step_changes_nothing_that_matters() {
    let (pair, cycle) = worn(0.12);
    let settings = RunSettings::nominal(&pair, 20_000.0, 0.25);
    let with = |oversampling| simulate_refined(&pair, &[&cycle], &settings, oversampling).remove(0);
    let (used, halved) = (with(8), with(16));
    let difference: Vec<f64> = used.iter().zip(&halved).map(|(a, b)| a - b).collect();
    assert!(rms(&difference) < 1e-3 * rms(&halved), "{} of {}", rms(&difference), rms(&halved));
    assert!((rms(&used) / rms(&halved) - 1.0).abs() < 2e-4, "{}", rms(&used) / rms(&halved) - 1.0);
}

#[test]
fn no_wear_state_shows_spikes() {
    for depth in [0.0, 0.03, 0.1, 0.245] {
        let (pair, cycle) = worn(depth);
        let signal = simulate(&pair, &cycle, &RunSettings::nominal(&pair, 20_000.0, 1.0)).unwrap();
        assert_eq!(signal.len(), 20_000);
        let mean_square = rms(&signal).powi(2);
        let kurtosis =
            signal.iter().map(|value| value.powi(4)).sum::<f64>() / signal.len() as f64 / mean_square.powi(2);
        assert!((3.0..25.0).contains(&kurtosis), "kurtosis {kurtosis} at {depth} mm");
        // Every mesh period has its impact: the largest is no outlier of the typical one.
        let mut peaks: Vec<f64> = signal
            .chunks(50)
            .map(|period| period.iter().fold(0.0, |most: f64, value| most.max(value.abs())))
            .collect();
        peaks.sort_by(f64::total_cmp);
        assert!(
            peaks[peaks.len() - 1] < 2.0 * peaks[peaks.len() / 2],
            "{} {}",
            peaks[peaks.len() - 1],
            peaks[peaks.len() / 2]
        );
    }
}

#[test]
fn a_run_may_start_anywhere_in_the_turn() {
    let mut spec = shen2022_spec();
    spec.errors.random_um = Some(0.0);
    let pair = spec.resolve().unwrap();
    let cycle = MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, 0.1).unwrap(), 1000).unwrap();
    let from_zero = simulate(&pair, &cycle, &RunSettings::nominal(&pair, 20_000.0, 0.2)).unwrap();
    let mut run = RunSettings::nominal(&pair, 20_000.0, 0.1);
    run.start_phase_turns = 16.64 * 0.1;
    let later = simulate(&pair, &cycle, &run).unwrap();
    let difference: Vec<f64> = later.iter().zip(&from_zero[2000..]).map(|(a, b)| a - b).collect();
    assert!(rms(&difference) < 1e-5 * rms(&later), "{}", rms(&difference) / rms(&later));
}

#[test]
fn seed_torque_and_speed_are_the_runs_own() {
    let (pair, cycle) = worn(0.05);
    let run = RunSettings::nominal(&pair, 20_000.0, 0.1);
    let base = simulate(&pair, &cycle, &run).unwrap();
    assert_eq!(simulate(&pair, &cycle, &run).unwrap(), base);
    for changed in [
        RunSettings { seed: 2, ..run },
        RunSettings { torque_nm: 900.0, ..run },
        RunSettings { shaft_speed_hz: 15.0, ..run },
    ] {
        assert_ne!(simulate(&pair, &cycle, &changed).unwrap(), base);
    }
    // A longer record begins with the shorter one.
    let longer = simulate(&pair, &cycle, &RunSettings { seconds: 0.15, ..run }).unwrap();
    assert_eq!(&longer[..2000], &base[..]);
}

/// Lanes know nothing of each other but for the length of the start-up.
#[test]
fn records_simulated_together_equal_single_ones() {
    let pair = shen2022();
    let worn =
        |depth: f64| MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth).unwrap(), 1000).unwrap();
    let cycles: Vec<MeshCycle> = (0..10).map(|i| worn(0.02 * f64::from(i))).collect();
    let run = RunSettings::nominal(&pair, 20_000.0, 0.05);
    let together = simulate_together(&pair, &cycles.iter().collect::<Vec<_>>(), &run, None).unwrap();
    assert_eq!(together.len(), 10);
    for (cycle, record) in cycles.iter().zip(together) {
        let alone = simulate(&pair, cycle, &run).unwrap();
        let difference: Vec<f64> = alone.iter().zip(&record).map(|(a, b)| a - b).collect();
        assert!(rms(&difference) < 1e-6 * rms(&alone), "{}", rms(&difference) / rms(&alone));
    }
    let stop = AtomicBool::new(true);
    let stopped = simulate_together(&pair, &[&cycles[0]], &run, Some(&stop)).unwrap_err();
    assert!(matches!(stopped, crate::GearError::Stopped));
}
