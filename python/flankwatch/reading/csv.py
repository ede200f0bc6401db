"""CSV, also compressed with gzip, read by the program's own code."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Sequence

import numpy as np

from .. import _flankwatch
from ..recording import Channel, RecordingError, argument_error
from .guess import Overrides, as_time


def read(path: Path, overrides: Overrides) -> list[Channel]:
    """Reads the channels; ``start_time`` gives times of day their day."""
    if overrides.time_column is not None:
        raise argument_error(
            path, "time_column", repr(overrides.time_column), "none: those of CSV are detected"
        )
    found = frames(path, overrides)
    start = as_time(found["start_time"])
    if found["states"] != "date" and overrides.start_time is None:
        start = None
    units = overrides.unit if isinstance(overrides.unit, dict) else {}
    every = overrides.unit if isinstance(overrides.unit, str) else None
    return [
        Channel(
            name=name,
            samples=np.asarray(samples),
            rate_hz=found["rate_hz"],
            unit=every or units.get(name) or found["units"].get(name),
            start_time=start,
        )
        for name, samples in zip(found["channels"], found["samples"])
    ]


def frames(path: Path, overrides: Overrides, samples: bool = True) -> dict[str, Any]:
    """Reads a CSV or WAV file as the program does, without its samples if ``samples`` is false."""
    try:
        return read_frames(path, overrides, overrides.channels, samples)
    except ValueError as error:
        raise RecordingError(path, str(error), argument_at_fault(path, overrides)) from error


def read_frames(
    path: Path, overrides: Overrides, channels: Sequence[str] | None, samples: bool
) -> dict[str, Any]:
    """Calls the native reader."""
    start = as_time(overrides.start_time)
    return _flankwatch.read_frames(
        path,
        channels=list(channels or ()),
        rate_hz=overrides.rate_hz,
        start_time=None if start is None else f"{start}Z",
        samples=samples,
    )


def argument_at_fault(path: Path, overrides: Overrides) -> str | None:
    """Returns ``"channels"`` if the file can be read without a choice of channels."""
    if overrides.channels is None:
        return None
    try:
        read_frames(path, overrides, None, samples=False)
    except (ValueError, OSError):
        return None
    return "channels"
