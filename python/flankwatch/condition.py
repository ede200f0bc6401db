"""Condition indicators of one record, by name."""

from __future__ import annotations

from typing import Any, Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _flankwatch


class Indicators(dict[str, float]):
    """Indicators by name, with the shaft speed and mesh lines they are based on.

    Attributes:
        absent: reasons why indicators could not be computed, by name.
        shaft_speed_hz: rotational frequency of the shaft in hertz; ``None`` if it is neither given nor found.
        shaft_speed_source: ``"record"``, ``"tachometer"``, ``"asset"`` or ``"mesh_comb"``.
        mesh_frequency_hz: teeth times shaft speed in hertz.
        mesh_lines: order, frequency in hertz and peak amplitude of each detected mesh harmonic.
        basis: identifier of the method, the quality of the samples, and the source of the shaft's angle.
    """

    absent: dict[str, str]
    shaft_speed_hz: float | None
    shaft_speed_source: str | None
    mesh_frequency_hz: float | None
    mesh_lines: list[tuple[int, float, float]]
    basis: dict[str, Any]


def indicators(
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
    bands: Iterable[Mapping[str, Any]] | None = None,
    gear_indicators: bool = True,
) -> Indicators:
    """Computes the condition indicators that the service stores for a record.

    Args:
        x: samples, shape ``(n,)``, in ``unit``; single precision is not converted.
        rate_hz: sampling rate in hertz.
        teeth: teeth of the gear on the shaft; without it only indicators that need no mesh are computed.
        shaft_speed_hz: rotational frequency of that shaft in hertz.
        nominal_shaft_speed_hz: centre of the search for the speed in hertz, if it is not given.
        tolerance: search range around nominal, as a fraction.
        torque_nm: torque on the shaft in N·m.
        pulse_times_s: times of a tachometer's pulses in seconds after the first sample.
        pulses_per_revolution: pulses per turn of the shaft.
        unit: unit of the samples, for example ``"m/s2"`` or ``"g"``.
        bands: bands whose root mean square becomes the indicator ``band_NAME``, each with ``name``,
            ``band_hz`` and ``quantity`` (``"record"`` or ``"velocity"``).
        gear_indicators: whether to compute the indicators over the shaft's angle (FM0, FM4, …).

    Raises:
        ValueError: if samples are not finite or not one-dimensional, or an argument is out of range.
    """
    result = _flankwatch.condition(
        x,
        rate_hz,
        teeth=teeth,
        shaft_speed_hz=shaft_speed_hz,
        nominal_shaft_speed_hz=nominal_shaft_speed_hz,
        tolerance=tolerance,
        torque_nm=torque_nm,
        pulse_times_s=pulse_times_s,
        pulses_per_revolution=pulses_per_revolution,
        unit=unit,
        bands=None if bands is None else [dict(band) for band in bands],
        gear_indicators=gear_indicators,
    )
    values = Indicators(result["indicators"])
    speed = result["shaft_speed"] or {}
    values.absent = result["absent"]
    values.shaft_speed_hz = speed.get("shaft_speed_hz")
    values.shaft_speed_source = speed.get("source")
    values.mesh_frequency_hz = speed.get("mesh_frequency_hz") or None
    values.mesh_lines = result["mesh_lines"]
    values.basis = result["basis"]
    return values


def synchronous_average(x: ArrayLike, rate_hz: float, *, teeth: int, **machine: Any) -> NDArray[np.float64]:
    """Computes the mean over all turns of the shaft, shape ``(samples_per_turn,)``, in the samples' unit.

    Arguments and errors are those of :func:`flankwatch.angle_record`.
    """
    return _flankwatch.angle_record(x, rate_hz, teeth=teeth, **machine).synchronous_average
