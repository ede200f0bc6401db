use std::f64::consts::{PI, SQRT_2};

use jiff::Timestamp;
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::{BandError, BandSource, EnvelopeBand, EnvelopeSearch, Record};

const RATE_HZ: f64 = 20_000.0;
const SHAFT_HZ: f64 = 16.71;

const MESH: MeshContext = MeshContext::new([24, 0], 16.64, 0.05);

/// Harmonics of amplitude 1/h, once-per-turn amplitude modulation of depth 0.2, and white noise of this
/// deviation.
fn gear(samples: usize, noise: f64, offset: f64) -> Record {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let signal = (0..samples).map(|i| {
        let turn = 2.0 * PI * SHAFT_HZ * i as f64 / RATE_HZ;
        let lines: f64 = (1..=10)
            .map(|h| {
                (1.0 + 0.2 * turn.cos()) / f64::from(h)
                    * (24.0 * f64::from(h) * turn + f64::from(h * h)).sin()
            })
            .sum();
        let normal: f64 = StandardNormal.sample(&mut random);
        (offset + lines + noise * normal) as f32
    });
    record(signal.collect())
}

fn record(samples: Vec<f32>) -> Record {
    Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "m/s2", samples).unwrap()
}

fn at_speed(record: Record, shaft_speed_hz: f64) -> Record {
    let point = OperatingPoint { shaft_speed_hz: Some(shaft_speed_hz), ..OperatingPoint::default() };
    record.with_operating_point(point).unwrap()
}

fn analyze(record: &Record, mesh: MeshContext) -> Analysis {
    Analyzer::new(AnalysisSettings::default()).analyze(record, &mesh)
}

/// The amplitudes put in: A_h = 1/h; each sideband 0.1/h, two of them; the envelope's shaft line 0.2/h.
/// With and without noise.
#[test]
fn generated_lines_are_measured() {
    for noise in [0.0, 0.05] {
        let got = analyze(&gear(40_000, noise, 0.0), MESH);
        let speed = got.shaft_speed.unwrap();
        assert_eq!(speed.source, SpeedSource::MeshComb);
        assert!((speed.shaft_speed_hz - SHAFT_HZ).abs() < 1e-3, "{speed:?}");
        let within = 2e-3 + 0.1 * noise;
        for order in 1..=10 {
            let want = 1.0 / f64::from(order);
            let line = got.indicators.values[&format!("mesh_{order}")];
            assert!((line / want - 1.0).abs() < within, "{order}: {line}");
        }
        assert_eq!(got.indicators.values["omx"], got.indicators.values["mesh_1"]);
        assert_eq!(got.mesh_lines.len(), 10);
        assert!((got.mesh_lines[9].frequency_hz - 240.0 * SHAFT_HZ).abs() < 0.1);
        for order in 1..=4 {
            let sideband = got.features.values[&format!("ln_sideband_{order}")].exp();
            assert!(
                (sideband * f64::from(order) / (0.1 * SQRT_2) - 1.0).abs() < 10.0 * within,
                "{order}: {sideband}"
            );
            let envelope = got.features.values[&format!("ln_env_{order}")].exp();
            assert!((envelope * f64::from(order) / 0.2 - 1.0).abs() < 10.0 * within, "{order}: {envelope}");
        }
    }
}

/// A record whose speed swings by ± 0.3 %, with these harmonics, and white noise of this deviation.
fn swinging(orders: std::ops::RangeInclusive<u32>, noise: f64, seed: u64) -> Record {
    let (swing, swing_hz) = (0.003, 0.6);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let samples = (0..40_000).map(|i| {
        let t = f64::from(i) / RATE_HZ;
        let turn = 2.0 * PI * SHAFT_HZ * t + swing * SHAFT_HZ / swing_hz * (2.0 * PI * swing_hz * t).sin();
        let lines: f64 = orders.clone().map(|h| (24.0 * f64::from(h) * turn + f64::from(h * h)).sin()).sum();
        let normal: f64 = StandardNormal.sample(&mut random);
        (lines + noise * normal) as f32
    });
    record(samples.collect())
}

/// Harmonics 11 to 16 alone, of amplitude 1 each, which the swing smears over 60 to 100 bins.
#[test]
fn smeared_high_harmonics_are_found_and_read() {
    for seed in 0..10 {
        let got = analyze(&swinging(11..=16, 3.0, seed), MESH);
        let speed = got.shaft_speed.unwrap();
        assert!((speed.shaft_speed_hz / SHAFT_HZ - 1.0).abs() < 1e-3 && speed.doubt.is_none(), "{speed:?}");
        for order in 11..=16 {
            let line = got.features.values[&format!("ln_mesh_{order}")];
            assert!(line.abs() < 0.15, "{seed} {order}: {line}");
        }
    }
}

