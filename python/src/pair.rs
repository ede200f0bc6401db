//! A gear pair: its description, its mesh, its vibration.

use std::fmt::Write;
use std::path::PathBuf;

use flankwatch_gear::{
    ArchardWear, ContactRule, FlankWear, GearPair, MeshRelationship, PairSpec, RunSettings, simulate,
};
use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

use crate::arguments::{from_python, real_array, to_python};
use crate::error::{argument_error, value_error};
use crate::mesh::{Flank, MeshCycle, ToothContact};

/// The pair of the paper's Table 1.
const SHEN2022: &str = include_str!("../../fixtures/pairs/shen2022.toml");

/// Number of positions of the mesh period used by the dynamics.
const CYCLE_POINTS: usize = 1000;

/// A pair of spur gears, described as in a pair file.
///
/// Wear is given in one of three ways: ``wear_um``, the greatest depth in µm with the pair's own wear shape;
/// ``profile``, a table of gear, radius in mm and depth in µm, of shape ``(n, 3)`` or as CSV; or ``turns`` of
/// the driving gear, which wear it by Archard's law.
#[pyclass(frozen, module = "flankwatch")]
pub(crate) struct Pair {
    pub(crate) spec: PairSpec,
}

/// A simulated vibration with its wear, speed and torque.
#[pyclass(frozen, get_all, module = "flankwatch")]
pub(crate) struct Simulation {
    /// Acceleration in m/s², shape ``(rate_hz × seconds,)``.
    samples: Py<PyArray1<f64>>,
    /// Sampling rate in Hz.
    rate_hz: f64,
    /// Unit of the samples, ``"m/s2"``.
    unit: &'static str,
    /// Greatest wear depth in µm.
    wear_um: f64,
    /// Rotational frequency of the driving shaft in Hz.
    shaft_speed_hz: f64,
    /// Torque on the driving shaft in N·m.
    torque_nm: f64,
    /// The mesh period that excites the vibration.
    mesh: Py<MeshCycle>,
}

/// Wear of the flanks, from a function's arguments.
enum Wear {
    Depth(f64),
    Table(String),
    Turns(f64),
}

impl Wear {
    fn of(wear_um: Option<f64>, profile: Option<&Bound<'_, PyAny>>, turns: Option<f64>) -> PyResult<Self> {
        match (wear_um, profile, turns) {
            (None, None, None) => Ok(Self::Depth(0.0)),
            (Some(wear_um), None, None) => Ok(Self::Depth(wear_um)),
            (None, Some(profile), None) => Ok(Self::Table(table(profile)?)),
            (None, None, Some(turns)) => Ok(Self::Turns(turns)),
            _ => {
                Err(argument_error("wear", "given more than once", "only one of wear_um, profile and turns"))
            }
        }
    }

    fn flanks(&self, pair: &GearPair) -> Result<FlankWear, flankwatch_gear::GearError> {
        match self {
            Self::Depth(0.0) => Ok(FlankWear::none()),
            Self::Depth(wear_um) => FlankWear::from_shape(pair, wear_um * 1e-3),
            Self::Table(csv) => FlankWear::from_table_csv(pair, csv),
            Self::Turns(turns) => Ok(ArchardWear::after_turns(pair, *turns)?.wear),
        }
    }
}

/// Converts a wear table to CSV: text unchanged, else rows of gear, radius in mm and depth in µm.
fn table(profile: &Bound<'_, PyAny>) -> PyResult<String> {
    if let Ok(text) = profile.extract::<String>() {
        return Ok(text);
    }
    let rows = real_array(profile, "profile", 2)?;
    let rows = rows.readonly();
    let rows = rows.as_array();
    if rows.shape()[1] != 3 {
        return Err(argument_error(
            "profile",
            format!("{} columns", rows.shape()[1]),
            "three: gear, radius_mm, depth_um",
        ));
    }
    let mut csv = "gear,radius_mm,depth_um\n".to_owned();
    for row in rows.rows() {
        // Writing to a string does not fail.
        let _ = writeln!(csv, "{},{},{}", row[0], row[1], row[2]);
    }
    Ok(csv)
}

impl Pair {
    /// Returns the description with another torque or contact rule.
    fn with_operation(&self, torque_nm: Option<f64>, contact: Option<&str>) -> PyResult<PairSpec> {
        let mut spec = self.spec.clone();
        if let Some(torque_nm) = torque_nm {
            spec.operation.torque_nm = torque_nm;
        }
        if let Some(contact) = contact {
            spec.dynamics.contact = contact.parse::<ContactRule>().map_err(|_| {
                argument_error("contact", format!("{contact:?}"), "\"threshold\" or \"loaded\"")
            })?;
        }
        Ok(spec)
    }
}

