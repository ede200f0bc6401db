//! Indicators, spectra, kurtogram and cepstrum of one record.

use flankwatch_signal::{Band, BandSource, BearingSettings, ConditionSettings, EnvelopeBand, EnvelopeSearch};
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::{from_python, to_python};
use crate::error::{argument_error, not_computed_error, value_error};
use crate::record::{Machine, analyze, plain_record};

/// A one-sided spectrum.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct Spectrum {
    quantity: &'static str,
    unit: String,
    window: &'static str,
    bandwidth_hz: f64,
    resolution_hz: f64,
    frequency_hz: Py<PyArray1<f64>>,
    amplitude: Py<PyArray1<f64>>,
}

/// The spectrum of a band's envelope.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct EnvelopeSpectrum {
    unit: String,
    band_hz: [f64; 2],
    band_source: String,
    spectral_kurtosis: Option<f64>,
    bandwidth_hz: f64,
    resolution_hz: f64,
    frequency_hz: Py<PyArray1<f64>>,
    amplitude: Py<PyArray1<f64>>,
}

/// Spectral kurtosis over bands of several widths.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct Kurtogram {
    bandwidth_hz: Vec<f64>,
    kurtosis: Vec<Py<PyArray1<f64>>>,
    best_band_hz: [f64; 2],
    best_kurtosis: f64,
}

/// The real cepstrum.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct Cepstrum {
    resolution_s: f64,
    quefrency_s: Py<PyArray1<f64>>,
    value: Py<PyArray1<f64>>,
}

fn array(py: Python<'_>, values: Vec<f64>) -> Py<PyArray1<f64>> {
    values.into_pyarray(py).unbind()
}

/// Returns `count` multiples of `step`, starting at 0.
fn axis(py: Python<'_>, count: usize, step: f64) -> Py<PyArray1<f64>> {
    array(py, (0..count).map(|k| k as f64 * step).collect())
}

fn spectrum(py: Python<'_>, spectrum: flankwatch_signal::Spectrum) -> Spectrum {
    Spectrum {
        quantity: spectrum.quantity,
        unit: spectrum.unit,
        window: spectrum.window,
        bandwidth_hz: spectrum.bandwidth_hz,
        resolution_hz: spectrum.resolution_hz,
        frequency_hz: axis(py, spectrum.amplitude.len(), spectrum.resolution_hz),
        amplitude: array(py, spectrum.amplitude),
    }
}

/// Returns the indicators and how they were computed, as a dict.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, teeth=None, shaft_speed_hz=None, nominal_shaft_speed_hz=None, tolerance=0.05, torque_nm=None,
    pulse_times_s=None, pulses_per_revolution=1, unit="1", bands=None, gear_indicators=true))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub(crate) fn condition<'py>(
    x: &Bound<'py, PyAny>,
    rate_hz: f64,
    teeth: Option<u32>,
    shaft_speed_hz: Option<f64>,
    nominal_shaft_speed_hz: Option<f64>,
    tolerance: f64,
    torque_nm: Option<f64>,
    pulse_times_s: Option<&Bound<'py, PyAny>>,
    pulses_per_revolution: u32,
    unit: &str,
    bands: Option<&Bound<'py, PyAny>>,
    gear_indicators: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let py = x.py();
    let machine = Machine {
        teeth,
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        torque_nm,
        pulse_times_s,
        pulses_per_revolution,
    };
    let (mesh, record) = (machine.mesh()?, machine.record(x, rate_hz, unit)?);
    let bands: Vec<Band> = bands.map_or_else(|| Ok(Vec::new()), |bands| from_python("bands", bands))?;
    if let Some(band) = bands.iter().find(|band| !band.is_valid()) {
        let expected =
            "a name of 1 to 32 characters of a-z, 0-9 and _, and two ascending frequencies in hertz";
        return Err(argument_error("bands", format!("{:?} {:?}", band.name, band.band_hz), expected));
    }
    let settings = ConditionSettings {
        mesh,
        bands: &bands,
        gear_indicators: gear_indicators && teeth.is_some(),
        bearings: BearingSettings::default(),
    };
    let condition = analyze(py, |analyzer| analyzer.condition(&record, &settings));
    let analysis = condition.analysis;
    let result = PyDict::new(py);
    result.set_item("indicators", to_python(py, &analysis.indicators.values)?)?;
    result.set_item("absent", to_python(py, &analysis.indicators.absent)?)?;
    result.set_item("shaft_speed", to_python(py, &analysis.shaft_speed)?)?;
    let lines: Vec<(u32, f64, f64)> =
        analysis.mesh_lines.iter().map(|line| (line.order, line.frequency_hz, line.amplitude)).collect();
    result.set_item("mesh_lines", lines)?;
    result.set_item("basis", to_python(py, &condition.basis)?)?;
    Ok(result)
}

