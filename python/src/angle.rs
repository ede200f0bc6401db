//! Records over the shaft angle.

use flankwatch_signal::{AngleSource, MeshContext, RecordOf};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

use crate::arguments::{Samples, to_python};
use crate::error::not_computed_error;
use crate::record::{Machine, analyze};

/// A record resampled over whole turns of the shaft, at equal steps of its angle.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct AngleRecord {
    /// Unit of the samples.
    unit: String,
    /// Samples in ``unit``, shape ``(turns, samples_per_turn)``.
    samples: Py<PyArray2<f64>>,
    /// Mean over all turns in ``unit``, shape ``(samples_per_turn,)``.
    synchronous_average: Py<PyArray1<f64>>,
    /// A dict of the source of the shaft's angle and its accuracy.
    angle: Py<PyAny>,
}

/// The Hann amplitude spectrum over orders of the shaft.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct OrderSpectrum {
    /// Unit of ``amplitude``: that of the samples.
    unit: String,
    /// Distance of two bins in orders.
    resolution_orders: f64,
    /// Equivalent noise bandwidth of a bin in orders.
    bandwidth_orders: f64,
    /// Orders of the bins, shape ``(bins,)``; 1 is once a turn.
    order: Py<PyArray1<f64>>,
    /// Peak amplitudes in ``unit``, shape ``(bins,)``.
    amplitude: Py<PyArray1<f64>>,
    /// A dict of the source of the shaft's angle and its accuracy.
    angle: Py<PyAny>,
}

/// The synchronous average and its parts, each of shape ``(samples_per_turn,)`` in the samples' unit.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct GearSignals {
    /// The synchronous average without its mean, shape ``(samples_per_turn,)``.
    average: Py<PyArray1<f64>>,
    /// Its orders 1 and 2 and its mesh harmonics, shape ``(samples_per_turn,)``.
    regular: Py<PyArray1<f64>>,
    /// The average without the regular signal, shape ``(samples_per_turn,)``.
    residual: Py<PyArray1<f64>>,
    /// The residual without the first sidebands of every mesh harmonic, shape ``(samples_per_turn,)``.
    difference: Py<PyArray1<f64>>,
    /// Envelope of the orders within 6 of the mesh order, without its mean, shape ``(samples_per_turn,)``.
    mesh_envelope: Py<PyArray1<f64>>,
}

fn angle_source(py: Python<'_>, source: &AngleSource) -> PyResult<Py<PyAny>> {
    Ok(to_python(py, source)?.unbind())
}

/// Creates record and mesh from the arguments shared by the functions of this module.
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
fn record_and_mesh<'a>(
    samples: &'a Samples<'_>,
    rate_hz: f64,
    teeth: u32,
    shaft_speed_hz: Option<f64>,
    nominal_shaft_speed_hz: Option<f64>,
    tolerance: f64,
    pulse_times_s: Option<&Bound<'_, PyAny>>,
    pulses_per_revolution: u32,
    unit: &str,
) -> PyResult<(RecordOf<'a>, MeshContext)> {
    let machine = Machine {
        teeth: Some(teeth),
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        torque_nm: None,
        pulse_times_s,
        pulses_per_revolution,
    };
    Ok((machine.record(samples, rate_hz, unit)?, machine.required_mesh()?))
}

/// Resamples the record over the angle of its shaft.
///
/// The angle comes from a tachometer, else from the phase of a mesh line, else from a constant speed.
///
/// Args:
///     x: samples, shape ``(n,)``, in ``unit``.
///     rate_hz: sampling rate in hertz.
///     teeth: teeth of the gear on the shaft.
///     shaft_speed_hz: rotational frequency of that shaft in hertz, if it is known.
///     nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not known.
///     tolerance: search range around nominal, as a fraction.
///     pulse_times_s: times of a tachometer's pulses in seconds after the first sample, shape ``(pulses,)``.
///     pulses_per_revolution: pulses per turn of the shaft.
///     unit: unit of the samples.
///
/// Raises:
///     ValueError: if there is no speed, the record has fewer than 4 whole turns, or an argument is out of
///         range.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, teeth, shaft_speed_hz=None, nominal_shaft_speed_hz=None, tolerance=0.05, pulse_times_s=None,
    pulses_per_revolution=1, unit="1"))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub(crate) fn angle_record(
    x: &Bound<'_, PyAny>,
    rate_hz: f64,
    teeth: u32,
    shaft_speed_hz: Option<f64>,
    nominal_shaft_speed_hz: Option<f64>,
    tolerance: f64,
    pulse_times_s: Option<&Bound<'_, PyAny>>,
    pulses_per_revolution: u32,
    unit: &str,
) -> PyResult<AngleRecord> {
    let py = x.py();
    let samples = Samples::new(x)?;
    let (record, mesh) = record_and_mesh(
        &samples,
        rate_hz,
        teeth,
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        pulse_times_s,
        pulses_per_revolution,
        unit,
    )?;
    let (by_angle, average) = analyze(py, |analyzer| {
        let by_angle = analyzer.angle_record(&record, &mesh)?;
        let average = by_angle.synchronous_average();
        Ok((by_angle, average))
    })
    .map_err(|reason| not_computed_error("record over the shaft's angle", reason))?;
    Ok(AngleRecord {
        angle: angle_source(py, &by_angle.angle)?,
        unit: by_angle.unit.to_string(),
        samples: by_angle
            .samples
            .into_iter()
            .map(f64::from)
            .collect::<Vec<f64>>()
            .into_pyarray(py)
            .reshape([by_angle.turns, by_angle.samples_per_turn])?
            .unbind(),
        synchronous_average: average.into_pyarray(py).unbind(),
    })
}

