"""Channels, rate, units and time of a file's arrays, from its metadata or from usual names."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np

from ..recording import Channel, RecordingError

#: Maximum relative difference of a rate from the time column.
RATE_TOLERANCE = 1e-3

RATE_NAMES = {
    "fs",
    "sr",
    "rate",
    "samplerate",
    "samplingrate",
    "samplingfrequency",
    "samplefrequency",
    "sampfreq",
    "fsample",
}
INTERVAL_NAMES = {"dt", "ts", "increment", "wfincrement", "sampleinterval", "samplinginterval", "deltat"}
START_NAMES = {"starttime", "wfstarttime", "start", "t0", "date", "datetime", "recordedat", "measurementtime"}
UNIT_NAMES = {"unit", "units", "unitstring", "yunit", "unitdescription"}
TIME_NAMES = {"t", "time", "zeit", "timestamp", "timevector", "tid", "temps"}
#: Units in parentheses, in lower case. Other text there, such as a direction (V) or a number (1), is part of
#: a name.
UNITS_IN_PARENTHESES = {
    *("m/s2", "m/s^2", "m/s**2", "m/s²", "m/sec2", "m/sec^2", "mm/s2", "mm/s^2", "mm/s²", "g", "mg"),
    *("m/s", "m/sec", "mm/s", "mm/sec", "in/s", "in/sec", "ips", "mm", "um", "µm", "μm", "mv"),
    *("sec", "seconds", "ms", "us", "µs", "ns", "rpm", "hz", "khz", "nm", "pa", "kpa", "bar", "degc", "°c"),
}
TIME_UNITS = {"": 1.0, "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}


@dataclass
class Content:
    """The content of a file: arrays by name, metadata of each array, and metadata common to all."""

    arrays: dict[str, np.ndarray[Any, Any]] = field(default_factory=dict)
    attributes: dict[str, dict[str, Any]] = field(default_factory=dict)
    common: dict[str, Any] = field(default_factory=dict)


@dataclass
class Overrides:
    """Values from the caller that override those of the file."""

    channels: Sequence[str] | None = None
    rate_hz: float | None = None
    unit: str | Mapping[str, str] | None = None
    start_time: Any = None
    time_column: str | None = None


def plain(name: str) -> str:
    """Returns a name in lower case, without punctuation and without a trailing ``hz``."""
    letters = re.sub(r"[^a-z0-9]", "", name.rsplit("/", 1)[-1].rsplit(".", 1)[-1].lower())
    return letters.removesuffix("hz") or letters


def split_unit(name: str) -> tuple[str, str | None]:
    """Returns the stem and the unit of a name such as ``acc [m/s2]`` or ``Zeit (ms)``."""
    square = re.fullmatch(r"(.*?)\s*\[([^\]]*)\]\s*", name)
    if square:
        unit = square[2].strip()
        # A number other than 1 is that of a sensor.
        return (square[1], unit) if unit == "1" or unit.strip("0123456789") else (name, None)
    match = re.fullmatch(r"(.*?)\s*\(([^)]*)\)\s*", name)
    if match and (match[2] in ("m", "s") or match[2].lower() in UNITS_IN_PARENTHESES):
        return match[1], match[2]
    return name, None


def as_time(value: Any) -> np.datetime64 | None:
    """Returns a time in UTC, or ``None`` if the value is not a time."""
    if value is None:
        return None
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    if isinstance(value, np.datetime64):
        return None if np.isnat(value) else value.astype("datetime64[ns]")
    if hasattr(value, "isoformat"):
        zone = getattr(value, "tzinfo", None)
        if zone is not None:
            value = (value - zone.utcoffset(value)).replace(tzinfo=None)
        return np.datetime64(value.isoformat(), "ns")
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        return parse_time(value)
    if isinstance(value, (int, float, np.integer, np.floating)) and np.isfinite(value) and value > 1e8:
        return np.datetime64(round(float(value) * 1e9), "ns")
    return None


def parse_time(text: str) -> np.datetime64 | None:
    """Parses an ISO 8601 time; one without an offset is UTC."""
    match = re.fullmatch(r"([\d-]+(?:[T ][\d:.]+)?)(?:Z|\s*([+-])(\d\d):?(\d\d))?", text.strip())
    if match is None:
        return None
    try:
        time: Any = np.datetime64(match[1].replace(" ", "T"), "ns")
    except ValueError:
        return None
    offset = np.timedelta64(0, "m")
    if match[2] is not None:
        minutes = int(match[3]) * 60 + int(match[4])
        offset = np.timedelta64(minutes if match[2] == "+" else -minutes, "m")
    moment: np.datetime64 = time - offset
    return moment


def number(value: Any) -> float | None:
    """Returns a positive number, or ``None`` if the value is not one."""
    try:
        array = np.asarray(value, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        return None
    return float(array[0]) if array.size == 1 and np.isfinite(array[0]) and array[0] > 0 else None


def look_up(values: Mapping[str, Any], names: set[str]) -> Any:
    """Returns the first value with one of the names."""
    return next((value for name, value in values.items() if plain(name) in names and value is not None), None)


def stated_rate(values: Mapping[str, Any]) -> float | None:
    """Returns the sampling rate in a file's metadata."""
    rate = number(look_up(values, RATE_NAMES))
    interval = number(look_up(values, INTERVAL_NAMES))
    return rate if rate is not None else 1.0 / interval if interval is not None else None


