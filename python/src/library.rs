//! Libraries of simulated wear states, and ensembles of similar pairs.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use flankwatch_wear::library::{
    BuildControl, EnsembleSettings, GridSettings, LibraryError, build, decode, decode_ensemble,
    encode_ensemble, save_library,
};
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

use crate::arguments::to_python;
use crate::error::{argument_error, library_error};
use crate::pair::Pair;

/// Interval at which a build checks for Ctrl-C and reports its progress.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Runs a build in a thread, while this one reports progress and stops it on Ctrl-C or if the callback
/// raises.
fn run_build<T: Send>(
    py: Python<'_>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(&BuildControl<'_>) -> Result<T, LibraryError> + Send,
) -> PyResult<T> {
    let (done, total) = (AtomicU64::new(0), AtomicU64::new(0));
    let (stop, ended) = (AtomicBool::new(false), AtomicBool::new(false));
    let report = |now: usize, all: usize| {
        done.fetch_max(now as u64, Ordering::Relaxed);
        total.store(all as u64, Ordering::Relaxed);
    };
    let control = BuildControl::with_progress(&report).cancelled_by(&stop);
    py.detach(|| {
        thread::scope(|scope| {
            let watcher = thread::current();
            let (ended, control) = (&ended, &control);
            let building = scope.spawn(move || {
                let built = work(control);
                ended.store(true, Ordering::Release);
                watcher.unpark();
                built
            });
            let mut reported = None;
            let mut interruption: Option<PyErr> = None;
            loop {
                let last = ended.load(Ordering::Acquire) || building.is_finished();
                let now = (done.load(Ordering::Relaxed), total.load(Ordering::Relaxed));
                if interruption.is_none() {
                    let reporting = Python::attach(|py| {
                        py.check_signals()?;
                        match &progress {
                            Some(progress) if reported != Some(now) && now.1 > 0 => {
                                progress.call1(py, now).map(|_| ())
                            }
                            _ => Ok(()),
                        }
                    });
                    reported = Some(now);
                    if let Err(error) = reporting {
                        stop.store(true, Ordering::Relaxed);
                        interruption = Some(error);
                    }
                }
                if last {
                    break;
                }
                thread::park_timeout(POLL_INTERVAL);
            }
            let built = building.join();
            match (interruption, built) {
                (Some(error), _) => Err(error),
                (None, Ok(built)) => built.map_err(library_error),
                (None, Err(panic)) => std::panic::resume_unwind(panic),
            }
        })
    })
}

fn os_error(path: &Path) -> impl Fn(std::io::Error) -> PyErr + '_ {
    move |error| PyOSError::new_err(format!("{}: {error}", path.display()))
}

/// Simulated wear states of one pair.
#[pyclass(frozen, module = "flankwatch")]
pub(crate) struct Library {
    pub(crate) library: Arc<flankwatch_wear::library::Library>,
}

#[pymethods]
impl Library {
    /// Simulates the states on all cores.
    ///
    /// Args:
    ///     pair: the pair.
    ///     states: number of wear states, from none to the greatest.
    ///     max_wear_um: greatest wear depth in µm; by default the usual one of the pair.
    ///     seconds: length of a simulation in seconds.
    ///     rate_hz: sampling rate in hertz.
    ///     torque_factors: torques of the states, as factors of the pair's torque.
    ///     speed_factors: shaft speeds of the states, as factors of the pair's speed.
    ///     seed: seed of the random part; the same seed gives the same library.
    ///     progress: called with the numbers of finished and of all simulations. Ctrl-C, or an exception in
    ///         it,
    ///         stops the build and is raised.
    ///
    /// Raises:
    ///     ValueError: if an argument is out of range.
    #[staticmethod]
    #[pyo3(signature = (pair, *, states=50, max_wear_um=None, seconds=2.0, rate_hz=20_000.0, torque_factors=vec![1.0],
        speed_factors=vec![1.0], seed=1, progress=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn build(
        py: Python<'_>,
        pair: &Pair,
        states: usize,
        max_wear_um: Option<f64>,
        seconds: f64,
        rate_hz: f64,
        torque_factors: Vec<f64>,
        speed_factors: Vec<f64>,
        seed: u64,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let usual = GridSettings::default().for_pair(&pair.spec);
        let grid = GridSettings {
            states,
            max_wear_um: max_wear_um.unwrap_or(usual.max_wear_um),
            seconds,
            sample_rate_hz: rate_hz,
            seed,
            torque_factors,
            speed_factors,
        };
        let library = run_build(py, progress, |control| build(&pair.spec, &grid, control))?;
        Ok(Self { library: Arc::new(library) })
    }

