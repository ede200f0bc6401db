"""HDF5, and MATLAB files of version 7.3, which are HDF5, read with h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .extras import require
from .guess import Content
from .hdf5_heaps import check
from .limits import check_declared


def read(path: Path) -> Content:
    """Reads all numeric datasets with their attributes; those of groups and of the file apply to all."""
    h5py = require("h5py", "h5py", "HDF5")
    check(path)
    content = Content()
    declared: list[int] = []
    with h5py.File(path, "r") as file:
        content.common.update(plain_values(file.attrs))
        matlab = any("MATLAB_class" in item.attrs for item in file.values())

        def visit(name: str, item: Any) -> None:
            if name.startswith("#"):
                return
            if isinstance(item, h5py.Dataset):
                declared.append(item.size * item.dtype.itemsize if item.shape is not None else 0)
                check_declared(path, sum(declared), 1)
                add(content, name, item, matlab)
            else:
                content.common.update(plain_values(item.attrs))

        file.visititems(visit)
    return content


def read_matlab(path: Path) -> Content:
    """Reads a MATLAB file of version 7.3."""
    return read(path)


def add(content: Content, name: str, dataset: Any, matlab: bool) -> None:
    """Adds a dataset; MATLAB reverses the axes of its datasets and stores text as numbers."""
    kind = dataset.attrs.get("MATLAB_class", b"")
    key = name.replace("/", ".") if matlab else name
    if kind == b"char":
        content.common[key] = "".join(chr(letter) for letter in np.asarray(dataset[()]).T.reshape(-1))
    elif dataset.dtype.kind in "fiu" and dataset.shape is not None:
        values = np.asarray(dataset[()])
        content.arrays[key] = values.T if matlab else values
        content.attributes[key] = plain_values(dataset.attrs)
    elif dataset.dtype.kind in "OS" and dataset.shape == ():
        content.common[key] = dataset[()]


def plain_values(attributes: Any) -> dict[str, Any]:
    """Returns attributes as plain values, arrays of one element as that element."""
    return {
        name: value[0] if isinstance(value, np.ndarray) and value.size == 1 else value
        for name, value in attributes.items()
    }