/// The Hann amplitude spectrum.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, unit="1"))]
pub(crate) fn amplitude_spectrum(x: &Bound<'_, PyAny>, rate_hz: f64, unit: &str) -> PyResult<Spectrum> {
    let record = plain_record(x, rate_hz, unit)?;
    let computed = analyze(x.py(), |analyzer| analyzer.amplitude_spectrum(&record));
    Ok(spectrum(x.py(), computed))
}

/// The power spectral density under a Hann window.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, unit="1"))]
pub(crate) fn power_spectral_density(x: &Bound<'_, PyAny>, rate_hz: f64, unit: &str) -> PyResult<Spectrum> {
    let record = plain_record(x, rate_hz, unit)?;
    let computed = analyze(x.py(), |analyzer| analyzer.power_spectral_density(&record));
    Ok(spectrum(x.py(), computed))
}

/// The envelope spectrum of a band.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, band_hz=None, search="mesh_harmonic", teeth=None, shaft_speed_hz=None, nominal_shaft_speed_hz=None,
    tolerance=0.05, unit="1"))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub(crate) fn envelope_spectrum(
    x: &Bound<'_, PyAny>,
    rate_hz: f64,
    band_hz: Option<[f64; 2]>,
    search: &str,
    teeth: Option<u32>,
    shaft_speed_hz: Option<f64>,
    nominal_shaft_speed_hz: Option<f64>,
    tolerance: f64,
    unit: &str,
) -> PyResult<EnvelopeSpectrum> {
    let py = x.py();
    let search = match search {
        "mesh_harmonic" => EnvelopeSearch::MeshHarmonic,
        "kurtogram" => EnvelopeSearch::Kurtogram,
        _ => {
            return Err(argument_error(
                "search",
                format!("{search:?}"),
                "\"mesh_harmonic\" or \"kurtogram\"",
            ));
        }
    };
    let machine = Machine {
        teeth,
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        torque_nm: None,
        pulse_times_s: None,
        pulses_per_revolution: 1,
    };
    let (mesh, record) = (machine.mesh()?, machine.record(x, rate_hz, unit)?);
    let (band, computed) = analyze(py, |analyzer| {
        let band = match band_hz {
            Some(band_hz) => EnvelopeBand::given(band_hz, BandSource::Query),
            None => {
                let speed = analyzer.analyze(&record, &mesh).shaft_speed;
                analyzer.envelope_band(&record, speed.as_ref(), search)
            }
        };
        (band, analyzer.envelope_spectrum(&record, band.band_hz))
    });
    let computed = computed.map_err(value_error)?;
    let source = to_python(py, &band.source)?;
    Ok(EnvelopeSpectrum {
        unit: computed.unit,
        band_hz: band.band_hz,
        band_source: source.extract()?,
        spectral_kurtosis: band.spectral_kurtosis,
        bandwidth_hz: computed.bandwidth_hz,
        resolution_hz: computed.resolution_hz,
        frequency_hz: axis(py, computed.amplitude.len(), computed.resolution_hz),
        amplitude: array(py, computed.amplitude),
    })
}

/// The fast kurtogram.
#[pyfunction]
pub(crate) fn kurtogram(x: &Bound<'_, PyAny>, rate_hz: f64) -> PyResult<Kurtogram> {
    let py = x.py();
    let record = plain_record(x, rate_hz, "1")?;
    let computed = analyze(py, |analyzer| analyzer.kurtogram(&record))
        .map_err(|reason| not_computed_error("kurtogram", reason))?;
    Ok(Kurtogram {
        bandwidth_hz: computed.levels.iter().map(|level| level.bandwidth_hz).collect(),
        kurtosis: computed.levels.into_iter().map(|level| array(py, level.kurtosis)).collect(),
        best_band_hz: computed.best.band_hz,
        best_kurtosis: computed.best.kurtosis,
    })
}

/// The real cepstrum.
#[pyfunction]
pub(crate) fn cepstrum(x: &Bound<'_, PyAny>, rate_hz: f64) -> PyResult<Cepstrum> {
    let py = x.py();
    let record = plain_record(x, rate_hz, "1")?;
    let computed = analyze(py, |analyzer| analyzer.cepstrum(&record))
        .map_err(|reason| not_computed_error("cepstrum", reason))?;
    Ok(Cepstrum {
        resolution_s: computed.resolution_s,
        quefrency_s: axis(py, computed.value.len(), computed.resolution_s),
        value: array(py, computed.value),
    })
}
