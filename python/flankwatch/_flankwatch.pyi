from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Time: TypeAlias = Any
_Path: TypeAlias = str | PathLike[str]
_Contact: TypeAlias = Literal["threshold", "loaded"]

class Spectrum:
    """The one-sided spectrum of a record with its mean removed, under a Hann window.

    ``frequency_hz`` and ``amplitude`` have shape ``(n // 2 + 1,)``; ``quantity`` is ``"amplitude_peak"`` or
    ``"psd"``.
    """

    @property
    def quantity(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def window(self) -> str: ...
    @property
    def bandwidth_hz(self) -> float: ...
    @property
    def resolution_hz(self) -> float: ...
    @property
    def frequency_hz(self) -> NDArray[np.float64]: ...
    @property
    def amplitude(self) -> NDArray[np.float64]: ...

class EnvelopeSpectrum:
    """The amplitude spectrum of a band's envelope, and how the band was chosen."""

    @property
    def unit(self) -> str: ...
    @property
    def band_hz(self) -> list[float]: ...
    @property
    def band_source(self) -> str: ...
    @property
    def spectral_kurtosis(self) -> float | None: ...
    @property
    def bandwidth_hz(self) -> float: ...
    @property
    def resolution_hz(self) -> float: ...
    @property
    def frequency_hz(self) -> NDArray[np.float64]: ...
    @property
    def amplitude(self) -> NDArray[np.float64]: ...

class Kurtogram:
    """Spectral kurtosis at several divisions of the spectrum.

    ``bandwidth_hz[i]`` and ``kurtosis[i]`` belong to division i.
    """

    @property
    def bandwidth_hz(self) -> list[float]: ...
    @property
    def kurtosis(self) -> list[NDArray[np.float64]]: ...
    @property
    def best_band_hz(self) -> list[float]: ...
    @property
    def best_kurtosis(self) -> float: ...

class Cepstrum:
    """The real cepstrum over quefrency in seconds, up to half the record's length."""

    @property
    def resolution_s(self) -> float: ...
    @property
    def quefrency_s(self) -> NDArray[np.float64]: ...
    @property
    def value(self) -> NDArray[np.float64]: ...

class AngleRecord:
    """A record resampled over whole turns of the shaft.

    ``samples`` has shape ``(turns, samples_per_turn)``; ``angle`` describes the source of the angle.
    """

    @property
    def unit(self) -> str: ...
    @property
    def samples(self) -> NDArray[np.float64]: ...
    @property
    def synchronous_average(self) -> NDArray[np.float64]: ...
    @property
    def angle(self) -> dict[str, Any]: ...

class OrderSpectrum:
    """The Hann amplitude spectrum over orders of the shaft."""

    @property
    def unit(self) -> str: ...
    @property
    def resolution_orders(self) -> float: ...
    @property
    def bandwidth_orders(self) -> float: ...
    @property
    def order(self) -> NDArray[np.float64]: ...
    @property
    def amplitude(self) -> NDArray[np.float64]: ...
    @property
    def angle(self) -> dict[str, Any]: ...

class GearSignals:
    """The synchronous average and its parts, each of shape ``(samples_per_turn,)``."""

    @property
    def average(self) -> NDArray[np.float64]: ...
    @property
    def regular(self) -> NDArray[np.float64]: ...
    @property
    def residual(self) -> NDArray[np.float64]: ...
    @property
    def difference(self) -> NDArray[np.float64]: ...
    @property
    def mesh_envelope(self) -> NDArray[np.float64]: ...

class MeshCycle:
    """One mesh period over φ₁: arrays of shape ``(points,)``."""

    @property
    def phi1_rad(self) -> NDArray[np.float64]: ...
    @property
    def phi2_rad(self) -> NDArray[np.float64]: ...
    @property
    def stiffness_n_per_m(self) -> NDArray[np.float64]: ...
    @property
    def uste_rad(self) -> NDArray[np.float64]: ...
    @property
    def pairs_in_contact(self) -> NDArray[np.uint32]: ...
    @property
    def mean_stiffness_n_per_m(self) -> float: ...

class ToothContact:
    """Contact points and rotations of one pair of teeth, from the start to the end of its contact."""

    @property
    def alpha1_rad(self) -> NDArray[np.float64]: ...
    @property
    def alpha1_prime_rad(self) -> NDArray[np.float64]: ...
    @property
    def phi1_rad(self) -> NDArray[np.float64]: ...
    @property
    def phi2_rad(self) -> NDArray[np.float64]: ...

class Flank:
    """One flank from the start of active profile to the tip."""

    @property
    def radius_mm(self) -> NDArray[np.float64]: ...
    @property
    def depth_um(self) -> NDArray[np.float64]: ...
    @property
    def x_mm(self) -> NDArray[np.float64]: ...
    @property
    def y_mm(self) -> NDArray[np.float64]: ...

class Simulation:
    """A simulated vibration in m/s², with its wear, speed and torque."""

    @property
    def samples(self) -> NDArray[np.float64]: ...
    @property
    def rate_hz(self) -> float: ...
    @property
    def unit(self) -> str: ...
    @property
    def wear_um(self) -> float: ...
    @property
    def shaft_speed_hz(self) -> float: ...
    @property
    def torque_nm(self) -> float: ...
    @property
    def mesh(self) -> MeshCycle: ...

class Pair:
    """A pair of spur gears, described as in a pair file.

    Wear is given in one of three ways: ``wear_um``, the greatest depth in µm with the pair's own wear shape;
    ``profile``, a table of gear, radius in mm and depth in µm, of shape ``(n, 3)`` or as CSV; or ``turns`` of
    the driving gear, which wear it by Archard's law.
    """

    @staticmethod
    def from_toml(text: str) -> Pair:
        """Returns the pair that the text of a pair file describes."""

    @staticmethod
    def from_file(path: _Path) -> Pair:
        """Returns the pair of a pair file."""

    @staticmethod
    def from_dict(description: dict[str, Any]) -> Pair:
        """Returns the pair that the tables of a pair file describe."""

    @staticmethod
    def shen2022() -> Pair:
        """Returns the pair of Shen et al. 2022, Table 1."""

    def to_dict(self) -> dict[str, Any]:
        """Returns the description including all defaults."""

    @property
    def name(self) -> str: ...
    @property
    def teeth(self) -> tuple[int, int]: ...
    @property
    def shaft_speed_hz(self) -> float: ...
    @property
    def torque_nm(self) -> float: ...
    @property
    def contact_ratio(self) -> float: ...
    def mesh(
        self,
        wear_um: float | None = None,
        *,
        profile: str | ArrayLike | None = None,
        turns: float | None = None,
        torque_nm: float | None = None,
        contact: _Contact | None = None,
        points: int = 1000,
    ) -> MeshCycle:
        """Computes mesh stiffness and transmission error over one mesh period, at ``points`` rotations.

        Raises:
            ValueError: if the wear or torque is outside the model's range.
        """

    def tooth_contact(
        self,
        wear_um: float | None = None,
        *,
        profile: str | ArrayLike | None = None,
        turns: float | None = None,
    ) -> ToothContact:
        """Computes the contact of one pair of teeth, at 601 points."""

    def flank(
        self,
        gear: int,
        wear_um: float | None = None,
        *,
        profile: str | ArrayLike | None = None,
        turns: float | None = None,
        points: int = 201,
    ) -> Flank:
        """Returns the working flank of gear 1 (driving) or 2 (driven)."""

    def simulate(
        self,
        rate_hz: float,
        seconds: float,
        *,
        wear_um: float | None = None,
        profile: str | ArrayLike | None = None,
        turns: float | None = None,
        shaft_speed_hz: float | None = None,
        torque_nm: float | None = None,
        contact: _Contact | None = None,
        seed: int | None = None,
        start_phase_turns: float = 0.0,
    ) -> Simulation:
        """Simulates the vibration of the worn pair, ``rate_hz × seconds`` samples in m/s²."""

class SimulatedRecord:
    """One record of a simulated run, with the true wear."""

    @property
    def samples(self) -> NDArray[np.float32]: ...
    @property
    def rate_hz(self) -> float: ...
    @property
    def unit(self) -> str: ...
    @property
    def time(self) -> str: ...
    @property
    def torque_nm(self) -> float | None: ...
    @property
    def wear_um(self) -> float: ...

class Run:
    """A simulated run to failure through a random transmission path, as a sequence of records."""

    def __new__(
        cls,
        pair: Pair,
        *,
        records: int = 300,
        seconds: float = 10.0,
        rate_hz: float = 20_000.0,
        max_wear_um: float | None = None,
        wear_exponent: float = 1.5,
        snr_db: float = 10.0,
        speed_variation: float = 0.005,
        torque_variation: float = 0.02,
        start_time: _Time | None = None,
        interval_s: float = 60.0,
        seed: int = 1,
    ) -> Run: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: int) -> SimulatedRecord: ...
    def __iter__(self) -> Iterator[SimulatedRecord]: ...

