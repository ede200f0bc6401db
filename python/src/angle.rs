//! Records over the shaft angle.

use flankwatch_signal::{AngleSource, MeshContext, Record};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

use crate::arguments::to_python;
use crate::error::not_computed_error;
use crate::record::{Machine, analyze};

/// Whole turns of a shaft, sampled at equal steps of its angle.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct AngleRecord {
    unit: String,
    samples: Py<PyArray2<f64>>,
    synchronous_average: Py<PyArray1<f64>>,
    angle: Py<PyAny>,
}

/// A spectrum over orders of the shaft.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct OrderSpectrum {
    unit: String,
    resolution_orders: f64,
    bandwidth_orders: f64,
    order: Py<PyArray1<f64>>,
    amplitude: Py<PyArray1<f64>>,
    angle: Py<PyAny>,
}

/// The synchronous average, split into its components.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct GearSignals {
    average: Py<PyArray1<f64>>,
    regular: Py<PyArray1<f64>>,
    residual: Py<PyArray1<f64>>,
    difference: Py<PyArray1<f64>>,
    mesh_envelope: Py<PyArray1<f64>>,
}

fn angle_source(py: Python<'_>, source: &AngleSource) -> PyResult<Py<PyAny>> {
    Ok(to_python(py, source)?.unbind())
}

/// Creates record and mesh from the arguments shared by the functions of this module.
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
fn record_and_mesh(
    x: &Bound<'_, PyAny>,
    rate_hz: f64,
    teeth: u32,
    shaft_speed_hz: Option<f64>,
    nominal_shaft_speed_hz: Option<f64>,
    tolerance: f64,
    pulse_times_s: Option<&Bound<'_, PyAny>>,
    pulses_per_revolution: u32,
    unit: &str,
) -> PyResult<(Record, MeshContext)> {
    let machine = Machine {
        teeth: Some(teeth),
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        torque_nm: None,
        pulse_times_s,
        pulses_per_revolution,
    };
    Ok((machine.record(x, rate_hz, unit)?, machine.required_mesh()?))
}

/// The record over the angle of its shaft.
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
    let (record, mesh) = record_and_mesh(
        x,
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
        let by_angle = analyzer.angle_record(&record, &mesh, None)?;
        let average = by_angle.synchronous_average();
        Ok((by_angle, average))
    })
    .map_err(|reason| not_computed_error("record over the shaft's angle", reason))?;
    Ok(AngleRecord {
        angle: angle_source(py, &by_angle.angle)?,
        unit: by_angle.unit,
        samples: by_angle
            .samples
            .into_pyarray(py)
            .reshape([by_angle.turns, by_angle.samples_per_turn])?
            .unbind(),
        synchronous_average: average.into_pyarray(py).unbind(),
    })
}

/// The spectrum over orders of the shaft.
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
    let (record, mesh) = record_and_mesh(
        x,
        rate_hz,
        teeth,
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        pulse_times_s,
        pulses_per_revolution,
        unit,
    )?;
    let spectrum = analyze(py, |analyzer| analyzer.order_spectrum(&record, &mesh, None));
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

/// The synchronous average and its regular, residual and difference signals.
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
    let (record, mesh) = record_and_mesh(
        x,
        rate_hz,
        teeth,
        shaft_speed_hz,
        nominal_shaft_speed_hz,
        tolerance,
        pulse_times_s,
        pulses_per_revolution,
        unit,
    )?;
    let signals = analyze(py, |analyzer| analyzer.gear_signals(&record, &mesh, None));
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