def stated_unit(values: Mapping[str, Any]) -> str | None:
    """Returns the unit in a file's metadata."""
    unit = look_up(values, UNIT_NAMES)
    if isinstance(unit, bytes):
        unit = unit.decode("utf-8", "replace")
    return unit.strip() or None if isinstance(unit, str) else None


def is_time(name: str) -> bool:
    """Returns whether an array with this name holds the time."""
    stem, unit = split_unit(name.rsplit("/", 1)[-1])
    words = re.split(r"[ _]", stem.strip().lower())
    unit = unit if unit is not None else words[1] if len(words) == 2 else ""
    return words[0] in TIME_NAMES and len(words) <= 2 and unit.strip().lower() in TIME_UNITS


def time_rate(path: Path, name: str, time: np.ndarray[Any, Any]) -> tuple[float | None, np.datetime64 | None]:
    """Returns the rate in hertz and the start of a time column."""
    start = None
    if time.dtype.kind == "M":
        start = as_time(time[0])
        seconds = (time - time[0]).astype("timedelta64[ns]").astype(float) * 1e-9
    else:
        stem, unit = split_unit(name.rsplit("/", 1)[-1])
        words = re.split(r"[ _]", stem.strip().lower())
        unit = unit if unit is not None else words[1] if len(words) == 2 else ""
        seconds = time.astype(float) * TIME_UNITS.get(unit.strip().lower(), 1.0)
        start = as_time(seconds[0]) if seconds.size else None
    if seconds.size < 2:
        return None, start
    steps = np.diff(seconds)
    step = (seconds[-1] - seconds[0]) / (seconds.size - 1)
    if not step > 0 or not np.all(steps > 0):
        raise RecordingError(path, f"the time column {name!r} is not increasing")
    if np.max(np.abs(steps - step)) > 0.5 * step:
        at = int(np.argmax(np.abs(steps - step))) + 1
        raise RecordingError(
            path,
            f"the time column {name!r} steps by {steps[at - 1]:g} s at sample {at}, expected {step:g} s",
        )
    return float(1.0 / step), start


def columns(content: Content) -> dict[str, np.ndarray[Any, Any]]:
    """Returns the one-dimensional arrays; columns of a matrix get its name and their number."""
    result: dict[str, np.ndarray[Any, Any]] = {}
    for name, array in content.arrays.items():
        if array.dtype.kind not in "fiuM":
            continue
        array = np.squeeze(array)
        if array.ndim == 1 and array.size > 1:
            result[name] = array
        elif array.ndim == 2:
            series = array if array.shape[0] <= array.shape[1] else array.T
            for index, column in enumerate(series, 1):
                key = f"{name}_{index}"
                result[key] = column
                content.attributes.setdefault(key, content.attributes.get(name, {}))
    return result


def complete(path: Path, content: Content, overrides: Overrides) -> list[Channel]:
    """Returns the channels of a file with their stated or guessed rate, unit and time."""
    arrays = columns(content)
    scalars = {name: array.reshape(-1)[0] for name, array in content.arrays.items() if array.size == 1}
    common = {**scalars, **content.common}
    if overrides.time_column is not None and overrides.time_column not in arrays:
        raise RecordingError(
            path,
            f"no time column {overrides.time_column!r}, expected one of {', '.join(arrays)}",
            "time_column",
        )
    times = (
        [overrides.time_column]
        if overrides.time_column
        else [name for name in arrays if is_time(name) or arrays[name].dtype.kind == "M"]
    )
    if overrides.channels is not None:
        wanted = list(overrides.channels)
        unknown = next((name for name in wanted if name not in arrays), None)
        if unknown is not None:
            raise RecordingError(
                path, f"no channel {unknown!r}, expected one of {', '.join(arrays)}", "channels"
            )
    else:
        signals = [name for name in arrays if name not in times]
        longest = max((arrays[name].size for name in signals), default=0)
        wanted = [name for name in signals if 2 * arrays[name].size > longest]
    if not wanted:
        raise RecordingError(path, f"no channel with samples among {', '.join(content.arrays) or 'nothing'}")
    return [channel(path, content, overrides, arrays, common, times, name) for name in wanted]


def channel(
    path: Path,
    content: Content,
    overrides: Overrides,
    arrays: Mapping[str, np.ndarray[Any, Any]],
    common: Mapping[str, Any],
    times: Sequence[str],
    name: str,
) -> Channel:
    """Returns one channel with its rate, unit and time."""
    own = content.attributes.get(name, {})
    clock = next((time for time in times if arrays[time].size == arrays[name].size), None)
    time_rate_hz, clock_start = (None, None) if clock is None else time_rate(path, clock, arrays[clock])
    rate = overrides.rate_hz or stated_rate(own) or stated_rate(common)
    if rate is not None and time_rate_hz is not None and abs(rate / time_rate_hz - 1) > RATE_TOLERANCE:
        raise RecordingError(
            path,
            f"the rate is {rate:g} Hz, expected {time_rate_hz:g} Hz as in the time column {clock!r} "
            "(at most 0.1 % apart)",
        )
    unit = overrides.unit if isinstance(overrides.unit, str) else (overrides.unit or {}).get(name)
    return Channel(
        name=name,
        samples=arrays[name],
        rate_hz=rate or time_rate_hz,
        unit=unit or stated_unit(own) or split_unit(name)[1] or stated_unit(common),
        start_time=as_time(overrides.start_time)
        or as_time(look_up(own, START_NAMES))
        or as_time(look_up(common, START_NAMES))
        or clock_start,
    )
