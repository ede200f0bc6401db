"""FLAC and WAV, read with soundfile."""

from __future__ import annotations

import struct
from pathlib import Path

from ..recording import argument_error
from .extras import require
from .guess import RATE_TOLERANCE, Content
from .limits import check_declared


def read(path: Path) -> Content:
    """Reads the channels ``"1"``, ``"2"``, …; integers are scaled to a full scale of 1."""
    soundfile = require("soundfile", "soundfile", "FLAC and WAV")
    check_data_chunk(path)
    header = soundfile.info(path)
    check_declared(path, header.frames * header.channels)
    samples, rate_hz = soundfile.read(path, dtype="float64", always_2d=True)
    arrays = {str(number): samples[:, number - 1] for number in range(1, samples.shape[1] + 1)}
    return Content(arrays=arrays, common={"fs": float(rate_hz)})


def check_data_chunk(path: Path) -> None:
    """Raises ``ValueError`` if a WAV file ends before its data do: soundfile reads it as a shorter one."""
    file_bytes = path.stat().st_size
    with path.open("rb") as file:
        order = {b"RIFF": "<", b"RIFX": ">"}.get(file.read(4))
        if order is None:
            return
        file.seek(12)
        while len(chunk := file.read(8)) == 8:
            name, declared = struct.unpack(f"{order}4sI", chunk)
            if name == b"data":
                found = file_bytes - file.tell()
                # A recorder that streams cannot know the length.
                if declared not in (0, 0xFFFFFFFF) and declared > found:
                    raise ValueError(f"the data chunk declares {declared} bytes, and the file has {found}")
                return
            file.seek(declared + declared % 2, 1)


def check_rate(path: Path, content: Content, rate_hz: float | None) -> None:
    """Raises :class:`RecordingError` if a given rate is not that of the header."""
    stated = content.common["fs"]
    if rate_hz is not None and abs(rate_hz / stated - 1) > RATE_TOLERANCE:
        raise argument_error(path, "rate_hz", rate_hz, f"{stated:g} as in the header, or none")
