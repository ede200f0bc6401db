//! Indicators, spectra, kurtogram and cepstrum of one record.

use flankwatch_signal::{Band, BandSource, BearingSettings, ConditionSettings, EnvelopeBand, EnvelopeSearch};
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::{Samples, from_python, to_python};
use crate::error::{argument_error, not_computed_error, value_error};
use crate::record::{Machine, analyze, plain_record};

/// The one-sided spectrum of a record with its mean removed, under a Hann window.
///
/// The arrays have shape ``(n // 2 + 1,)`` for the n samples used.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct Spectrum {
    /// ``"amplitude_peak"`` or ``"psd"``.
    quantity: &'static str,
    /// Unit of ``amplitude``.
    unit: String,
    /// Name of the window.
    window: &'static str,
    /// Equivalent noise bandwidth of a bin in Hz.
    bandwidth_hz: f64,
    /// Distance of two bins in Hz.
    resolution_hz: f64,
    /// Frequencies of the bins in Hz, shape ``(n // 2 + 1,)``.
    frequency_hz: Py<PyArray1<f64>>,
    /// Values of the bins in ``unit``, shape ``(n // 2 + 1,)``.
    amplitude: Py<PyArray1<f64>>,
}

/// The amplitude spectrum of a band's envelope, and how the band was chosen.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct EnvelopeSpectrum {
    /// Unit of ``amplitude``: that of the samples.
    unit: String,
    /// Lower and upper edge of the band in Hz.
    band_hz: [f64; 2],
    /// How the band was chosen: ``"query"``, ``"strongest_mesh_harmonic"``, ``"kurtogram"``, …
    band_source: String,
    /// Spectral kurtosis of the band, 0 in noise; ``None`` unless the kurtogram chose the band.
    spectral_kurtosis: Option<f64>,
    /// Equivalent noise bandwidth of a bin in Hz.
    bandwidth_hz: f64,
    /// Distance of two bins in Hz.
    resolution_hz: f64,
    /// Frequencies of the bins in Hz, shape ``(bins,)``.
    frequency_hz: Py<PyArray1<f64>>,
    /// Peak amplitudes in ``unit``, shape ``(bins,)``.
    amplitude: Py<PyArray1<f64>>,
}

/// Spectral kurtosis at several divisions of the spectrum.
///
/// ``bandwidth_hz[i]`` and ``kurtosis[i]`` belong to division i.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct Kurtogram {
    /// Width of a division's bands in Hz.
    bandwidth_hz: Vec<f64>,
    /// Spectral kurtosis of each division's bands in ascending frequency, each of shape ``(bands,)``.
    kurtosis: Vec<Py<PyArray1<f64>>>,
    /// Edges of the band of the highest spectral kurtosis in Hz.
    best_band_hz: [f64; 2],
    /// The highest spectral kurtosis, 0 in noise.
    best_kurtosis: f64,
}

/// The real cepstrum over quefrency, up to half the record's length.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct Cepstrum {
    /// Distance of two values in seconds.
    resolution_s: f64,
    /// Quefrencies in seconds, shape ``(n // 2 + 1,)``.
    quefrency_s: Py<PyArray1<f64>>,
    /// Cepstrum without a unit, shape ``(n // 2 + 1,)``.
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

/// Returns indicators and how they were computed, as a dict; :func:`flankwatch.indicators` describes it.
///
/// ``x`` has shape ``(n,)`` and is in ``unit``; ``pulse_times_s`` has shape ``(pulses,)`` and is in seconds.
///
/// Raises:
///     ValueError: if samples are not finite or not of shape ``(n,)``, or an argument is out of range.
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
    let samples = Samples::new(x)?;
    let (mesh, record) = (machine.mesh()?, machine.record(&samples, rate_hz, unit)?);
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

/// Computes the Hann amplitude (peak) spectrum.
///
/// Args:
///     x: samples, shape ``(n,)``, in ``unit``.
///     rate_hz: sampling rate in hertz.
///     unit: unit of the samples.
///
/// Raises:
///     ValueError: if samples are not finite or not of shape ``(n,)``, or an argument is out of range.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, unit="1"))]
pub(crate) fn amplitude_spectrum(x: &Bound<'_, PyAny>, rate_hz: f64, unit: &str) -> PyResult<Spectrum> {
    let samples = Samples::new(x)?;
    let record = plain_record(&samples, rate_hz, unit)?;
    let computed = analyze(x.py(), |analyzer| analyzer.amplitude_spectrum(&record));
    Ok(spectrum(x.py(), computed))
}

