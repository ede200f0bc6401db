"""FLAC and WAV, read with soundfile."""

from __future__ import annotations

from pathlib import Path

from .extras import require
from .guess import Content


def read(path: Path) -> Content:
    """Reads the channels ``"1"``, ``"2"``, …; integers are scaled to a full scale of 1."""
    soundfile = require("soundfile", "soundfile", "FLAC and WAV")
    samples, rate_hz = soundfile.read(path, dtype="float64", always_2d=True)
    arrays = {str(number): samples[:, number - 1] for number in range(1, samples.shape[1] + 1)}
    return Content(arrays=arrays, common={"fs": float(rate_hz)})
