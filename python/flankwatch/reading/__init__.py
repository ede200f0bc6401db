"""Readers of laboratory file formats, each based on the format's library."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping, Sequence

from numpy.typing import ArrayLike

from ..recording import Channel, Recording, RecordingError
from . import arrays, audio, csv, hdf5, matlab, parquet, tdms, uff
from .detect import detect
from .guess import Overrides, as_time, complete

READERS = {
    "mat": matlab.read,
    "mat73": hdf5.read_matlab,
    "hdf5": hdf5.read,
    "tdms": tdms.read,
    "uff": uff.read,
    "parquet": parquet.read,
    "npy": arrays.read_npy,
    "npz": arrays.read_npz,
    "audio": audio.read,
}

NAMES = {
    "mat": "MATLAB",
    "mat73": "MATLAB 7.3",
    "hdf5": "HDF5",
    "tdms": "TDMS",
    "uff": "universal",
    "parquet": "Parquet",
    "npy": ".npy",
    "npz": ".npz",
    "audio": "FLAC or WAV",
    "csv": "CSV",
}


def read(
    path: str | Path,
    *,
    channels: Sequence[str] | None = None,
    rate_hz: float | None = None,
    unit: str | Mapping[str, str] | None = None,
    start_time: ArrayLike | None = None,
    time_column: str | None = None,
) -> Recording:
    """Reads a recording: MATLAB (v5 and v7.3), TDMS, UFF58, HDF5, Parquet, NumPy, FLAC, WAV or CSV.

    The format is detected from the content, not from the file name. Samples, of shape ``(n,)`` per channel,
    keep the file's data type; those of CSV, which may be compressed with gzip, are in single precision.

    Args:
        path: the file.
        channels: names of the channels to read, in this order; defaults to all that look like signals.
        rate_hz: sampling rate in hertz, for a file without one.
        unit: unit of the samples, for all channels or by name, instead of that of the file.
        start_time: time of the first sample, instead of that of the file. A CSV file's own date takes
            precedence; its times of day count from this time on.
        time_column: name of the channel that holds the time in seconds; guessed by default.

    Raises:
        RecordingError: if the file is damaged or not such a recording, a channel does not exist, or a rate
            contradicts the time column by more than 0.1 %. It is a ``ValueError``.
        ImportError: if the format's library is not installed; the message names it.
        OSError: if the file cannot be opened.
    """
    path = Path(path)
    name = detect(path)
    overrides = Overrides(
        channels=channels, rate_hz=rate_hz, unit=unit, start_time=start_time, time_column=time_column
    )
    if start_time is not None and as_time(start_time) is None:
        raise ValueError(f"start_time is {start_time!r}, expected a time")
    try:
        if name == "csv":
            found = csv.read(path, overrides)
        else:
            content = READERS[name](path)
            if name == "audio":
                audio.check_rate(path, content, rate_hz)
            found = complete(path, content, overrides)
    except (ImportError, RecordingError):
        raise
    except Exception as error:  # The libraries raise many kinds of errors for damaged files.
        detail = str(error) or type(error).__name__
        raise RecordingError(path, f"damaged or incomplete {NAMES[name]} file: {detail}") from error
    return Recording(path=path, format=name, channels=found)


__all__ = ["Channel", "Recording", "RecordingError", "read"]
