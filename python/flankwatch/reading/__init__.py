"""Readers of laboratory file formats, each based on the format's library."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping, Sequence

from numpy.typing import ArrayLike

from ..recording import Channel, Recording
from . import arrays, audio, hdf5, matlab, parquet, tdms, uff
from .detect import detect
from .guess import Overrides, complete

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
    """Reads a recording: MATLAB (v5 and v7.3), TDMS, UFF58, HDF5, Parquet, NumPy, FLAC or WAV.

    The format is detected from the content, not from the file name. Samples keep the file's data type.

    Args:
        path: the file.
        channels: names of the channels to read, in this order; defaults to all that look like signals.
        rate_hz: sampling rate in hertz, for a file without one.
        unit: unit of the samples, for all channels or by name, instead of that of the file.
        start_time: time of the first sample, instead of that of the file.
        time_column: name of the channel that holds the time in seconds; guessed by default.

    Raises:
        ValueError: if the file is not such a recording, a channel does not exist, or a rate contradicts the
            time column by more than 0.1 %.
        ImportError: if the format's library is not installed; the message names it.
        OSError: if the file cannot be read.
    """
    path = Path(path)
    name = detect(path)
    try:
        content = READERS[name](path)
    except (ImportError, MemoryError):
        raise
    except Exception as error:  # The libraries raise many kinds of errors for damaged files.
        raise ValueError(f"{path}: damaged or incomplete {NAMES[name]} file: {error}") from error
    overrides = Overrides(
        channels=channels, rate_hz=rate_hz, unit=unit, start_time=start_time, time_column=time_column
    )
    return Recording(path=path, format=name, channels=complete(path, content, overrides))


__all__ = ["Channel", "Recording", "read"]