class Library:
    """Simulated wear states of one pair."""

    @staticmethod
    def build(
        pair: Pair,
        *,
        states: int = 50,
        max_wear_um: float | None = None,
        seconds: float = 2.0,
        rate_hz: float = 20_000.0,
        torque_factors: Sequence[float] = ...,
        speed_factors: Sequence[float] = ...,
        seed: int = 1,
        progress: Callable[[int, int], object] | None = None,
    ) -> Library:
        """Simulates the states on all cores.

        ``progress`` is called with the numbers of finished and of all simulations. Ctrl-C, or an exception in
        ``progress``, stops the build and is raised.
        """

    @staticmethod
    def load(path: _Path) -> Library:
        """Loads a library from a file."""

    def save(self, path: _Path) -> None:
        """Writes the library to a file; ``flankwatch analyze`` reads ``DATA/libraries/`` + ``file_name``."""

    @property
    def id(self) -> str: ...
    @property
    def file_name(self) -> str: ...
    @property
    def pair(self) -> Pair: ...
    @property
    def wear_um(self) -> NDArray[np.float64]: ...
    @property
    def indicator_names(self) -> list[str]: ...
    def indicator(self, name: str) -> NDArray[np.float64]:
        """Returns an indicator over the wear states, NaN for states without it."""

    def mesh(self, state: int) -> dict[str, list[float]]:
        """Returns the mesh stiffness and transmission error of one state."""

    def __len__(self) -> int: ...

