"""What an upload of a file sends: the file unchanged, or its channels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Mapping

import numpy as np

from .reading import csv
from .reading.audio import check_rate
from .reading.detect import MCAP, detect
from .reading.guess import Content, Overrides
from .recording import Channel, Recording, RecordingError, argument_error

#: Media types of the formats that the service reads itself.
MEDIA_TYPES = {"wav": "audio/wav", "csv": "text/csv", "mcap": "application/mcap"}

#: Units of samples that a sensitivity converts, in volts; samples of an unknown unit are in volts.
VOLTS = {None: 1.0, "V": 1.0, "1": 1.0, "mV": 1e-3}


def format_of(path: Path) -> str:
    """Returns the format of a file: a key of :data:`MEDIA_TYPES`, or that of :func:`flankwatch.read`."""
    with path.open("rb") as file:
        beginning = file.read(8)
    if beginning == MCAP:
        return "mcap"
    if beginning[:4] in (b"RIFF", b"RIFX", b"RF64", b"BW64"):
        return "wav"
    return detect(path)


def check_mcap(path: Path, arguments: Mapping[str, Any]) -> None:
    """Refuses arguments for an MCAP recording."""
    given = next((name for name, value in arguments.items() if value is not None), None)
    if given is not None:
        expected = "none: an MCAP recording contains it for each record"
        raise argument_error(path, given, repr(arguments[given]), expected)


def header(path: Path, rate_hz: float | None = None) -> dict[str, Any]:
    """Returns rate, number of samples per channel and stated time of a WAV or CSV file."""
    is_wav = format_of(path) == "wav"
    # A given rate would override that of a WAV header.
    found = csv.frames(path, Overrides(rate_hz=None if is_wav else rate_hz), samples=False)
    if is_wav:
        check_rate(path, Content(common={"fs": found["rate_hz"]}), rate_hz)
    return found


def start_time(path: Path, rate_hz: float | None, earliest: str) -> str:
    """Returns the start of a CSV file: its own, with the day from ``earliest`` on if it states no date."""
    found = csv.frames(path, Overrides(rate_hz=rate_hz, start_time=earliest), samples=False)
    return str(found["start_time"])


def scale_factor(scale: float | None, sensitivity_mv_per_g: float | None) -> float:
    """Returns the factor of the samples, from a scale to volts and a sensitivity in mV/g."""
    factor = 1.0
    if scale is not None:
        if not np.isfinite(scale) or scale == 0:
            raise ValueError(f"scale is {scale}, expected a finite number other than 0")
        factor = scale
    if sensitivity_mv_per_g is not None:
        if not (np.isfinite(sensitivity_mv_per_g) and sensitivity_mv_per_g > 0):
            raise ValueError(
                f"sensitivity_mv_per_g is {sensitivity_mv_per_g}, expected a finite number above 0"
            )
        factor = factor * 1000.0 / sensitivity_mv_per_g
    return factor


def scaled(recording: Recording, scale: float | None, sensitivity_mv_per_g: float | None) -> Recording:
    """Returns the recording with scaled samples, in g if a sensitivity is given."""
    factor = scale_factor(scale, sensitivity_mv_per_g)
    if scale is None and sensitivity_mv_per_g is None:
        return recording
    channels = []
    for channel in recording:
        unit, own = channel.unit, 1.0
        if sensitivity_mv_per_g is not None:
            if unit not in VOLTS:
                expected = f"none: channel {channel.name!r} is in {unit!r}, not in volts or mV"
                raise argument_error(recording.path, "sensitivity_mv_per_g", sensitivity_mv_per_g, expected)
            unit, own = "g", VOLTS[unit]
        samples = channel.samples.astype(np.float64) * (factor * own)
        channels.append(replace(channel, samples=samples, unit=unit))
    return replace(recording, channels=channels)


def groups(recording: Recording) -> list[list[Channel]]:
    """Returns the channels that are sent together: those of the same rate, unit, start and length."""
    found: dict[tuple[Any, ...], list[Channel]] = {}
    for channel in recording:
        if channel.rate_hz is None:
            raise RecordingError(
                recording.path, f"channel {channel.name!r} has no sampling rate, expected rate_hz", "rate_hz"
            )
        key = (channel.rate_hz, channel.unit, str(channel.start_time), channel.samples.size)
        found.setdefault(key, []).append(channel)
    return list(found.values())
