//! Creation of a record and its mesh context from the arguments of a function.

use std::cell::RefCell;

use flankwatch_signal::{AnalysisSettings, Analyzer, MeshContext, OperatingPoint, RecordOf, Tachometer};
use jiff::Timestamp;
use numpy::PyArrayMethods;
use pyo3::prelude::*;

use crate::arguments::{Samples, real_array};
use crate::error::{argument_error, value_error};

thread_local! {
    /// The thread's analyzer, which reuses its transform plans from call to call.
    static ANALYZER: RefCell<Analyzer> = RefCell::new(Analyzer::new(AnalysisSettings::default()));
}

/// Computes with the thread's analyzer while other threads run Python.
pub(crate) fn analyze<T: Send>(py: Python<'_>, work: impl FnOnce(&mut Analyzer) -> T + Send) -> T {
    py.detach(|| ANALYZER.with_borrow_mut(work))
}

/// Creates a record without data of the machine.
pub(crate) fn plain_record<'a>(samples: &'a Samples<'_>, rate_hz: f64, unit: &str) -> PyResult<RecordOf<'a>> {
    RecordOf::borrowing("1", Timestamp::UNIX_EPOCH, rate_hz, unit, samples.as_slice()?).map_err(value_error)
}

/// Arguments of a function that describe the machine.
pub(crate) struct Machine<'a, 'py> {
    pub(crate) teeth: Option<u32>,
    pub(crate) shaft_speed_hz: Option<f64>,
    pub(crate) nominal_shaft_speed_hz: Option<f64>,
    pub(crate) tolerance: f64,
    pub(crate) torque_nm: Option<f64>,
    pub(crate) pulse_times_s: Option<&'a Bound<'py, PyAny>>,
    pub(crate) pulses_per_revolution: u32,
}

impl Machine<'_, '_> {
    /// Returns the mesh context, which is unknown without teeth.
    pub(crate) fn mesh(&self) -> PyResult<MeshContext> {
        let Some(teeth) = self.teeth else {
            return Ok(MeshContext::unknown());
        };
        if !(4..=1000).contains(&teeth) {
            return Err(argument_error("teeth", teeth, "a tooth number from 4 to 1000"));
        }
        if !(0.0..=0.5).contains(&self.tolerance) {
            return Err(argument_error("tolerance", self.tolerance, "a fraction from 0 to 0.5"));
        }
        let speed_hz = self.nominal_shaft_speed_hz.or(self.shaft_speed_hz);
        let nominal_shaft_speed_hz = match speed_hz {
            Some(speed) if speed > 0.0 && speed <= 1e6 => speed,
            Some(speed) => {
                return Err(argument_error(
                    "nominal_shaft_speed_hz",
                    speed,
                    "a number above 0 and at most 1e6",
                ));
            }
            None if self.pulse_times_s.is_some() => 0.0,
            None => {
                let expected =
                    "the shaft speed, or nominal_shaft_speed_hz to search around, or pulse_times_s";
                return Err(argument_error("shaft_speed_hz", "missing", expected));
            }
        };
        Ok(MeshContext::new([teeth, 0], nominal_shaft_speed_hz, self.tolerance))
    }

    /// Returns the mesh context of a function that requires it.
    pub(crate) fn required_mesh(&self) -> PyResult<MeshContext> {
        match self.teeth {
            Some(_) => self.mesh(),
            None => Err(argument_error("teeth", "missing", "the tooth number of the gear on the shaft")),
        }
    }

    /// Creates the record with its operating point and tachometer.
    pub(crate) fn record<'a>(
        &self,
        samples: &'a Samples<'_>,
        rate_hz: f64,
        unit: &str,
    ) -> PyResult<RecordOf<'a>> {
        let point = OperatingPoint {
            shaft_speed_hz: self.shaft_speed_hz,
            torque_nm: self.torque_nm,
            ..OperatingPoint::default()
        };
        let record =
            plain_record(samples, rate_hz, unit)?.with_operating_point(point).map_err(value_error)?;
        let Some(times) = self.pulse_times_s else {
            return Ok(record);
        };
        if self.pulses_per_revolution == 0 {
            return Err(argument_error("pulses_per_revolution", 0, "at least 1"));
        }
        let times = real_array(times, "pulse_times_s", 1)?;
        let pulse_times_s = times.readonly().as_array().iter().copied().collect();
        Ok(record.with_tachometer(Some(Tachometer {
            pulse_times_s,
            pulses_per_revolution: self.pulses_per_revolution,
        })))
    }
}