class Ensemble:
    """The described pair and variations of it, any of which may be the machine's."""

    @staticmethod
    def build(
        library: Library, *, members: int = 1280, progress: Callable[[int, int], object] | None = None
    ) -> Ensemble:
        """Simulates the members on all cores; ``progress`` and Ctrl-C work as in :meth:`Library.build`."""

    @staticmethod
    def load(path: _Path, library: Library) -> Ensemble:
        """Loads the ensemble of a library from a file."""

    def save(self, path: _Path) -> None:
        """Writes the ensemble to a file."""

    @property
    def id(self) -> str: ...
    @property
    def library(self) -> Library: ...
    def __len__(self) -> int: ...

class Tracker:
    """Estimates the wear of one measuring channel, record by record in time order.

    Args:
        library: a library, or an ensemble for an estimate that includes the uncertainty of the pair.
        teeth, nominal_shaft_speed_hz: default to those of the library's pair.
        tolerance: search range of the speed around nominal, as a fraction.
        baseline_records: number of records in the healthy baseline, at least 8.
        limit_um: wear depth in µm for which the prognosis is made.
        unit: unit of the samples.
    """

    def __new__(
        cls,
        library: Library | Ensemble | None = None,
        *,
        teeth: int | None = None,
        nominal_shaft_speed_hz: float | None = None,
        tolerance: float = 0.05,
        baseline_records: int = 20,
        limit_um: float | None = None,
        unit: str = "m/s2",
    ) -> Tracker: ...
    def update(
        self,
        x: ArrayLike,
        rate_hz: float,
        time: _Time,
        *,
        shaft_speed_hz: float | None = None,
        torque_nm: float | None = None,
        pulse_times_s: ArrayLike | None = None,
        pulses_per_revolution: int = 1,
    ) -> dict[str, Any]:
        """Adds a record; returns ``time``, ``indicators``, ``absent``, ``shaft_speed`` and ``wear``."""

    def maintenance(
        self, kind: str, time: _Time, *, inspection: dict[str, Any] | None = None, until: _Time | None = None
    ) -> None:
        """Adds maintenance between two records; kinds are those of the HTTP API."""

    @property
    def state(self) -> str:
        """The state after the records so far, as JSON."""

    def restore(self, state: str) -> None:
        """Replaces the state."""

    def save(self, path: _Path) -> None:
        """Writes the state to a file."""

    def load(self, path: _Path) -> None:
        """Replaces the state with that of a file."""