/// Harmonics 9 to 16 in so much noise that none of them can be followed alone.
#[test]
fn weak_lines_are_read_along_the_fluctuation_of_all_together() {
    for seed in 0..10 {
        let got = analyze(&swinging(9..=16, 12.0, seed), MESH);
        let speed = got.shaft_speed.unwrap();
        assert!((speed.shaft_speed_hz / SHAFT_HZ - 1.0).abs() < 1e-3 && speed.doubt.is_none(), "{speed:?}");
        let lines = (9..=16).map(|order| got.features.values[&format!("ln_mesh_{order}")]);
        let mean = lines.sum::<f64>() / 8.0;
        assert!(mean.abs() < 0.2, "{seed}: {mean}");
    }
}

/// White noise through four resonances with a damping ratio of 0.01, each about as wide as a smeared line.
#[test]
fn resonances_are_not_a_mesh() {
    let mut accepted = 0;
    for seed in 0..40 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut samples = vec![0.0; 40_000];
        for resonance in 0..4 {
            let frequency_hz = 1500.0 + 1300.0 * f64::from(resonance) + 37.0 * seed as f64;
            let angle = 2.0 * PI * frequency_hz / RATE_HZ;
            let decay = (-0.01 * angle).exp();
            let (mut before, mut last) = (0.0, 0.0);
            for sample in &mut samples {
                let normal: f64 = StandardNormal.sample(&mut random);
                let next = 2.0 * decay * angle.cos() * last - decay * decay * before + normal;
                (before, last) = (last, next);
                *sample += next as f32;
            }
        }
        let got = analyze(&record(samples), MESH);
        accepted += usize::from(got.shaft_speed.is_some_and(|speed| speed.doubt.is_none()));
    }
    assert!(accepted <= 1, "{accepted} of 40");
}

/// White noise of deviation s: root-mean-square amplitude s·√(4·1.5/N) in a Hann bin, twice that in four
/// sidebands.
#[test]
fn backgrounds_match_the_generated_noise() {
    let got = analyze(&gear(40_000, 0.05, 0.0), MESH);
    let bin = 0.05 * (6.0_f64 / 40_000.0).sqrt();
    for order in 1..=4 {
        for (name, want) in [("ln_mesh", bin), ("ln_sideband", 2.0 * bin)] {
            let background = got.features.background[&format!("{name}_{order}")];
            assert!((background - want.ln()).abs() < 0.3, "{name} {order}: {background} {}", want.ln());
        }
    }
    let Features { values, checks, background, .. } = &got.features;
    assert!(background.keys().all(|name| values.contains_key(name) || checks.contains_key(name)));
    // Without lines of the shaft its checks are read in noise alone.
    for order in 1..=3 {
        let name = format!("ln_shaft_{order}");
        assert!(
            (checks[&name] - background[&name]).abs() < 0.3,
            "{name}: {} {}",
            checks[&name],
            background[&name]
        );
    }
}

/// A gain shifts every feature but the kurtosis by its logarithm; an offset changes none.
#[test]
fn gain_is_an_offset_and_an_offset_has_no_effect() {
    let plain = analyze(&gear(20_000, 0.05, 0.0), MESH).features;
    let record_with_gain = gear(20_000, 0.05, 0.0).samples().iter().map(|x| 8.0 * x).collect();
    let gained = analyze(&record(record_with_gain), MESH).features;
    let moved = analyze(&gear(20_000, 0.05, 3.0), MESH).features;
    assert_eq!(plain.values.len(), 16 + 4 + 4 + 2);
    for (name, value) in &plain.values {
        let gain = if name == "ln_kurtosis" { 0.0 } else { 8.0_f64.ln() };
        assert!((gained.values[name] - value - gain).abs() < 1e-9, "{name}");
        assert!((moved.values[name] - value).abs() < 1e-3, "{name}");
    }
}

#[test]
fn a_given_speed_is_kept_and_its_lines_are_located() {
    let got = analyze(&at_speed(gear(200_000, 0.05, 0.0), 16.7), MESH);
    let speed = got.shaft_speed.unwrap();
    assert_eq!((speed.shaft_speed_hz, speed.source), (16.7, SpeedSource::Record));
    assert!((got.mesh_lines[0].frequency_hz - 24.0 * SHAFT_HZ).abs() < 0.01);
    let exact = MeshContext { nominal_is_exact: true, nominal_shaft_speed_hz: SHAFT_HZ, ..MESH };
    assert_eq!(analyze(&gear(20_000, 0.05, 0.0), exact).shaft_speed.unwrap().source, SpeedSource::Asset);
}

