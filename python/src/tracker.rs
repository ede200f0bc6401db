//! The wear estimate over a machine's records.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use flankwatch_signal::{BearingSettings, ConditionSettings, MeshContext};
use flankwatch_wear::estimate::{ChannelEstimator, ChannelState, EstimatorSettings, MaintenanceEvent};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::{Samples, from_python, to_python};
use crate::error::{argument_error, value_error};
use crate::library::ensemble_of;
use crate::record::{Machine, analyze};

/// Estimates the wear of one measuring channel, record by record in time order.
///
/// Args:
///     library: a library, or an ensemble for an estimate that includes the uncertainty of the pair.
///     teeth: teeth of the driving gear; by default those of the library's pair.
///     nominal_shaft_speed_hz: nominal speed in hertz; by default that of the library's pair.
///     tolerance: search range of the speed around nominal, as a fraction.
///     baseline_records: number of records in the healthy baseline, at least 8.
///     limit_um: wear depth in µm for which the prognosis is made.
///     unit: unit of the samples.
///
/// Raises:
///     ValueError: if an argument is out of range, or neither a library nor teeth and speed are given.
#[pyclass(frozen, module = "flankwatch")]
pub(crate) struct Tracker {
    estimator: ChannelEstimator,
    /// The state after the records so far, as JSON.
    state: Mutex<ChannelState>,
    teeth: u32,
    mate_teeth: u32,
    nominal_shaft_speed_hz: f64,
    tolerance: f64,
    unit: String,
}

