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

    The arrays have shape ``(n // 2 + 1,)`` for the n samples used.
    """

    @property
    def quantity(self) -> str:
        """``"amplitude_peak"`` or ``"psd"``."""

    @property
    def unit(self) -> str:
        """Unit of ``amplitude``."""

    @property
    def window(self) -> str:
        """Name of the window."""

    @property
    def bandwidth_hz(self) -> float:
        """Equivalent noise bandwidth of a bin in Hz."""

    @property
    def resolution_hz(self) -> float:
        """Distance of two bins in Hz."""

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Frequencies of the bins in Hz, shape ``(n // 2 + 1,)``."""

    @property
    def amplitude(self) -> NDArray[np.float64]:
        """Values of the bins in ``unit``, shape ``(n // 2 + 1,)``."""

class EnvelopeSpectrum:
    """The amplitude spectrum of a band's envelope, and how the band was chosen."""

    @property
    def unit(self) -> str:
        """Unit of ``amplitude``: that of the samples."""

    @property
    def band_hz(self) -> list[float]:
        """Lower and upper edge of the band in Hz."""

    @property
    def band_source(self) -> str:
        """How the band was chosen: ``"query"``, ``"strongest_mesh_harmonic"``, ``"kurtogram"``, …"""

    @property
    def spectral_kurtosis(self) -> float | None:
        """Spectral kurtosis of the band, 0 in noise; ``None`` unless the kurtogram chose the band."""

    @property
    def bandwidth_hz(self) -> float:
        """Equivalent noise bandwidth of a bin in Hz."""

    @property
    def resolution_hz(self) -> float:
        """Distance of two bins in Hz."""

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Frequencies of the bins in Hz, shape ``(bins,)``."""

    @property
    def amplitude(self) -> NDArray[np.float64]:
        """Peak amplitudes in ``unit``, shape ``(bins,)``."""

class Kurtogram:
    """Spectral kurtosis at several divisions of the spectrum.

    ``bandwidth_hz[i]`` and ``kurtosis[i]`` belong to division i.
    """

    @property
    def bandwidth_hz(self) -> list[float]:
        """Width of a division's bands in Hz."""

    @property
    def kurtosis(self) -> list[NDArray[np.float64]]:
        """Spectral kurtosis of each division's bands in ascending frequency, each of shape ``(bands,)``."""

    @property
    def best_band_hz(self) -> list[float]:
        """Edges of the band of the highest spectral kurtosis in Hz."""

    @property
    def best_kurtosis(self) -> float:
        """The highest spectral kurtosis, 0 in noise."""

class Cepstrum:
    """The real cepstrum over quefrency, up to half the record's length."""

    @property
    def resolution_s(self) -> float:
        """Distance of two values in seconds."""

    @property
    def quefrency_s(self) -> NDArray[np.float64]:
        """Quefrencies in seconds, shape ``(n // 2 + 1,)``."""

    @property
    def value(self) -> NDArray[np.float64]:
        """Cepstrum without a unit, shape ``(n // 2 + 1,)``."""

class AngleRecord:
    """A record resampled over whole turns of the shaft, at equal steps of its angle."""

    @property
    def unit(self) -> str:
        """Unit of the samples."""

    @property
    def samples(self) -> NDArray[np.float64]:
        """Samples in ``unit``, shape ``(turns, samples_per_turn)``."""

    @property
    def synchronous_average(self) -> NDArray[np.float64]:
        """Mean over all turns in ``unit``, shape ``(samples_per_turn,)``."""

    @property
    def angle(self) -> dict[str, Any]:
        """A dict of the source of the shaft's angle and its accuracy."""

class OrderSpectrum:
    """The Hann amplitude spectrum over orders of the shaft."""

    @property
    def unit(self) -> str:
        """Unit of ``amplitude``: that of the samples."""

    @property
    def resolution_orders(self) -> float:
        """Distance of two bins in orders."""

    @property
    def bandwidth_orders(self) -> float:
        """Equivalent noise bandwidth of a bin in orders."""

    @property
    def order(self) -> NDArray[np.float64]:
        """Orders of the bins, shape ``(bins,)``; 1 is once a turn."""

    @property
    def amplitude(self) -> NDArray[np.float64]:
        """Peak amplitudes in ``unit``, shape ``(bins,)``."""

    @property
    def angle(self) -> dict[str, Any]:
        """A dict of the source of the shaft's angle and its accuracy."""

class GearSignals:
    """The synchronous average and its parts, each of shape ``(samples_per_turn,)`` in the samples' unit."""

    @property
    def average(self) -> NDArray[np.float64]:
        """The synchronous average without its mean, shape ``(samples_per_turn,)``."""

    @property
    def regular(self) -> NDArray[np.float64]:
        """Its orders 1 and 2 and its mesh harmonics, shape ``(samples_per_turn,)``."""

    @property
    def residual(self) -> NDArray[np.float64]:
        """The average without the regular signal, shape ``(samples_per_turn,)``."""

    @property
    def difference(self) -> NDArray[np.float64]:
        """The residual without the first sidebands of every mesh harmonic, shape ``(samples_per_turn,)``."""

    @property
    def mesh_envelope(self) -> NDArray[np.float64]:
        """Envelope of the orders within 6 of the mesh order, without its mean, shape ``(samples_per_turn,)``.
        """

class MeshCycle:
    """One mesh period over the rotation φ₁ of the driving gear."""

    @property
    def phi1_rad(self) -> NDArray[np.float64]:
        """Rotation of the driving gear in rad, shape ``(points,)``."""

    @property
    def phi2_rad(self) -> NDArray[np.float64]:
        """Rotation of the driven gear in rad, shape ``(points,)``."""

    @property
    def stiffness_n_per_m(self) -> NDArray[np.float64]:
        """Mesh stiffness in N/m, shape ``(points,)``."""

    @property
    def uste_rad(self) -> NDArray[np.float64]:
        """Unloaded static transmission error in rad, shape ``(points,)``."""

    @property
    def pairs_in_contact(self) -> NDArray[np.uint32]:
        """Number of tooth pairs in contact, shape ``(points,)``."""

    @property
    def mean_stiffness_n_per_m(self) -> float:
        """Mean of the mesh stiffness in N/m."""

class ToothContact:
    """Contact points and rotations of one pair of teeth, from the start to the end of its contact."""

    @property
    def alpha1_rad(self) -> NDArray[np.float64]:
        """Angle α₁ of the point of contact on the driving flank in rad, shape ``(601,)``."""

    @property
    def alpha1_prime_rad(self) -> NDArray[np.float64]:
        """The same angle α₁′ on the driven flank in rad, shape ``(601,)``."""

    @property
    def phi1_rad(self) -> NDArray[np.float64]:
        """Rotation φ₁ of the driving gear in rad, shape ``(601,)``."""

    @property
    def phi2_rad(self) -> NDArray[np.float64]:
        """Rotation φ₂ of the driven gear in rad, shape ``(601,)``."""

class Flank:
    """One flank from the start of active profile to the tip."""

    @property
    def radius_mm(self) -> NDArray[np.float64]:
        """Radius in mm, shape ``(points,)``."""

    @property
    def depth_um(self) -> NDArray[np.float64]:
        """Wear depth in µm, shape ``(points,)``."""

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """Coordinate x of the worn flank in mm, shape ``(points,)``."""

    @property
    def y_mm(self) -> NDArray[np.float64]:
        """Coordinate y of the worn flank in mm, shape ``(points,)``."""

class Simulation:
    """A simulated vibration with its wear, speed and torque."""

    @property
    def samples(self) -> NDArray[np.float64]:
        """Acceleration in m/s², shape ``(rate_hz × seconds,)``."""

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""

    @property
    def unit(self) -> str:
        """Unit of the samples, ``"m/s2"``."""

    @property
    def wear_um(self) -> float:
        """Greatest wear depth in µm."""

    @property
    def shaft_speed_hz(self) -> float:
        """Rotational frequency of the driving shaft in Hz."""

    @property
    def torque_nm(self) -> float:
        """Torque on the driving shaft in N·m."""

    @property
    def mesh(self) -> MeshCycle:
        """The mesh period that excites the vibration."""

class Pair:
    """A pair of spur gears, described as in a pair file.

    Wear is given in one of three ways: ``wear_um``, the greatest depth in µm with the pair's own wear shape;
    ``profile``, a table of gear, radius in mm and depth in µm, of shape ``(n, 3)`` or as CSV; or ``turns`` of
    the driving gear, which wear it by Archard's law.
    """

    @staticmethod
    def from_toml(text: str) -> Pair:
        """Returns the pair that the text of a pair file describes.

        Raises:
            ValueError: if it is not a pair file, or the pair is outside the model's range.
        """

    @staticmethod
    def from_file(path: _Path) -> Pair:
        """Returns the pair of a pair file.

        Raises:
            OSError: if the file cannot be read.
            ValueError: as in :meth:`from_toml`.
        """

    @staticmethod
    def from_dict(description: dict[str, Any]) -> Pair:
        """Returns the pair that the tables of a pair file describe.

        Raises:
            ValueError: as in :meth:`from_toml`.
        """

    @staticmethod
    def shen2022() -> Pair:
        """Returns the pair of Shen et al. 2022, Table 1."""

    def to_dict(self) -> dict[str, Any]:
        """Returns the description including all defaults, as the tables of a pair file."""

    @property
    def name(self) -> str:
        """Name of the pair."""

    @property
    def teeth(self) -> tuple[int, int]:
        """Teeth of the driving and of the driven gear."""

    @property
    def shaft_speed_hz(self) -> float:
        """Rotational frequency of the driving shaft in Hz."""

    @property
    def torque_nm(self) -> float:
        """Torque on the driving shaft in N·m."""

    @property
    def contact_ratio(self) -> float:
        """Mean number of tooth pairs in contact."""

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
        """Computes mesh stiffness and transmission error over one mesh period.

        Args:
            wear_um: greatest wear depth in µm, with the pair's own wear shape.
            profile: wear table of gear, radius in mm and depth in µm, shape ``(n, 3)``, or its CSV text.
            turns: turns of the driving gear, which wear it by Archard's law.
            torque_nm: torque on the driving shaft in N·m, instead of the pair's.
            contact: rule for the pairs in contact: ``"threshold"`` (the paper's) or ``"loaded"`` (elastic
                load
                sharing), instead of the pair's.
            points: number of rotations.

        Raises:
            ValueError: if the wear or torque is outside the model's range, or an argument is invalid.
        """

    def tooth_contact(
        self,
        wear_um: float | None = None,
        *,
        profile: str | ArrayLike | None = None,
        turns: float | None = None,
    ) -> ToothContact:
        """Computes the contact of one pair of teeth, at 601 points.

        Args:
            wear_um: greatest wear depth in µm, with the pair's own wear shape.
            profile: wear table of gear, radius in mm and depth in µm, shape ``(n, 3)``, or its CSV text.
            turns: turns of the driving gear, which wear it by Archard's law.

        Raises:
            ValueError: if the wear is outside the model's range.
        """

    def flank(
        self,
        gear: int,
        wear_um: float | None = None,
        *,
        profile: str | ArrayLike | None = None,
        turns: float | None = None,
        points: int = 201,
    ) -> Flank:
        """Returns the working flank of one gear.

        Args:
            gear: 1 for the driving gear, 2 for the driven one.
            wear_um: greatest wear depth in µm, with the pair's own wear shape.
            profile: wear table of gear, radius in mm and depth in µm, shape ``(n, 3)``, or its CSV text.
            turns: turns of the driving gear, which wear it by Archard's law.
            points: number of points from the start of active profile to the tip.

        Raises:
            ValueError: if the wear is outside the model's range, or an argument is invalid.
        """

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
        """Simulates the vibration of the worn pair.

        Args:
            rate_hz: sampling rate in hertz.
            seconds: length in seconds.
            wear_um: greatest wear depth in µm, with the pair's own wear shape.
            profile: wear table of gear, radius in mm and depth in µm, shape ``(n, 3)``, or its CSV text.
            turns: turns of the driving gear, which wear it by Archard's law.
            shaft_speed_hz: rotational frequency of the driving shaft in hertz, instead of the pair's.
            torque_nm: torque on the driving shaft in N·m, instead of the pair's.
            contact: rule for the pairs in contact, as in :meth:`mesh`.
            seed: seed of the random part; the same seed gives the same samples.
            start_phase_turns: angle of the driving shaft at the first sample, in turns.

        Raises:
            ValueError: if an argument is outside the model's range.
        """

class SimulatedRecord:
    """One record of a simulated run, with the true wear."""

    @property
    def samples(self) -> NDArray[np.float32]:
        """Samples in ``unit``, shape ``(n,)``."""

    @property
    def rate_hz(self) -> float:
        """Sampling rate in Hz."""

    @property
    def unit(self) -> str:
        """Unit of the samples."""

    @property
    def time(self) -> str:
        """Time of the first sample, RFC 3339."""

    @property
    def torque_nm(self) -> float | None:
        """Torque on the driving shaft in N·m."""

    @property
    def wear_um(self) -> float:
        """True greatest wear depth in µm."""

class Run:
    """A simulated run to failure through a random transmission path, as a sequence of records.

    Args:
        pair: the pair.
        records: number of records.
        seconds: length of a record in seconds.
        rate_hz: sampling rate in hertz.
        max_wear_um: greatest wear depth of the last record in µm; by default the usual one of the pair.
        wear_exponent: power of time with which the wear grows.
        snr_db: ratio of the healthy vibration's RMS to the sensor noise in dB.
        speed_variation: the speed of each record lies within this fraction of nominal.
        torque_variation: the torque of each record lies within this fraction of nominal.
        start_time: time of the first record; by default the start of 2026.
        interval_s: seconds from one record's start to the next one's.
        seed: seed of the random part; the same seed gives the same run.

    Raises:
        ValueError: if an argument is out of range.
    """

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

        Args:
            pair: the pair.
            states: number of wear states, from none to the greatest.
            max_wear_um: greatest wear depth in µm; by default the usual one of the pair.
            seconds: length of a simulation in seconds.
            rate_hz: sampling rate in hertz.
            torque_factors: torques of the states, as factors of the pair's torque.
            speed_factors: shaft speeds of the states, as factors of the pair's speed.
            seed: seed of the random part; the same seed gives the same library.
            progress: called with the numbers of finished and of all simulations. Ctrl-C, or an exception in
                it,
                stops the build and is raised.

        Raises:
            ValueError: if an argument is out of range.
        """

    @staticmethod
    def load(path: _Path) -> Library:
        """Loads a library from a file.

        Raises:
            OSError: if the file cannot be read.
            ValueError: if it is not a library file, or damaged.
        """

    def save(self, path: _Path) -> None:
        """Writes the library to a file; ``flankwatch analyze`` reads ``DATA/libraries/`` + ``file_name``.

        Raises:
            OSError: if the file cannot be written.
        """

    @property
    def id(self) -> str:
        """Identifier, a hash of all settings."""

    @property
    def file_name(self) -> str:
        """Name of the file in which the program looks for the library."""

    @property
    def pair(self) -> Pair:
        """The pair."""

    @property
    def wear_um(self) -> NDArray[np.float64]:
        """Greatest wear depth of each state in µm, shape ``(states,)``."""

    @property
    def indicator_names(self) -> list[str]:
        """Names of the indicators of the states."""

    def indicator(self, name: str) -> NDArray[np.float64]:
        """Returns an indicator over the wear states, shape ``(states,)``, NaN for states without it.

        Raises:
            ValueError: if there is no such indicator.
        """

    def mesh(self, state: int) -> dict[str, list[float]]:
        """Returns the mesh cycle of one state, a dict of lists with units in their names.

        Raises:
            ValueError: if there is no such state.
        """

    def __len__(self) -> int: ...

class Ensemble:
    """The described pair and variations of it, any of which may be the machine's."""

    @staticmethod
    def build(
        library: Library, *, members: int = 1280, progress: Callable[[int, int], object] | None = None
    ) -> Ensemble:
        """Simulates the members on all cores.

        Args:
            library: library of the described pair.
            members: number of variations.
            progress: as in :meth:`Library.build`.

        Raises:
            ValueError: if there are too many members.
        """

    @staticmethod
    def load(path: _Path, library: Library) -> Ensemble:
        """Loads the ensemble of a library from a file.

        Raises:
            OSError: if the file cannot be read.
            ValueError: if it is damaged, or belongs to another library.
        """

    def save(self, path: _Path) -> None:
        """Writes the ensemble to a file.

        Raises:
            OSError: if the file cannot be written.
        """

    @property
    def id(self) -> str:
        """Identifier, a hash of all settings."""

    @property
    def library(self) -> Library:
        """Library of the described pair."""

    def __len__(self) -> int: ...

class Tracker:
    """Estimates the wear of one measuring channel, record by record in time order.

    Args:
        library: a library, or an ensemble for an estimate that includes the uncertainty of the pair.
        teeth: teeth of the driving gear; by default those of the library's pair.
        nominal_shaft_speed_hz: nominal speed in hertz; by default that of the library's pair.
        tolerance: search range of the speed around nominal, as a fraction.
        baseline_records: number of records in the healthy baseline, at least 8.
        limit_um: wear depth in µm for which the prognosis is made.
        unit: unit of the samples.

    Raises:
        ValueError: if an argument is out of range, or neither a library nor teeth and speed are given.
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
        """Adds a record.

        Args:
            x: samples, shape ``(n,)``, in the tracker's unit.
            rate_hz: sampling rate in hertz.
            time: time of the first sample, later than that of the record before.
            shaft_speed_hz: rotational frequency of the driving shaft in hertz, if it is known.
            torque_nm: torque on the driving shaft in N·m, if it is known.
            pulse_times_s: times of a tachometer's pulses in seconds after the first sample, shape
                ``(pulses,)``.
            pulses_per_revolution: pulses per turn of the shaft.

        Returns:
            A dict of ``time``, ``indicators``, ``absent`` (reasons by name), ``shaft_speed`` and ``wear``,
                the
            estimate in µm.

        Raises:
            ValueError: if samples are not finite or not of shape ``(n,)``, or an argument is out of range.
        """

    def maintenance(
        self, kind: str, time: _Time, *, inspection: dict[str, Any] | None = None, until: _Time | None = None
    ) -> None:
        """Adds maintenance between two records.

        Args:
            kind: ``"gear_replaced"``, ``"inspected"`` or another kind of the HTTP API.
            time: its time.
            inspection: what an inspection found, such as ``{"depth_um": 80}``.
            until: its end, for kinds that last.

        Raises:
            ValueError: if the kind does not exist, or a value is out of range.
        """

    @property
    def state(self) -> str:
        """The state after the records so far, as JSON."""

    def restore(self, state: str) -> None:
        """Replaces the state.

        Raises:
            ValueError: if the text is not a tracker's state, or one of a library with another number of
                members.
        """

    def save(self, path: _Path) -> None:
        """Writes the state to a file. A reader sees the old state or the new one.

        Raises:
            OSError: if the file cannot be written.
        """

    def load(self, path: _Path) -> None:
        """Replaces the state with that of a file.

        Raises:
            OSError: if the file cannot be read.
            ValueError: if it is not a tracker's state, or one of a library with another number of members.
        """

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
) -> dict[str, Any]:
    """Returns indicators and how they were computed, as a dict; :func:`flankwatch.indicators` describes it.

    ``x`` has shape ``(n,)`` and is in ``unit``; ``pulse_times_s`` has shape ``(pulses,)`` and is in seconds.

    Raises:
        ValueError: if samples are not finite or not of shape ``(n,)``, or an argument is out of range.
    """

def read_frames(
    path: _Path,
    *,
    channels: Sequence[str] = ...,
    rate_hz: float | None = None,
    start_time: _Time | None = None,
    samples: bool = True,
) -> dict[str, Any]:
    """Reads a WAV or CSV file (also compressed with gzip) as the program does.

    Returns a dict of ``channels`` (names), ``units`` (by channel), ``rate_hz`` (or ``None``), ``start_time``,
    ``states`` (what the file states of its start: ``"date"``, ``"time of day"`` or ``"nothing"``), ``frames``
    (the number of samples per channel) and ``samples`` (one array of shape ``(frames,)`` per channel, in
    single precision; none if ``samples`` is false).

    Raises:
        OSError: if the file cannot be opened.
        ValueError: if it is damaged, or its times contradict the rate.
    """

def amplitude_spectrum(x: ArrayLike, rate_hz: float, *, unit: str = "1") -> Spectrum:
    """Computes the Hann amplitude (peak) spectrum.

    Args:
        x: samples, shape ``(n,)``, in ``unit``.
        rate_hz: sampling rate in hertz.
        unit: unit of the samples.

    Raises:
        ValueError: if samples are not finite or not of shape ``(n,)``, or an argument is out of range.
    """

def power_spectral_density(x: ArrayLike, rate_hz: float, *, unit: str = "1") -> Spectrum:
    """Computes the power spectral density, as SciPy's ``periodogram`` with a Hann window.

    Args:
        x: samples, shape ``(n,)``, in ``unit``.
        rate_hz: sampling rate in hertz.
        unit: unit of the samples.

    Raises:
        ValueError: if samples are not finite or not of shape ``(n,)``, or an argument is out of range.
    """

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
    """Computes the envelope spectrum of a band.

    Args:
        x: samples, shape ``(n,)``, in ``unit``.
        rate_hz: sampling rate in hertz.
        band_hz: edges of the band in hertz; by default the band that ``search`` finds.
        search: ``"mesh_harmonic"`` for the band around the strongest mesh harmonic, ``"kurtogram"`` for the
            band
            of the highest spectral kurtosis.
        teeth: teeth of the gear on the shaft; without it there is no mesh harmonic.
        shaft_speed_hz: rotational frequency of that shaft in hertz, if it is known.
        nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not known.
        tolerance: search range around nominal, as a fraction.
        unit: unit of the samples.

    Raises:
        ValueError: if the band is outside the spectrum, samples are not finite or not of shape ``(n,)``, or
            an
            argument is out of range.
    """

def kurtogram(x: ArrayLike, rate_hz: float) -> Kurtogram:
    """Computes the fast kurtogram.

    Args:
        x: samples, shape ``(n,)``.
        rate_hz: sampling rate in hertz.

    Raises:
        ValueError: if the record is too short or constant, or samples are not finite or not of shape
            ``(n,)``.
    """

def cepstrum(x: ArrayLike, rate_hz: float) -> Cepstrum:
    """Computes the real cepstrum.

    Args:
        x: samples, shape ``(n,)``.
        rate_hz: sampling rate in hertz.

    Raises:
        ValueError: if the record is too short or constant, or samples are not finite or not of shape
            ``(n,)``.
    """

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

    Args:
        x: samples, shape ``(n,)``, in ``unit``.
        rate_hz: sampling rate in hertz.
        teeth: teeth of the gear on the shaft.
        shaft_speed_hz: rotational frequency of that shaft in hertz, if it is known.
        nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not known.
        tolerance: search range around nominal, as a fraction.
        pulse_times_s: times of a tachometer's pulses in seconds after the first sample, shape ``(pulses,)``.
        pulses_per_revolution: pulses per turn of the shaft.
        unit: unit of the samples.

    Raises:
        ValueError: if there is no speed, the record has fewer than 4 whole turns, or an argument is out of
            range.
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
    """Computes the amplitude spectrum over orders of the shaft.

    Args:
        x: samples, shape ``(n,)``, in ``unit``.
        rate_hz: sampling rate in hertz.
        teeth: teeth of the gear on the shaft.
        shaft_speed_hz: rotational frequency of that shaft in hertz, if it is known.
        nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not known.
        tolerance: search range around nominal, as a fraction.
        pulse_times_s: times of a tachometer's pulses in seconds after the first sample, shape ``(pulses,)``.
        pulses_per_revolution: pulses per turn of the shaft.
        unit: unit of the samples.

    Raises:
        ValueError: as in :func:`angle_record`.
    """

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
    """Computes the synchronous average, its regular, residual and difference signals, and the mesh envelope.

    Args:
        x: samples, shape ``(n,)``, in ``unit``.
        rate_hz: sampling rate in hertz.
        teeth: teeth of the gear on the shaft.
        shaft_speed_hz: rotational frequency of that shaft in hertz, if it is known.
        nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not known.
        tolerance: search range around nominal, as a fraction.
        pulse_times_s: times of a tachometer's pulses in seconds after the first sample, shape ``(pulses,)``.
        pulses_per_revolution: pulses per turn of the shaft.
        unit: unit of the samples.

    Raises:
        ValueError: as in :func:`angle_record`.
    """