#[test]
fn missing_indicators_have_a_reason() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let noise = record((0..20_000).map(|_| StandardNormal.sample(&mut random)).collect());
    let got = analyze(&noise, MESH);
    assert_eq!((got.shaft_speed, got.mesh_lines.len()), (None, 0));
    assert_eq!(got.indicators.absent["omx"], NotComputed::NoSpeed);
    assert_eq!(got.features.values.keys().collect::<Vec<_>>(), ["ln_kurtosis", "ln_rms"]);

    for (samples, reason) in [
        (vec![0.0; 20_000], NotComputed::Constant),
        (vec![-9.81; 199_999], NotComputed::Constant),
        (vec![1.0], NotComputed::Constant),
        (vec![1.0, 2.0], NotComputed::TooShort),
        (noise.samples()[..150].to_vec(), NotComputed::TooShort),
    ] {
        for given in [false, true] {
            let record = record(samples.clone());
            let record = if given { at_speed(record, SHAFT_HZ) } else { record };
            let got = analyze(&record, MESH);
            assert_eq!(got.indicators.absent["omx"], reason, "{} samples", samples.len());
            assert_eq!(got.shaft_speed.is_some(), given);
        }
    }

    let got = analyze(&at_speed(gear(20_000, 0.05, 0.0), 100.0), MESH);
    assert_eq!(got.indicators.absent["mesh_5"], NotComputed::AboveNyquist);
    assert!(got.indicators.get("mesh_4").is_some());
    for shaft_speed_hz in [1e5, 1e6, 1e-300] {
        assert_eq!(analyze(&at_speed(gear(2000, 0.05, 0.0), shaft_speed_hz), MESH).mesh_lines, []);
    }
    for nominal_shaft_speed_hz in [0.0, -5.0, f64::NAN, f64::INFINITY] {
        for nominal_is_exact in [false, true] {
            let mesh = MeshContext { nominal_shaft_speed_hz, nominal_is_exact, ..MESH };
            assert_eq!(analyze(&noise, mesh).indicators.absent["omx"], NotComputed::NoSpeed);
        }
    }
}

#[test]
fn every_short_length_is_analysed() {
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let long = gear(1200, 0.05, 1.0);
    for length in 1..=1200 {
        let record = at_speed(record(long.samples()[..length].to_vec()), SHAFT_HZ);
        let got = analyzer.analyze(&record, &MESH);
        let numbers = got.indicators.values.values().chain(got.features.values.values());
        assert!(numbers.chain(got.features.background.values()).all(|x| x.is_finite()), "{length}");
        assert_eq!(got.indicators.values.len() + got.indicators.absent.len(), 16);
        let spectrum = analyzer.amplitude_spectrum(&record);
        assert_eq!(spectrum.amplitude.len(), length / 2 + 1);
        let band = analyzer.envelope_band(&record, got.shaft_speed.as_ref(), EnvelopeSearch::MeshHarmonic);
        let envelope = analyzer.envelope_spectrum(&record, band.band_hz);
        let too_short = length < 60 && matches!(envelope, Err(BandError::TooNarrow { .. }));
        assert!(envelope.is_ok() || too_short, "{length}: {envelope:?}");
    }
}

proptest! {
    #[test]
    fn any_finite_samples_give_finite_numbers(
        samples in prop::collection::vec(prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO, 1..600),
        shaft_speed_hz in prop::option::of(1e-3..1e4),
        teeth in 0_u32..300,
        tolerance in 0.0..1.5,
    ) {
        let point = OperatingPoint { shaft_speed_hz, ..OperatingPoint::default() };
        let record = record(samples).with_operating_point(point).unwrap();
        let got = analyze(&record, MeshContext { teeth, tolerance, ..MESH });
        prop_assert!(got.indicators.values.values().all(|x| x.is_finite()), "{:?}", got.indicators);
        prop_assert!(got.features.values.values().all(|x| x.is_finite()), "{:?}", got.features);
        let of_mesh = if teeth > 0 { 11 } else { 0 };
        prop_assert_eq!(got.indicators.values.len() + got.indicators.absent.len(), 5 + of_mesh);
    }
}

#[test]
fn the_default_band_is_around_the_strongest_harmonic() {
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let record = gear(20_000, 0.05, 0.0);
    let speed = analyzer.analyze(&record, &MESH).shaft_speed.unwrap();
    let mesh_hz = speed.mesh_frequency_hz;
    let mut band = |speed| analyzer.envelope_band(&record, speed, EnvelopeSearch::MeshHarmonic);
    assert_eq!(
        band(Some(&speed)),
        EnvelopeBand::given([0.5 * mesh_hz, 2.5 * mesh_hz], BandSource::StrongestMeshHarmonic)
    );
    assert_eq!(band(None), EnvelopeBand::given([0.0, 10_000.0], BandSource::Whole));
}
