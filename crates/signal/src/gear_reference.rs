//! Comparison with NumPy and SciPy on `fixtures/reference/signal/gear_vectors.json`, written by the script
//! beside it.

use std::collections::BTreeMap;

use jiff::Timestamp;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Deserialize;

use super::{
    AnalysisSettings, Analyzer, Band, BandQuantity, ByName, MeshContext, Precision, Record, RunMean,
    RunMeans, Tachometer,
};

#[derive(Deserialize)]
struct Vectors {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    sample_rate_hz: f64,
    teeth: u32,
    samples: Vec<f32>,
    pulse_times_s: Vec<f64>,
    pulses_per_revolution: u32,
    samples_per_turn: usize,
    turns: usize,
    order_amplitude: Vec<f64>,
    indicators: ByName<f64>,
    signals: BTreeMap<String, Vec<f64>>,
    psd: Vec<f64>,
    cepstrum: Vec<f64>,
    band_hz: [f64; 2],
    band_rms: f64,
    band_velocity_mm_per_s: f64,
}

impl Case {
    fn record(&self) -> Record {
        let samples = self.samples.clone();
        let record = Record::new("1", Timestamp::UNIX_EPOCH, self.sample_rate_hz, "m/s2", samples).unwrap();
        record.with_tachometer(Some(Tachometer {
            pulse_times_s: self.pulse_times_s.clone(),
            pulses_per_revolution: self.pulses_per_revolution,
        }))
    }

    fn mesh(&self) -> MeshContext {
        MeshContext::new([self.teeth, 0], 10.0, 0.05)
    }
}

fn cases() -> Vec<Case> {
    let vectors: Vectors =
        serde_json::from_str(include_str!("../../../fixtures/reference/signal/gear_vectors.json")).unwrap();
    vectors.cases
}

fn analyzer() -> Analyzer {
    Analyzer::new(AnalysisSettings::default())
}

/// Each value relative to itself, or to 10⁻³ of the largest where it is less: cancellation leaves no more
/// digits there.
fn assert_close(name: &str, got: &[f64], want: &[f64]) {
    assert_eq!(got.len(), want.len(), "{name}");
    let largest = want.iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
    for (k, (got, want)) in got.iter().zip(want).enumerate() {
        let scale = want.abs().max(1e-3 * largest);
        assert!((got - want).abs() <= 1e-9 * scale, "{name}, {k}: {got}, SciPy has {want}");
    }
}

/// Largest difference of a value over the shaft's angle, relative to the largest of the average: records are
/// resampled in single precision, whose rounding is 6·10⁻⁸ of the largest sample.
const RESAMPLED: f64 = 5e-7;

/// Largest difference of an indicator over the shaft's angle, relative to itself. The difference signal is a
/// small part of the average, and `m8a` is of its eighth power.
const RESAMPLED_INDICATOR: f64 = 5e-6;

/// Largest difference of a band's value relative to itself: it comes from a transform in single precision.
const BAND: f64 = 5e-7;

/// Asserts that values over the shaft's angle are close; `largest` is the largest of the average.
fn assert_close_over_angle(name: &str, got: &[f64], want: &[f64], largest: f64) {
    assert_eq!(got.len(), want.len(), "{name}");
    for (k, (got, want)) in got.iter().zip(want).enumerate() {
        assert!((got - want).abs() <= RESAMPLED * largest, "{name}, {k}: {got}, SciPy has {want}");
    }
}

/// Asserts that an indicator over the shaft's angle is close.
fn assert_indicator_close(name: &str, got: f64, want: f64) {
    let apart = (got / want - 1.0).abs();
    assert!(apart <= RESAMPLED_INDICATOR, "{name}: {got}, SciPy has {want}: {apart}");
}

#[test]
fn gear_indicators_and_signals_equal_scipy() {
    for case in cases() {
        let (record, mesh) = (case.record(), case.mesh());
        let turned = analyzer().angle_record(&record, &mesh).unwrap();
        assert_eq!(
            (turned.samples_per_turn, turned.turns),
            (case.samples_per_turn, case.turns),
            "{}",
            case.name
        );
        let spectrum = analyzer().order_spectrum(&record, &mesh).unwrap();
        let largest = case.signals["average"].iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
        assert_close_over_angle(&case.name, &spectrum.amplitude, &case.order_amplitude, largest);
        let signals = analyzer().gear_signals(&record, &mesh).unwrap();
        for (part, got) in [
            ("average", &signals.average),
            ("regular", &signals.regular),
            ("residual", &signals.residual),
            ("difference", &signals.difference),
            ("mesh_envelope", &signals.mesh_envelope),
        ] {
            assert_close_over_angle(&format!("{}, {part}", case.name), got, &case.signals[part], largest);
        }
        let got = analyzer().gear_indicators(&record, &mesh).0;
        assert_eq!(got.values.keys().collect::<Vec<_>>(), case.indicators.keys().collect::<Vec<_>>());
        for (name, want) in &case.indicators {
            assert_indicator_close(&format!("{}, {name}", case.name), got.values[name], *want);
        }
    }
}

