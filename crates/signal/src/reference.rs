//! Comparison with NumPy and SciPy on `fixtures/reference/signal/vectors.json`, written by the script beside
//! it.

use jiff::Timestamp;
use serde::Deserialize;

use super::{AnalysisSettings, Analyzer, MeshContext, OperatingPoint, Precision, Record};

#[derive(Deserialize)]
struct Vectors {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    samples: Vec<f32>,
    rms: f64,
    peak: f64,
    kurtosis: Option<f64>,
    amplitude: Vec<f64>,
    mesh_bins: Option<f64>,
    mesh_lines: Vec<f64>,
    envelopes: Vec<EnvelopeCase>,
}

#[derive(Deserialize)]
struct EnvelopeCase {
    first_bin: usize,
    last_bin: usize,
    amplitude: Vec<f64>,
    full_rate_amplitude: Vec<f64>,
}

fn cases() -> Vec<Case> {
    let vectors: Vectors =
        serde_json::from_str(include_str!("../../../fixtures/reference/signal/vectors.json")).unwrap();
    vectors.cases
}

/// A record sampled so that bins are 1 Hz apart.
fn record(case: &Case) -> Record {
    Record::new("1", Timestamp::UNIX_EPOCH, case.samples.len() as f64, "g", case.samples.clone()).unwrap()
}

fn analyzer() -> Analyzer {
    Analyzer::new(AnalysisSettings::default())
}

/// Largest difference of a line relative to itself: indicators come from a transform in single precision.
const SINGLE_PRECISION: f64 = 5e-7;

fn assert_close(name: &str, got: f64, want: f64, scale: f64) {
    assert!((got - want).abs() <= 1e-9 * scale, "{name}: {got}, SciPy has {want}");
}

/// Each bin relative to itself, or to 10⁻³ of the highest one where it is less: cancellation leaves no more
/// digits there.
fn assert_spectra_close(name: &str, got: &[f64], want: &[f64]) {
    assert_eq!(got.len(), want.len(), "{name}");
    let highest = want.iter().copied().fold(0.0, f64::max);
    for (k, (got, want)) in got.iter().zip(want).enumerate() {
        assert_close(&format!("{name}, bin {k}"), *got, *want, want.max(1e-3 * highest).max(1e-6));
    }
}

#[test]
fn indicators_and_lines_equal_scipy() {
    for case in cases() {
        let mesh = MeshContext::new([12, 0], 1.0, 0.05);
        let point = OperatingPoint {
            shaft_speed_hz: case.mesh_bins.map(|bins| bins / 12.0),
            ..OperatingPoint::default()
        };
        let record = record(&case).with_operating_point(point).unwrap();
        let settings = AnalysisSettings { precision: Precision::Double, ..AnalysisSettings::default() };
        let got = Analyzer::new(settings).analyze(&record, &mesh).indicators;
        let single = analyzer().analyze(&record, &mesh).indicators;
        assert_close(&case.name, got.values["rms"], case.rms, case.rms);
        assert_close(&case.name, got.values["peak"], case.peak, case.peak);
        assert_eq!(got.get("kurtosis").is_some(), case.kurtosis.is_some(), "{}", case.name);
        if let Some(kurtosis) = case.kurtosis {
            assert_close(&case.name, got.values["kurtosis"], kurtosis, kurtosis);
        }
        for (index, want) in case.mesh_lines.iter().enumerate() {
            let name = format!("mesh_{}", index + 1);
            assert_close(&case.name, got.values[&name], *want, *want);
            let got = single.values[&name];
            assert!((got / want - 1.0).abs() <= SINGLE_PRECISION, "{}: {got}, SciPy has {want}", case.name);
        }
    }
}

#[test]
fn spectra_equal_scipy() {
    for case in cases() {
        assert_spectra_close(
            &case.name,
            &analyzer().amplitude_spectrum(&record(&case)).amplitude,
            &case.amplitude,
        );
    }
}

#[test]
fn envelope_spectra_equal_scipy() {
    let mut analyzer = analyzer();
    for case in cases() {
        for envelope in &case.envelopes {
            let band_hz = [envelope.first_bin as f64 - 0.5, envelope.last_bin as f64 + 0.5];
            let spectrum = analyzer.envelope_spectrum(&record(&case), band_hz).unwrap();
            assert_spectra_close(&case.name, &spectrum.amplitude, &envelope.amplitude);
        }
    }
}

/// What the short transform folds back: against SciPy's envelope at the full rate no bin differs by more than
/// 0.7 % of the highest line (0.66 % measured, in white noise, whose envelope has the sharpest corners).
#[test]
fn short_envelopes_equal_those_at_the_full_rate() {
    let mut analyzer = analyzer();
    for case in cases() {
        for envelope in &case.envelopes {
            let band_hz = [envelope.first_bin as f64 - 0.5, envelope.last_bin as f64 + 0.5];
            let spectrum = analyzer.envelope_spectrum(&record(&case), band_hz).unwrap();
            let highest = envelope.full_rate_amplitude.iter().copied().fold(0.0, f64::max);
            for (got, want) in spectrum.amplitude.iter().zip(&envelope.full_rate_amplitude) {
                assert!((got - want).abs() < 0.007 * highest, "{}: {got}, SciPy has {want}", case.name);
            }
        }
    }
}