    /// Loads a library from a file.
    ///
    /// Raises:
    ///     OSError: if the file cannot be read.
    ///     ValueError: if it is not a library file, or damaged.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let bytes = std::fs::read(&path).map_err(os_error(&path))?;
        let library = py.detach(|| decode(&bytes)).map_err(library_error)?;
        Ok(Self { library: Arc::new(library) })
    }

    /// Writes the library to a file; ``flankwatch analyze`` reads ``DATA/libraries/`` + ``file_name``.
    ///
    /// Raises:
    ///     OSError: if the file cannot be written.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        save_library(&path, &self.library).map_err(library_error)
    }

    /// Identifier, a hash of all settings.
    #[getter]
    fn id(&self) -> &str {
        self.library.id()
    }

    /// Name of the file in which the program looks for the library.
    #[getter]
    fn file_name(&self) -> String {
        format!("{}.fwlib", self.library.id())
    }

    /// The pair.
    #[getter]
    fn pair(&self) -> Pair {
        Pair { spec: self.library.pair().clone() }
    }

    /// Greatest wear depth of each state in µm, shape ``(states,)``.
    #[getter]
    fn wear_um<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let depths: Vec<f64> = self.library.states().iter().map(|state| state.wear_um).collect();
        depths.into_pyarray(py)
    }

    /// Names of the indicators of the states.
    #[getter]
    fn indicator_names(&self) -> Vec<String> {
        let first = self.library.states().first();
        first
            .map(|state| state.indicators.values.keys().map(ToString::to_string).collect())
            .unwrap_or_default()
    }

    /// Returns an indicator over the wear states, shape ``(states,)``, NaN for states without it.
    ///
    /// Raises:
    ///     ValueError: if there is no such indicator.
    fn indicator<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        if !self.indicator_names().iter().any(|known| known == name) {
            return Err(argument_error(
                "name",
                format!("{name:?}"),
                &format!("one of {}", self.indicator_names().join(", ")),
            ));
        }
        let values: Vec<f64> = self
            .library
            .states()
            .iter()
            .map(|state| state.indicators.get(name).unwrap_or(f64::NAN))
            .collect();
        Ok(values.into_pyarray(py))
    }

    /// Returns the mesh cycle of one state, a dict of lists with units in their names.
    ///
    /// Raises:
    ///     ValueError: if there is no such state.
    fn mesh<'py>(&self, py: Python<'py>, state: usize) -> PyResult<Bound<'py, PyAny>> {
        let states = self.library.states();
        let Some(state) = states.get(state) else {
            return Err(argument_error("state", state, &format!("a number below {}", states.len())));
        };
        to_python(py, &state.cycle)
    }

    fn __len__(&self) -> usize {
        self.library.states().len()
    }

    fn __repr__(&self) -> String {
        format!(
            "<flankwatch.Library {}: {} wear states to {} µm>",
            self.library.id(),
            self.library.states().len(),
            self.library.max_wear_um()
        )
    }
}

/// The described pair and variations of it, any of which may be the machine's.
#[pyclass(frozen, module = "flankwatch")]
pub(crate) struct Ensemble {
    pub(crate) ensemble: Arc<flankwatch_wear::library::Ensemble>,
}

#[pymethods]
impl Ensemble {
    /// Simulates the members on all cores.
    ///
    /// Args:
    ///     library: library of the described pair.
    ///     members: number of variations.
    ///     progress: as in :meth:`Library.build`.
    ///
    /// Raises:
    ///     ValueError: if there are too many members.
    #[staticmethod]
    #[pyo3(signature = (library, *, members=1280, progress=None))]
    fn build(
        py: Python<'_>,
        library: &Library,
        members: usize,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        if members > 100_000 {
            return Err(argument_error("members", members, "at most 100000"));
        }
        let settings = EnsembleSettings { members };
        let library = Arc::clone(&library.library);
        let ensemble = run_build(py, progress, |control| {
            flankwatch_wear::library::Ensemble::build(library, &settings, control)
        })?;
        Ok(Self { ensemble: Arc::new(ensemble) })
    }

    /// Loads the ensemble of a library from a file.
    ///
    /// Raises:
    ///     OSError: if the file cannot be read.
    ///     ValueError: if it is damaged, or belongs to another library.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, library: &Library) -> PyResult<Self> {
        let bytes = std::fs::read(&path).map_err(os_error(&path))?;
        let library = Arc::clone(&library.library);
        let ensemble = py.detach(|| decode_ensemble(&bytes, library)).map_err(library_error)?;
        Ok(Self { ensemble: Arc::new(ensemble) })
    }

    /// Writes the ensemble to a file.
    ///
    /// Raises:
    ///     OSError: if the file cannot be written.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        std::fs::write(&path, encode_ensemble(&self.ensemble)).map_err(os_error(&path))
    }

    /// Identifier, a hash of all settings.
    #[getter]
    fn id(&self) -> &str {
        self.ensemble.id()
    }

    /// Library of the described pair.
    #[getter]
    fn library(&self) -> Library {
        Library { library: Arc::clone(self.ensemble.described()) }
    }

    fn __len__(&self) -> usize {
        self.ensemble.members().len()
    }
}

/// Returns the ensemble of an argument: an ensemble, or a library as its only member.
pub(crate) fn ensemble_of(value: &Bound<'_, PyAny>) -> PyResult<Arc<flankwatch_wear::library::Ensemble>> {
    if let Ok(ensemble) = value.cast::<Ensemble>() {
        return Ok(Arc::clone(&ensemble.get().ensemble));
    }
    match value.cast::<Library>() {
        Ok(library) => {
            Ok(Arc::new(flankwatch_wear::library::Ensemble::of(Arc::clone(&library.get().library))))
        }
        Err(_) => Err(argument_error("library", value.get_type().name()?, "a Library or an Ensemble")),
    }
}