#[test]
fn spectra_and_bands_equal_scipy() {
    for case in cases() {
        let record = case.record();
        let density = analyzer().power_spectral_density(&record);
        assert_eq!((density.quantity, density.unit.as_str()), ("psd", "(m/s2)^2/Hz"));
        assert_close(&case.name, &density.amplitude, &case.psd);
        assert_close(&case.name, &analyzer().cepstrum(&record).unwrap().value, &case.cepstrum);
        let band = |name: &str, quantity| Band { name: name.to_owned(), band_hz: case.band_hz, quantity };
        let bands = [band("a", BandQuantity::Record), band("v", BandQuantity::Velocity)];
        let settings = AnalysisSettings { precision: Precision::Double, ..AnalysisSettings::default() };
        let [double, got] = [Analyzer::new(settings), analyzer()]
            .map(|mut analyzer| analyzer.analyze_with_bands(&record, &case.mesh(), &bands).indicators);
        assert_close(&case.name, &[double.values["band_a"]], &[case.band_rms]);
        assert_close(&case.name, &[double.values["band_v"]], &[case.band_velocity_mm_per_s]);
        for (name, want) in [("band_a", case.band_rms), ("band_v", case.band_velocity_mm_per_s)] {
            let apart = (got.values[name] / want - 1.0).abs();
            assert!(apart <= BAND, "{}, {name}: {apart}", case.name);
        }
    }
}

/// NA4 by its definition from the samples of each residual, the state sent through JSON between records.
#[test]
fn na4_and_nb4_follow_their_definition_after_a_restart() {
    let mut state = RunMeans::default();
    let mut sums = Vec::new();
    for case in cases() {
        let (got, _) = analyzer().gear_indicators(&case.record(), &case.mesh());
        let run = state.update(&got);
        let samples = case.samples_per_turn as f64;
        let sum = |part: &str, power: i32| case.signals[part].iter().map(|x| x.powi(power)).sum::<f64>();
        sums.push([sum("residual", 2) / samples, sum("mesh_envelope", 2) / samples]);
        for (part, index, na4) in
            [("residual", 0, run.values["na4"]), ("mesh_envelope", 1, run.values["nb4"])]
        {
            let mean = sums.iter().map(|sum| sum[index]).sum::<f64>() / sums.len() as f64;
            assert_indicator_close(part, na4, sum(part, 4) / samples / (mean * mean));
        }
        state = serde_json::from_str(&serde_json::to_string(&state).unwrap()).unwrap();
    }
    let mut state = RunMean::default();
    assert_eq!((state.update(2.0, 12.0), state.records()), (Ok(3.0), 1));
    assert!(state.update(f64::NAN, 1.0).is_err() && state.records() == 1);
}

/// Gaussian noise: 3, 15 and 105, within three standard errors √(96/n), √(9720/n) and √(1 929 312/n), n the
/// samples of all averages.
#[test]
fn gaussian_noise_has_its_normal_moments() {
    let mesh = MeshContext::at_exact_speed([20, 0], 5.0);
    let pulses: Vec<f64> = (0..12).map(|pulse| f64::from(pulse) / 5.0).collect();
    let tachometer = Tachometer { pulse_times_s: pulses, pulses_per_revolution: 1 };
    let (mut sums, records) = ([0.0; 3], 40);
    let mut per_turn = 0;
    for seed in 0..records {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let samples = (0..44_000).map(|_| StandardNormal.sample(&mut random)).collect();
        let record = Record::new("1", Timestamp::UNIX_EPOCH, 20_000.0, "g", samples).unwrap();
        let record = record.with_tachometer(Some(tachometer.clone()));
        per_turn = analyzer().angle_record(&record, &mesh).unwrap().samples_per_turn;
        let got = analyzer().gear_indicators(&record, &mesh).0;
        for (sum, name) in sums.iter_mut().zip(["fm4", "m6a", "m8a"]) {
            *sum += got.values[name] / records as f64;
        }
    }
    let n = (records as usize * per_turn) as f64;
    for (mean, (want, variance)) in sums.into_iter().zip([(3.0, 96.0), (15.0, 9720.0), (105.0, 1_929_312.0)])
    {
        let standard_error = f64::sqrt(variance / n);
        assert!((mean - want).abs() < 3.0 * standard_error, "{mean} {want} ± {standard_error}");
    }
}
