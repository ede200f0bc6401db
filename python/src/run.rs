//! A simulated run to failure with the truth known.

use flankwatch_wear::simulation::RunPlan;
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::arguments::time;
use crate::error::value_error;
use crate::pair::Pair;

/// A simulated run to failure through a random transmission path, as a sequence of records.
///
/// Args:
///     pair: the pair.
///     records: number of records.
///     seconds: length of a record in seconds.
///     rate_hz: sampling rate in hertz.
///     max_wear_um: greatest wear depth of the last record in µm; by default the usual one of the pair.
///     wear_exponent: power of time with which the wear grows.
///     snr_db: ratio of the healthy vibration's RMS to the sensor noise in dB.
///     speed_variation: the speed of each record lies within this fraction of nominal.
///     torque_variation: the torque of each record lies within this fraction of nominal.
///     start_time: time of the first record; by default the start of 2026.
///     interval_s: seconds from one record's start to the next one's.
///     seed: seed of the random part; the same seed gives the same run.
///
/// Raises:
///     ValueError: if an argument is out of range.
#[pyclass(frozen, sequence, module = "flankwatch")]
pub(crate) struct Run {
    run: flankwatch_wear::simulation::Run,
}

/// One record of a simulated run, with the true wear.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct SimulatedRecord {
    /// Samples in ``unit``, shape ``(n,)``.
    samples: Py<PyArray1<f32>>,
    /// Sampling rate in Hz.
    rate_hz: f64,
    /// Unit of the samples.
    unit: String,
    /// Time of the first sample, RFC 3339.
    time: String,
    /// Torque on the driving shaft in N·m.
    torque_nm: Option<f64>,
    /// True greatest wear depth in µm.
    wear_um: f64,
}

#[pymethods]
impl Run {
    #[new]
    #[pyo3(signature = (pair, *, records=300, seconds=10.0, rate_hz=20_000.0, max_wear_um=None, wear_exponent=1.5, snr_db=10.0,
        speed_variation=0.005, torque_variation=0.02, start_time=None, interval_s=60.0, seed=1))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn new(
        py: Python<'_>,
        pair: &Pair,
        records: u32,
        seconds: f64,
        rate_hz: f64,
        max_wear_um: Option<f64>,
        wear_exponent: f64,
        snr_db: f64,
        speed_variation: f64,
        torque_variation: f64,
        start_time: Option<&Bound<'_, PyAny>>,
        interval_s: f64,
        seed: u64,
    ) -> PyResult<Self> {
        let start_time = match start_time {
            Some(start_time) => time(start_time)?,
            None => "2026-01-01T00:00:00Z".parse().map_err(value_error)?,
        };
        let plan = RunPlan {
            pair: pair.spec.clone(),
            records,
            seconds,
            sample_rate_hz: rate_hz,
            max_wear_um: max_wear_um.unwrap_or_else(|| pair.spec.usual_wear_um()),
            wear_exponent,
            start_time,
            interval_s,
            snr_db,
            speed_variation,
            torque_variation,
            seed,
            channel: "1".to_owned(),
        };
        let run = py.detach(|| flankwatch_wear::simulation::Run::new(plan)).map_err(value_error)?;
        Ok(Self { run })
    }

    fn __len__(&self) -> usize {
        self.run.plan().records as usize
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<SimulatedRecord> {
        let count = self.__len__();
        let position = if index < 0 { index + count as isize } else { index };
        let Some(position) = u32::try_from(position).ok().filter(|position| (*position as usize) < count)
        else {
            return Err(PyIndexError::new_err(format!("record {index} of {count}")));
        };
        let simulated = py.detach(|| self.run.record(position)).map_err(value_error)?;
        let record = simulated.record;
        Ok(SimulatedRecord {
            samples: record.samples().to_vec().into_pyarray(py).unbind(),
            rate_hz: record.sample_rate_hz(),
            unit: record.unit().to_owned(),
            time: record.start_time().to_string(),
            torque_nm: record.operating_point().torque_nm,
            wear_um: simulated.wear_um,
        })
    }
}
