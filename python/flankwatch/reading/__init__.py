"""Recordings in the formats of laboratories, by the libraries that know them."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping, Sequence

from numpy.typing import ArrayLike

from ..recording import Channel, Recording
from . import arrays, audio, hdf5, matlab, parquet, tdms, uff
from .detect import detect
from .guess import Given, complete

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

    The content says what the format is, not the name. Samples are those of the file, in its own type.

    Args:
        path: the file.
        channels: names of the channels to take, in this order; all that look like signals where not given.
        rate_hz: sampling rate in hertz, where the file does not say.
        unit: unit of the samples, for all channels or by name, in place of what the file says.
        start_time: time of the first sample, in place of what the file says.
        time_column: name of the channel that holds the time in seconds; guessed where not given.

    Raises:
        ValueError: for a file that is not such a recording, a channel that is not there, or a rate that contradicts
            the time column by more than 0.1 %.
        ImportError: for a library that is not installed; the message names it.
        OSError: where the file cannot be read.
    """
    path = Path(path)
    name = detect(path)
    try:
        content = READERS[name](path)
    except (ImportError, MemoryError):
        raise
    except Exception as error:  # What the libraries raise for damaged files is of many kinds.
        raise ValueError(f"{path}: not a whole {NAMES[name]} file: {error}") from error
    given = Given(
        channels=channels, rate_hz=rate_hz, unit=unit, start_time=start_time, time_column=time_column
    )
    return Recording(path=path, format=name, channels=complete(path, content, given))


__all__ = ["Channel", "Recording", "read"]