def condition(
    x: ArrayLike,
    rate_hz: float,
    *,
    teeth: int | None = None,
    shaft_speed_hz: float | None = None,
    nominal_shaft_speed_hz: float | None = None,
    tolerance: float = 0.05,
    torque_nm: float | None = None,
    pulse_times_s: ArrayLike | None = None,
    pulses_per_revolution: int = 1,
    unit: str = "1",
    bands: list[dict[str, Any]] | None = None,
    gear_indicators: bool = True,
) -> dict[str, Any]: ...
def amplitude_spectrum(x: ArrayLike, rate_hz: float, *, unit: str = "1") -> Spectrum:
    """Computes the Hann amplitude (peak) spectrum of samples of shape ``(n,)``."""

def power_spectral_density(x: ArrayLike, rate_hz: float, *, unit: str = "1") -> Spectrum:
    """Computes the power spectral density, as SciPy's ``periodogram`` with a Hann window."""

def envelope_spectrum(
    x: ArrayLike,
    rate_hz: float,
    *,
    band_hz: Sequence[float] | None = None,
    search: Literal["mesh_harmonic", "kurtogram"] = "mesh_harmonic",
    teeth: int | None = None,
    shaft_speed_hz: float | None = None,
    nominal_shaft_speed_hz: float | None = None,
    tolerance: float = 0.05,
    unit: str = "1",
) -> EnvelopeSpectrum:
    """Computes the envelope spectrum of a band in hertz, or of the band that ``search`` finds."""

def kurtogram(x: ArrayLike, rate_hz: float) -> Kurtogram:
    """Computes the fast kurtogram."""

def cepstrum(x: ArrayLike, rate_hz: float) -> Cepstrum:
    """Computes the real cepstrum."""

def angle_record(
    x: ArrayLike,
    rate_hz: float,
    *,
    teeth: int,
    shaft_speed_hz: float | None = None,
    nominal_shaft_speed_hz: float | None = None,
    tolerance: float = 0.05,
    pulse_times_s: ArrayLike | None = None,
    pulses_per_revolution: int = 1,
    unit: str = "1",
) -> AngleRecord:
    """Resamples the record over the angle of its shaft.

    The angle comes from a tachometer, else from the phase of a mesh line, else from a constant speed.

    Raises:
        ValueError: if there is no speed, or fewer than 4 whole turns.
    """

def order_spectrum(
    x: ArrayLike,
    rate_hz: float,
    *,
    teeth: int,
    shaft_speed_hz: float | None = None,
    nominal_shaft_speed_hz: float | None = None,
    tolerance: float = 0.05,
    pulse_times_s: ArrayLike | None = None,
    pulses_per_revolution: int = 1,
    unit: str = "1",
) -> OrderSpectrum:
    """Computes the amplitude spectrum over orders of the shaft; arguments as for :func:`angle_record`."""

def gear_signals(
    x: ArrayLike,
    rate_hz: float,
    *,
    teeth: int,
    shaft_speed_hz: float | None = None,
    nominal_shaft_speed_hz: float | None = None,
    tolerance: float = 0.05,
    pulse_times_s: ArrayLike | None = None,
    pulses_per_revolution: int = 1,
    unit: str = "1",
) -> GearSignals:
    """Computes the synchronous average, its regular, residual and difference signals, and the mesh envelope."""
