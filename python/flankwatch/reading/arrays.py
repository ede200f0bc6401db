"""NumPy files: ``.npy`` and ``.npz``."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO

import numpy as np

from .guess import Content
from .limits import check_declared


def read_npy(path: Path) -> Content:
    """Reads one array; the fields of a structured array become separate arrays."""
    with path.open("rb") as file:
        check_header(path, file)
    array = np.load(path, allow_pickle=False)
    if array.dtype.names:
        return Content(arrays={name: array[name] for name in array.dtype.names})
    return Content(arrays={"1" if array.squeeze().ndim == 1 else "channel": array})


def read_npz(path: Path) -> Content:
    """Reads the arrays of an archive by name."""
    with zipfile.ZipFile(path) as archive_file:
        for member in archive_file.namelist():
            if member.endswith(".npy"):
                with archive_file.open(member) as file:
                    check_header(path, file)
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    texts = {
        name: str(array) for name, array in arrays.items() if array.dtype.kind == "U" and array.size == 1
    }
    return Content(
        arrays={name: array for name, array in arrays.items() if array.dtype.kind in "fiuM"}, common=texts
    )


def check_header(path: Path, file: IO[bytes]) -> None:
    """Raises ``ValueError`` if the header of an array declares more samples than the file can contain."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    check_declared(path, math.prod(shape), dtype.itemsize)
