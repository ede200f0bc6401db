"""NumPy files: ``.npy`` and ``.npz``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .guess import Content


def read_npy(path: Path) -> Content:
    """Reads one array; the fields of a structured array become separate arrays."""
    array = np.load(path, allow_pickle=False)
    if array.dtype.names:
        return Content(arrays={name: array[name] for name in array.dtype.names})
    return Content(arrays={"1" if array.squeeze().ndim == 1 else "channel": array})


def read_npz(path: Path) -> Content:
    """Reads the arrays of an archive by name."""
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    texts = {
        name: str(array) for name, array in arrays.items() if array.dtype.kind == "U" and array.size == 1
    }
    return Content(
        arrays={name: array for name, array in arrays.items() if array.dtype.kind in "fiuM"}, common=texts
    )
