"""FLAC and WAV, read with soundfile."""

from __future__ import annotations

from pathlib import Path

from ..recording import RecordingError
from .extras import require
from .guess import RATE_TOLERANCE, Content
from .limits import check_declared


def read(path: Path) -> Content:
    """Reads the channels ``"1"``, ``"2"``, …; integers are scaled to a full scale of 1."""
    soundfile = require("soundfile", "soundfile", "FLAC and WAV")
    header = soundfile.info(path)
    check_declared(path, header.frames * header.channels)
    samples, rate_hz = soundfile.read(path, dtype="float64", always_2d=True)
    if len(samples) != header.frames:
        raise ValueError(f"it has {len(samples)} samples per channel, expected {header.frames} as in its header")
    arrays = {str(number): samples[:, number - 1] for number in range(1, samples.shape[1] + 1)}
    return Content(arrays=arrays, common={"fs": float(rate_hz)})


def check_rate(path: Path, content: Content, rate_hz: float | None) -> None:
    """Raises :class:`RecordingError` if a given rate is not that of the header."""
    stated = content.common["fs"]
    if rate_hz is not None and abs(rate_hz / stated - 1) > RATE_TOLERANCE:
        raise RecordingError.of_argument(path, "rate_hz", rate_hz, f"{stated:g} as in the header, or none")