#[pymethods]
impl Pair {
    /// Returns the pair that the text of a pair file describes.
    ///
    /// Raises:
    ///     ValueError: if it is not a pair file, or the pair is outside the model's range.
    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        let spec = PairSpec::from_toml(text).map_err(value_error)?;
        spec.resolve().map_err(value_error)?;
        Ok(Self { spec })
    }

    /// Returns the pair of a pair file.
    ///
    /// Raises:
    ///     OSError: if the file cannot be read.
    ///     ValueError: as in :meth:`from_toml`.
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        let text = std::fs::read_to_string(&path)
            .map_err(|error| PyOSError::new_err(format!("{}: {error}", path.display())))?;
        Self::from_toml(&text).map_err(|error| value_error(format!("{}: {error}", path.display())))
    }

    /// Returns the pair that the tables of a pair file describe.
    ///
    /// Raises:
    ///     ValueError: as in :meth:`from_toml`.
    #[staticmethod]
    fn from_dict(description: &Bound<'_, PyAny>) -> PyResult<Self> {
        let spec: PairSpec = from_python("pair", description)?;
        spec.resolve().map_err(value_error)?;
        Ok(Self { spec })
    }

    /// Returns the pair of Shen et al. 2022, Table 1.
    #[staticmethod]
    fn shen2022() -> PyResult<Self> {
        Self::from_toml(SHEN2022)
    }

    /// Returns the description including all defaults, as the tables of a pair file.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.spec)
    }

    /// Name of the pair.
    #[getter]
    fn name(&self) -> &str {
        &self.spec.name
    }

    /// Teeth of the driving and of the driven gear.
    #[getter]
    fn teeth(&self) -> (u32, u32) {
        let [driving, driven] = self.spec.geometry.teeth;
        (driving, driven)
    }

    /// Rotational frequency of the driving shaft in Hz.
    #[getter]
    fn shaft_speed_hz(&self) -> f64 {
        self.spec.operation.shaft_speed_hz
    }

    /// Torque on the driving shaft in N·m.
    #[getter]
    fn torque_nm(&self) -> f64 {
        self.spec.operation.torque_nm
    }

    /// Mean number of tooth pairs in contact.
    #[getter]
    fn contact_ratio(&self) -> PyResult<f64> {
        Ok(self.spec.resolve().map_err(value_error)?.contact_ratio())
    }

    fn __repr__(&self) -> String {
        let [driving, driven] = self.spec.geometry.teeth;
        format!(
            "<flankwatch.Pair {:?}: {driving}/{driven} teeth, module {} mm>",
            self.spec.name, self.spec.geometry.module_mm
        )
    }

    /// Computes mesh stiffness and transmission error over one mesh period.
    ///
    /// Args:
    ///     wear_um: greatest wear depth in µm, with the pair's own wear shape.
    ///     profile: wear table of gear, radius in mm and depth in µm, shape ``(n, 3)``, or its CSV text.
    ///     turns: turns of the driving gear, which wear it by Archard's law.
    ///     torque_nm: torque on the driving shaft in N·m, instead of the pair's.
    ///     contact: rule for the pairs in contact: ``"threshold"`` (the paper's) or ``"loaded"`` (elastic
    ///         load
    ///         sharing), instead of the pair's.
    ///     points: number of rotations.
    ///
    /// Raises:
    ///     ValueError: if the wear or torque is outside the model's range, or an argument is invalid.
    #[pyo3(signature = (wear_um=None, *, profile=None, turns=None, torque_nm=None, contact=None, points=1000))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn mesh(
        &self,
        py: Python<'_>,
        wear_um: Option<f64>,
        profile: Option<&Bound<'_, PyAny>>,
        turns: Option<f64>,
        torque_nm: Option<f64>,
        contact: Option<&str>,
        points: usize,
    ) -> PyResult<MeshCycle> {
        let (spec, wear) = (self.with_operation(torque_nm, contact)?, Wear::of(wear_um, profile, turns)?);
        let cycle = py.detach(|| {
            let pair = spec.resolve()?;
            flankwatch_gear::MeshCycle::compute(&pair, &wear.flanks(&pair)?, points)
        });
        Ok(MeshCycle::new(py, cycle.map_err(value_error)?))
    }

    /// Computes the contact of one pair of teeth, at 601 points.
    ///
    /// Args:
    ///     wear_um: greatest wear depth in µm, with the pair's own wear shape.
    ///     profile: wear table of gear, radius in mm and depth in µm, shape ``(n, 3)``, or its CSV text.
    ///     turns: turns of the driving gear, which wear it by Archard's law.
    ///
    /// Raises:
    ///     ValueError: if the wear is outside the model's range.
    #[pyo3(signature = (wear_um=None, *, profile=None, turns=None))]
    fn tooth_contact(
        &self,
        py: Python<'_>,
        wear_um: Option<f64>,
        profile: Option<&Bound<'_, PyAny>>,
        turns: Option<f64>,
    ) -> PyResult<ToothContact> {
        let wear = Wear::of(wear_um, profile, turns)?;
        let contact = py.detach(|| {
            let pair = self.spec.resolve()?;
            MeshRelationship::solve(&pair, &wear.flanks(&pair)?)
        });
        Ok(ToothContact::new(py, contact.map_err(value_error)?))
    }

    /// Returns the working flank of one gear.
    ///
    /// Args:
    ///     gear: 1 for the driving gear, 2 for the driven one.
    ///     wear_um: greatest wear depth in µm, with the pair's own wear shape.
    ///     profile: wear table of gear, radius in mm and depth in µm, shape ``(n, 3)``, or its CSV text.
    ///     turns: turns of the driving gear, which wear it by Archard's law.
    ///     points: number of points from the start of active profile to the tip.
    ///
    /// Raises:
    ///     ValueError: if the wear is outside the model's range, or an argument is invalid.
    #[pyo3(signature = (gear, wear_um=None, *, profile=None, turns=None, points=201))]
    fn flank(
        &self,
        py: Python<'_>,
        gear: usize,
        wear_um: Option<f64>,
        profile: Option<&Bound<'_, PyAny>>,
        turns: Option<f64>,
        points: usize,
    ) -> PyResult<Flank> {
        if !(1..=2).contains(&gear) {
            return Err(argument_error("gear", gear, "1 for the driving gear or 2 for the driven one"));
        }
        if !(2..=1_000_000).contains(&points) {
            return Err(argument_error("points", points, "a number from 2 to 1000000"));
        }
        let wear = Wear::of(wear_um, profile, turns)?;
        let pair = self.spec.resolve().map_err(value_error)?;
        let worn = py.detach(|| wear.flanks(&pair)).map_err(value_error)?;
        Ok(Flank::new(py, &flankwatch_gear::Flank::new(&pair.gears[gear - 1], &worn, gear - 1), points))
    }

    /// Simulates the vibration of the worn pair.
    ///
    /// Args:
    ///     rate_hz: sampling rate in hertz.
    ///     seconds: length in seconds.
    ///     wear_um: greatest wear depth in µm, with the pair's own wear shape.
    ///     profile: wear table of gear, radius in mm and depth in µm, shape ``(n, 3)``, or its CSV text.
    ///     turns: turns of the driving gear, which wear it by Archard's law.
    ///     shaft_speed_hz: rotational frequency of the driving shaft in hertz, instead of the pair's.
    ///     torque_nm: torque on the driving shaft in N·m, instead of the pair's.
    ///     contact: rule for the pairs in contact, as in :meth:`mesh`.
    ///     seed: seed of the random part; the same seed gives the same samples.
    ///     start_phase_turns: angle of the driving shaft at the first sample, in turns.
    ///
    /// Raises:
    ///     ValueError: if an argument is outside the model's range.
    #[pyo3(signature = (rate_hz, seconds, *, wear_um=None, profile=None, turns=None, shaft_speed_hz=None, torque_nm=None, contact=None,
        seed=None, start_phase_turns=0.0))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn simulate(
        &self,
        py: Python<'_>,
        rate_hz: f64,
        seconds: f64,
        wear_um: Option<f64>,
        profile: Option<&Bound<'_, PyAny>>,
        turns: Option<f64>,
        shaft_speed_hz: Option<f64>,
        torque_nm: Option<f64>,
        contact: Option<&str>,
        seed: Option<u64>,
        start_phase_turns: f64,
    ) -> PyResult<Simulation> {
        let (spec, wear) = (self.with_operation(torque_nm, contact)?, Wear::of(wear_um, profile, turns)?);
        let pair = spec.resolve().map_err(value_error)?;
        let nominal = RunSettings::nominal(&pair, rate_hz, seconds);
        let settings = RunSettings {
            shaft_speed_hz: shaft_speed_hz.unwrap_or(nominal.shaft_speed_hz),
            seed: seed.unwrap_or(nominal.seed),
            start_phase_turns,
            ..nominal
        };
        let computed = py.detach(|| {
            let flanks = wear.flanks(&pair)?;
            let cycle = flankwatch_gear::MeshCycle::compute(&pair, &flanks, CYCLE_POINTS)?;
            let samples = simulate(&pair, &cycle, &settings)?;
            let [driving, driven] = flanks.greatest_depth_mm(&pair);
            Ok((samples, cycle, driving.max(driven) * 1e3))
        });
        let (samples, cycle, greatest_um) =
            computed.map_err(|error: flankwatch_gear::GearError| value_error(error))?;
        Ok(Simulation {
            samples: samples.into_pyarray(py).unbind(),
            rate_hz,
            unit: "m/s2",
            wear_um: wear_um.unwrap_or(greatest_um),
            shaft_speed_hz: settings.shaft_speed_hz,
            torque_nm: settings.torque_nm,
            mesh: Py::new(py, MeshCycle::new(py, cycle))?,
        })
    }
}