#[pymethods]
impl Tracker {
    #[new]
    #[pyo3(signature = (library=None, *, teeth=None, nominal_shaft_speed_hz=None, tolerance=0.05, baseline_records=20, limit_um=None,
        unit="m/s2"))]
    fn new(
        library: Option<&Bound<'_, PyAny>>,
        teeth: Option<u32>,
        nominal_shaft_speed_hz: Option<f64>,
        tolerance: f64,
        baseline_records: u32,
        limit_um: Option<f64>,
        unit: &str,
    ) -> PyResult<Self> {
        let ensemble = library.map(ensemble_of).transpose()?;
        let pair = ensemble.as_ref().map(|ensemble| ensemble.described().pair().clone());
        let mate_teeth = pair.as_ref().map_or(0, |pair| pair.geometry.teeth[1]);
        let teeth = teeth.or(pair.as_ref().map(|pair| pair.geometry.teeth[0]));
        let nominal = nominal_shaft_speed_hz.or(pair.as_ref().map(|pair| pair.operation.shaft_speed_hz));
        let (Some(teeth), Some(nominal)) = (teeth, nominal) else {
            return Err(argument_error("library", "None", "a library, or teeth and nominal_shaft_speed_hz"));
        };
        if !(8..=10_000).contains(&baseline_records) {
            return Err(argument_error("baseline_records", baseline_records, "a number from 8 to 10000"));
        }
        if let Some(limit_um) = limit_um.filter(|limit_um| !(*limit_um > 0.0 && limit_um.is_finite())) {
            return Err(argument_error("limit_um", limit_um, "a depth above 0"));
        }
        let estimator =
            ChannelEstimator::new(EstimatorSettings { baseline_records, limit_um }, ensemble, Vec::new());
        let tracker = Self {
            state: Mutex::new(estimator.start()),
            estimator,
            teeth,
            mate_teeth,
            nominal_shaft_speed_hz: nominal,
            tolerance,
            unit: unit.to_owned(),
        };
        tracker.machine(None, None).required_mesh()?;
        Ok(tracker)
    }

    /// Adds a record.
    ///
    /// Args:
    ///     x: samples, shape ``(n,)``, in the tracker's unit.
    ///     rate_hz: sampling rate in hertz.
    ///     time: time of the first sample, later than that of the record before.
    ///     shaft_speed_hz: rotational frequency of the driving shaft in hertz, if it is known.
    ///     torque_nm: torque on the driving shaft in N·m, if it is known.
    ///     pulse_times_s: times of a tachometer's pulses in seconds after the first sample, shape
    ///         ``(pulses,)``.
    ///     pulses_per_revolution: pulses per turn of the shaft.
    ///
    /// Returns:
    ///     A dict of ``time``, ``indicators``, ``absent`` (reasons by name), ``shaft_speed`` and ``wear``,
    ///         the
    ///     estimate in µm.
    ///
    /// Raises:
    ///     ValueError: if samples are not finite or not of shape ``(n,)``, or an argument is out of range.
    #[pyo3(signature = (x, rate_hz, time, *, shaft_speed_hz=None, torque_nm=None, pulse_times_s=None, pulses_per_revolution=1))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn update<'py>(
        &self,
        x: &Bound<'py, PyAny>,
        rate_hz: f64,
        time: &Bound<'py, PyAny>,
        shaft_speed_hz: Option<f64>,
        torque_nm: Option<f64>,
        pulse_times_s: Option<&Bound<'py, PyAny>>,
        pulses_per_revolution: u32,
    ) -> PyResult<Bound<'py, PyDict>> {
        let py = x.py();
        let machine =
            Machine { pulse_times_s, pulses_per_revolution, ..self.machine(shaft_speed_hz, torque_nm) };
        let samples = Samples::new(x)?;
        let (mesh, record) = (machine.required_mesh()?, machine.record(&samples, rate_hz, &self.unit)?);
        let time = crate::arguments::time(time)?;
        let settings = ConditionSettings {
            mesh: MeshContext {
                mate_teeth: self.mate_teeth,
                nominal_shaft_speed_hz: self.nominal_shaft_speed_hz,
                ..mesh
            },
            bands: &[],
            gear_indicators: true,
            bearings: BearingSettings::default(),
        };
        let (analysis, folded) = analyze(py, |analyzer| {
            let analysis = analyzer.condition(&record, &settings).analysis;
            // The state is replaced as a whole, so it is valid even after a panic elsewhere.
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            let folded = self.estimator.record(&mut state, time, &analysis.features, &analysis.indicators);
            (analysis, folded)
        });
        let mut indicators = analysis.indicators;
        indicators.extend(folded.indicators);
        let result = PyDict::new(py);
        result.set_item("time", time.to_string())?;
        result.set_item("indicators", to_python(py, &indicators.values)?)?;
        result.set_item("absent", to_python(py, &indicators.absent)?)?;
        result.set_item("shaft_speed", to_python(py, &analysis.shaft_speed)?)?;
        result.set_item("wear", to_python(py, &folded.wear)?)?;
        Ok(result)
    }

    /// Adds maintenance between two records.
    ///
    /// Args:
    ///     kind: ``"gear_replaced"``, ``"inspected"`` or another kind of the HTTP API.
    ///     time: its time.
    ///     inspection: what an inspection found, such as ``{"depth_um": 80}``.
    ///     until: its end, for kinds that last.
    ///
    /// Raises:
    ///     ValueError: if the kind does not exist, or a value is out of range.
    #[pyo3(signature = (kind, time, *, inspection=None, until=None))]
    fn maintenance(
        &self,
        py: Python<'_>,
        kind: &str,
        time: &Bound<'_, PyAny>,
        inspection: Option<&Bound<'_, PyAny>>,
        until: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let fields = PyDict::new(py);
        fields.set_item("kind", kind)?;
        fields.set_item("time", crate::arguments::time(time)?.to_string())?;
        if let Some(inspection) = inspection {
            fields.set_item("inspection", inspection)?;
        }
        if let Some(until) = until {
            fields.set_item("until", crate::arguments::time(until)?.to_string())?;
        }
        let event: MaintenanceEvent = from_python("maintenance", &fields)?;
        if let Some((field, value, expected)) =
            event.inspection.as_ref().and_then(|inspection| inspection.fault())
        {
            return Err(argument_error(field, value, expected));
        }
        py.detach(|| {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            self.estimator.maintenance(&mut state, &event);
        });
        Ok(())
    }

    /// The state after the records so far, as JSON.
    #[getter]
    fn state(&self, py: Python<'_>) -> PyResult<String> {
        py.detach(|| serde_json::to_string(&*self.state.lock().unwrap_or_else(PoisonError::into_inner)))
            .map_err(value_error)
    }

    /// Replaces the state.
    ///
    /// Raises:
    ///     ValueError: if the text is not a tracker's state, or one of a library with another number of
    ///         members.
    fn restore(&self, py: Python<'_>, state: &str) -> PyResult<()> {
        let restored: ChannelState = serde_json::from_str(state)
            .map_err(|error| value_error(format!("not a tracker state: {error}")))?;
        if !self.estimator.continues(&restored) {
            let value = "that of a library with another number of members";
            return Err(argument_error("state", value, "one of this tracker's library"));
        }
        py.detach(|| *self.state.lock().unwrap_or_else(PoisonError::into_inner) = restored);
        Ok(())
    }

    /// Writes the state to a file. A reader sees the old state or the new one.
    ///
    /// Raises:
    ///     OSError: if the file cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let text = self.state(py)?;
        // A reader sees the old state or the new one, never a partial one.
        let mut temporary = path.clone().into_os_string();
        temporary.push(".new");
        let written = std::fs::write(&temporary, text).and_then(|()| std::fs::rename(&temporary, &path));
        written.map_err(|error| PyOSError::new_err(format!("{}: {error}", path.display())))
    }

    /// Replaces the state with that of a file.
    ///
    /// Raises:
    ///     OSError: if the file cannot be read.
    ///     ValueError: if it is not a tracker's state, or one of a library with another number of members.
    fn load(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let text = std::fs::read_to_string(&path)
            .map_err(|error| PyOSError::new_err(format!("{}: {error}", path.display())))?;
        self.restore(py, &text)
    }
}

impl Tracker {
    fn machine(&self, shaft_speed_hz: Option<f64>, torque_nm: Option<f64>) -> Machine<'_, '_> {
        Machine {
            teeth: Some(self.teeth),
            shaft_speed_hz,
            nominal_shaft_speed_hz: Some(self.nominal_shaft_speed_hz),
            tolerance: self.tolerance,
            torque_nm,
            pulse_times_s: None,
            pulses_per_revolution: 1,
        }
    }
}
