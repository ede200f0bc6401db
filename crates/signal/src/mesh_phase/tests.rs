use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::sums::mean_of;

const RATE_HZ: f64 = 4000.0;
const SECONDS: f64 = 10.0;
const TEETH: u32 = 24;
const SHAFT_HZ: f64 = 16.64;

/// Angle of a mesh line of amplitude 1 at a constant speed in white noise.
fn tracked(noise: f64, seed: u64) -> ShaftAngle {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let length = (SECONDS * RATE_HZ) as usize;
    let mut samples: Vec<f64> = (0..length)
        .map(|k| {
            let error: f64 = StandardNormal.sample(&mut random);
            (TAU * f64::from(TEETH) * SHAFT_HZ * k as f64 / RATE_HZ + 1.0).cos() + noise * error
        })
        .collect();
    let (mut transforms, mut bins) = (Transforms::default(), Vec::new());
    transforms.forward(&mut samples, &mut bins);
    let mesh_hz = f64::from(TEETH) * SHAFT_HZ;
    let band = MeshBand { bins: &bins, length, sample_rate_hz: RATE_HZ, teeth: TEETH, mesh_hz };
    band.track_known(&mut transforms).unwrap()
}

fn reported(angle: &ShaftAngle) -> (f64, f64) {
    match angle.source() {
        AngleSource::MeshPhase { line_to_background, angle_error_deg, .. } => {
            (line_to_background, angle_error_deg)
        }
        other => panic!("{other:?}"),
    }
}

/// The background of a line in white noise is the noise in the line's band, and the angle error is the one
/// against the true angle, both within a fifth: the first phase follows a part of the noise beside the line.
#[test]
fn ratio_and_error_are_those_of_the_noise() {
    for noise in [0.1, 0.3, 0.5, 1.0] {
        // The analytic signal has twice the power in half the band.
        let true_ratio = 1.0 / (4.0 * noise * noise * 2.0 * LINE_REACH_SHAFTS * SHAFT_HZ / RATE_HZ).sqrt();
        let runs = 12;
        let (mut ratios, mut errors) = (0.0, 0.0);
        for seed in 0..runs {
            let angle = tracked(noise, seed);
            let (ratio, error_deg) = reported(&angle);
            ratios += ratio / true_ratio / runs as f64;
            let times: Vec<f64> = (0..2000).map(|k| 1.0 + 8.0 * f64::from(k) / 2000.0).collect();
            let ahead: Vec<f64> = times.iter().map(|t| angle.revolution(*t) - SHAFT_HZ * t).collect();
            let mean = mean_of(&ahead, |ahead| *ahead);
            let scatter_deg = 360.0 * mean_of(&ahead, |ahead| (ahead - mean).powi(2)).sqrt();
            errors += error_deg / scatter_deg / runs as f64;
        }
        assert!((1.0..1.2).contains(&ratios), "noise {noise}: {ratios}");
        assert!((0.75..1.0).contains(&errors), "noise {noise}: {errors}");
    }
}

/// Without noise there is hardly any background.
#[test]
fn a_computed_line_has_a_high_ratio() {
    let (ratio, error_deg) = reported(&tracked(0.0, 1));
    assert!(ratio > 200.0 && error_deg < 1e-2, "{ratio} {error_deg}");
}
