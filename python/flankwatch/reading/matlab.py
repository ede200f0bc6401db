"""MATLAB files of version 5 and older, read with SciPy."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from .extras import require
from .guess import Content
from .limits import check_declared
from .mat_elements import check


def read(path: Path) -> Content:
    """Reads the variables of a file; fields of structs have dotted names."""
    io = require("scipy.io", "SciPy", "MATLAB files")
    with path.open("rb") as file:
        # Those of version 4 begin with a number below 5000.
        if 0 not in file.read(4):
            check(path)
    check_declared(path, sum(math.prod(shape) for _, shape, _ in io.whosmat(str(path))))
    variables = io.loadmat(str(path), simplify_cells=True)
    content = Content()
    for name, value in variables.items():
        if not name.startswith("__"):
            add(content, name, value)
    return content


def add(content: Content, name: str, value: Any) -> None:
    """Adds a variable, or the fields of a struct."""
    if isinstance(value, dict):
        for field, part in value.items():
            add(content, f"{name}.{field}", part)
    elif isinstance(value, str):
        content.common[name] = value
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        content.arrays[name] = value
    elif isinstance(value, (int, float)):
        content.arrays[name] = np.asarray(value)
