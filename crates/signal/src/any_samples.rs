//! Whatever the samples are, every analysis answers with finite numbers or a reason, and never panics.

use jiff::Timestamp;
use proptest::prelude::*;

use super::{
    AnalysisSettings, Analyzer, Bearing, BearingOrders, BearingSettings, ConditionSettings, EnvelopeSearch,
    MeshContext, Quality, Record, RunMeans, Tachometer,
};

const RATE_HZ: f64 = 1000.0;

const MESH: MeshContext = MeshContext::new([12, 0], 10.0, 0.05);

fn record(samples: Vec<f32>) -> Record {
    Record::new("1", Timestamp::UNIX_EPOCH, RATE_HZ, "g", samples).unwrap()
}

/// Everything that can be asked of a record.
fn analyse_everything(record: &Record, mesh: MeshContext) {
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let orders = BearingOrders::of_geometry(9, 0.2, 0.0);
    let bearings = [Bearing { name: "de".into(), shaft_turns: 0.5, orders }];
    let settings = ConditionSettings {
        mesh,
        bands: &[],
        gear_indicators: true,
        bearings: BearingSettings { bearings: &bearings, ..BearingSettings::default() },
    };
    let condition = analyzer.condition(record, &settings);
    let indicators = &condition.analysis.indicators;
    assert!(indicators.values.values().all(|x| x.is_finite()), "{indicators:?}");
    assert!(condition.analysis.features.values.values().all(|x| x.is_finite()));
    assert!(indicators.values.keys().all(|name| !indicators.absent.contains_key(name)));
    let of_mesh = if mesh.teeth > 0 { 11 + 12 } else { 0 };
    assert_eq!(indicators.values.len() + indicators.absent.len(), 5 + of_mesh + 8);
    let run = RunMeans::default().update(indicators);
    assert!(run.values.values().all(|x| x.is_finite()));
    assert_eq!(run.values.len() + run.absent.len(), if mesh.teeth > 0 { 2 } else { 0 });
    let finite = |values: &[f64]| assert!(values.iter().all(|x| x.is_finite()));
    finite(&analyzer.amplitude_spectrum(record).amplitude);
    finite(&analyzer.power_spectral_density(record).amplitude);
    if let Ok(cepstrum) = analyzer.cepstrum(record) {
        finite(&cepstrum.value);
    }
    if let Ok(kurtogram) = analyzer.kurtogram(record) {
        kurtogram.levels.iter().for_each(|level| finite(&level.kurtosis));
        // The band that was found can be used.
        finite(&analyzer.envelope_spectrum(record, kurtogram.best.band_hz).unwrap().amplitude);
    }
    for search in [EnvelopeSearch::MeshHarmonic, EnvelopeSearch::Kurtogram] {
        let band = analyzer.envelope_band(record, condition.analysis.shaft_speed.as_ref(), search);
        if let Ok(envelope) = analyzer.envelope_spectrum(record, band.band_hz) {
            finite(&envelope.amplitude);
        }
    }
}

fn any_sample() -> impl Strategy<Value = f32> {
    prop::num::f32::NORMAL | prop::num::f32::SUBNORMAL | prop::num::f32::ZERO
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_samples_are_analysed(
        samples in prop::collection::vec(any_sample(), 1..900),
        teeth in 0_u32..60,
        shaft_speed_hz in 0.5_f64..60.0,
        nominal_is_exact: bool,
        clipped: bool,
    ) {
        let mesh = MeshContext { teeth, nominal_shaft_speed_hz: shaft_speed_hz, nominal_is_exact, ..MESH };
        analyse_everything(&record(samples).with_quality(Quality { clipped, gap: false }), mesh);
    }

    /// Lengths, offsets, trends, levels of a converter, its limit, and stretches of one value, in all
    /// mixtures.
    #[test]
    fn any_disturbance_of_a_mesh_is_analysed(
        length in 1_usize..3000,
        offset in -1e6_f32..1e6,
        trend in -10.0_f32..10.0,
        step in prop::option::of(1e-3_f32..3.0),
        limit in prop::option::of(0.0_f32..1.5),
        hole in prop::option::of((0_usize..3000, 1_usize..300)),
        pulses in prop::option::of((prop::collection::vec(-1.0_f64..4.0, 0..40), 0_u32..4)),
    ) {
        let mut samples: Vec<f32> = (0..length)
            .map(|i| {
                let turn = std::f64::consts::TAU * 10.1 * i as f64 / RATE_HZ;
                let mesh = ((1.0 + 0.3 * turn.cos()) * (12.0 * turn).sin()) as f32;
                let mesh = limit.map_or(mesh, |limit| mesh.clamp(-limit, limit));
                step.map_or(mesh, |step| (mesh / step).round() * step) + offset + trend * i as f32
            })
            .collect();
        if let Some((first, count)) = hole {
            let first = first.min(length - 1);
            samples[first..(first + count).min(length)].fill(0.0);
        }
        let tachometer = pulses.map(|(mut pulse_times_s, pulses_per_revolution)| {
            pulse_times_s.sort_by(f64::total_cmp);
            Tachometer { pulse_times_s, pulses_per_revolution }
        });
        analyse_everything(&record(samples).with_tachometer(tachometer), MESH);
    }
}

#[test]
fn lengths_of_every_kind_are_analysed() {
    for length in
        [1_usize, 2, 3, 4, 5, 31, 32, 33, 63, 64, 65, 127, 128, 129, 509, 16_381, 16_411, 65_537, 199_999]
    {
        let samples =
            (0..length as u64).map(|i| ((i * i) % 23) as f32 * 0.1 + (i as f32 * 0.75).sin()).collect();
        analyse_everything(&record(samples), MESH);
    }
    for constant in [0.0, -9.81, f32::MAX, f32::MIN_POSITIVE] {
        for length in [1, 2, 1000, 16_411] {
            analyse_everything(&record(vec![constant; length]), MESH);
        }
    }
}

/// Ten million samples, cut to the longest smooth length below, read as a short record does.
#[test]
fn ten_million_samples_give_the_same_readings() {
    let sine = |length: usize| -> Record {
        let samples = (0..length).map(|i| 0.5 + 2.0 * (std::f64::consts::TAU * 0.1234 * i as f64).sin());
        record(samples.map(|x| x as f32).collect())
    };
    let mut analyzer = Analyzer::new(AnalysisSettings::default());
    let mesh = MeshContext::new([12, 0], 123.4 / 12.0, 0.01);
    for length in [20_000, 199_999, 9_999_991] {
        let got = analyzer.analyze(&sine(length), &mesh);
        let value = |name| got.indicators.get(name).unwrap();
        assert!((value("omx") / 2.0 - 1.0).abs() < 1e-3, "{length}: {}", value("omx"));
        assert!((value("kurtosis") - 1.5).abs() < 1e-3);
        assert!((got.shaft_speed.unwrap().mesh_frequency_hz - 123.4).abs() < 1e-3);
    }
}