/// Computes the power spectral density, as SciPy's ``periodogram`` with a Hann window.
///
/// Args:
///     x: samples, shape ``(n,)``, in ``unit``.
///     rate_hz: sampling rate in hertz.
///     unit: unit of the samples.
///
/// Raises:
///     ValueError: if samples are not finite or not of shape ``(n,)``, or an argument is out of range.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, unit="1"))]
pub(crate) fn power_spectral_density(x: &Bound<'_, PyAny>, rate_hz: f64, unit: &str) -> PyResult<Spectrum> {
    let samples = Samples::new(x)?;
    let record = plain_record(&samples, rate_hz, unit)?;
    let computed = analyze(x.py(), |analyzer| analyzer.power_spectral_density(&record));
    Ok(spectrum(x.py(), computed))
}

/// Computes the envelope spectrum of a band.
///
/// Args:
///     x: samples, shape ``(n,)``, in ``unit``.
///     rate_hz: sampling rate in hertz.
///     band_hz: edges of the band in hertz; by default the band that ``search`` finds.
///     search: ``"mesh_harmonic"`` for the band around the strongest mesh harmonic, ``"kurtogram"`` for the
///         band
///         of the highest spectral kurtosis.
///     teeth: teeth of the gear on the shaft; without it there is no mesh harmonic.
///     shaft_speed_hz: rotational frequency of that shaft in hertz, if it is known.
///     nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not known.
///     tolerance: search range around nominal, as a fraction.
///     unit: unit of the samples.
///
/// Raises:
///     ValueError: if the band is outside the spectrum, samples are not finite or not of shape ``(n,)``, or
///         an
///         argument is out of range.
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
    let samples = Samples::new(x)?;
    let (mesh, record) = (machine.mesh()?, machine.record(&samples, rate_hz, unit)?);
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

/// Computes the fast kurtogram.
///
/// Args:
///     x: samples, shape ``(n,)``.
///     rate_hz: sampling rate in hertz.
///
/// Raises:
///     ValueError: if the record is too short or constant, or samples are not finite or not of shape
///         ``(n,)``.
#[pyfunction]
pub(crate) fn kurtogram(x: &Bound<'_, PyAny>, rate_hz: f64) -> PyResult<Kurtogram> {
    let py = x.py();
    let samples = Samples::new(x)?;
    let record = plain_record(&samples, rate_hz, "1")?;
    let computed = analyze(py, |analyzer| analyzer.kurtogram(&record))
        .map_err(|reason| not_computed_error("kurtogram", reason))?;
    Ok(Kurtogram {
        bandwidth_hz: computed.levels.iter().map(|level| level.bandwidth_hz).collect(),
        kurtosis: computed.levels.into_iter().map(|level| array(py, level.kurtosis)).collect(),
        best_band_hz: computed.best.band_hz,
        best_kurtosis: computed.best.kurtosis,
    })
}

/// Computes the real cepstrum.
///
/// Args:
///     x: samples, shape ``(n,)``.
///     rate_hz: sampling rate in hertz.
///
/// Raises:
///     ValueError: if the record is too short or constant, or samples are not finite or not of shape
///         ``(n,)``.
#[pyfunction]
pub(crate) fn cepstrum(x: &Bound<'_, PyAny>, rate_hz: f64) -> PyResult<Cepstrum> {
    let py = x.py();
    let samples = Samples::new(x)?;
    let record = plain_record(&samples, rate_hz, "1")?;
    let computed = analyze(py, |analyzer| analyzer.cepstrum(&record))
        .map_err(|reason| not_computed_error("cepstrum", reason))?;
    Ok(Cepstrum {
        resolution_s: computed.resolution_s,
        quefrency_s: axis(py, computed.value.len(), computed.resolution_s),
        value: array(py, computed.value),
    })
}
