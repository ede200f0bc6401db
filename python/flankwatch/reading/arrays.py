"""NumPy's own files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .guess import Content


def read_npy(path: Path) -> Content:
    """One array; fields of a structured one are arrays of their own."""
    array = np.load(path, allow_pickle=False)
    if array.dtype.names:
        return Content(arrays={name: array[name] for name in array.dtype.names})
    return Content(arrays={"1" if array.squeeze().ndim == 1 else "channel": array})


def read_npz(path: Path) -> Content:
    """The arrays of an archive by their names."""
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    texts = {
        name: str(array) for name, array in arrays.items() if array.dtype.kind == "U" and array.size == 1
    }
    return Content(
        arrays={name: array for name, array in arrays.items() if array.dtype.kind in "fiuM"}, common=texts
    )