/// Computes the amplitude spectrum over orders of the shaft.
///
/// Args:
///     x: samples, shape ``(n,)``, in ``unit``.
///     rate_hz: sampling rate in hertz.
///     teeth: teeth of the gear on the shaft.
///     shaft_speed_hz: rotational frequency of that shaft in hertz, if it is known.
///     nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not known.
///     tolerance: search range around nominal, as a fraction.
///     pulse_times_s: times of a tachometer's pulses in seconds after the first sample, shape ``(pulses,)``.
///     pulses_per_revolution: pulses per turn of the shaft.
///     unit: unit of the samples.
///
/// Raises:
///     ValueError: as in :func:`angle_record`.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, teeth, shaft_speed_hz=None, nominal_shaft_speed_hz=None, tolerance=0.05, pulse_times_s=None,
    pulses_per_revolution=1, unit="1"))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub(crate) fn order_spectrum(
    x: &Bound<'_, PyAny>,
    rate_hz: f64,
    teeth: u32,
    shaft_speed_hz: Option<f64>,
    nominal_shaft_speed_hz: Option<f64>,
    tolerance: f64,
    pulse_times_s: Option<&Bound<'_, PyAny>>,
    pulses_per_revolution: u32,
    unit: &str,
) -> PyResult<OrderSpectrum> {
    let py = x.py();
    let samples = Samples::new(x)?;
    let (record, mesh) = record_and_mesh(
        &samples,
        rate_hz,
        teeth,
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        pulse_times_s,
        pulses_per_revolution,
        unit,
    )?;
    let spectrum = analyze(py, |analyzer| analyzer.order_spectrum(&record, &mesh));
    let spectrum = spectrum.map_err(|reason| not_computed_error("order spectrum", reason))?;
    let orders: Vec<f64> =
        (0..spectrum.amplitude.len()).map(|k| k as f64 * spectrum.resolution_orders).collect();
    Ok(OrderSpectrum {
        angle: angle_source(py, &spectrum.angle)?,
        unit: spectrum.unit,
        resolution_orders: spectrum.resolution_orders,
        bandwidth_orders: spectrum.bandwidth_orders,
        order: orders.into_pyarray(py).unbind(),
        amplitude: spectrum.amplitude.into_pyarray(py).unbind(),
    })
}

/// Computes the synchronous average, its regular, residual and difference signals, and the mesh envelope.
///
/// Args:
///     x: samples, shape ``(n,)``, in ``unit``.
///     rate_hz: sampling rate in hertz.
///     teeth: teeth of the gear on the shaft.
///     shaft_speed_hz: rotational frequency of that shaft in hertz, if it is known.
///     nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not known.
///     tolerance: search range around nominal, as a fraction.
///     pulse_times_s: times of a tachometer's pulses in seconds after the first sample, shape ``(pulses,)``.
///     pulses_per_revolution: pulses per turn of the shaft.
///     unit: unit of the samples.
///
/// Raises:
///     ValueError: as in :func:`angle_record`.
#[pyfunction]
#[pyo3(signature = (x, rate_hz, *, teeth, shaft_speed_hz=None, nominal_shaft_speed_hz=None, tolerance=0.05, pulse_times_s=None,
    pulses_per_revolution=1, unit="1"))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub(crate) fn gear_signals(
    x: &Bound<'_, PyAny>,
    rate_hz: f64,
    teeth: u32,
    shaft_speed_hz: Option<f64>,
    nominal_shaft_speed_hz: Option<f64>,
    tolerance: f64,
    pulse_times_s: Option<&Bound<'_, PyAny>>,
    pulses_per_revolution: u32,
    unit: &str,
) -> PyResult<GearSignals> {
    let py = x.py();
    let samples = Samples::new(x)?;
    let (record, mesh) = record_and_mesh(
        &samples,
        rate_hz,
        teeth,
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        pulse_times_s,
        pulses_per_revolution,
        unit,
    )?;
    let signals = analyze(py, |analyzer| analyzer.gear_signals(&record, &mesh));
    let signals = signals.map_err(|reason| not_computed_error("synchronous average", reason))?;
    let array = |values: Vec<f64>| values.into_pyarray(py).unbind();
    Ok(GearSignals {
        average: array(signals.average),
        regular: array(signals.regular),
        residual: array(signals.residual),
        difference: array(signals.difference),
        mesh_envelope: array(signals.mesh_envelope),
    })
}
