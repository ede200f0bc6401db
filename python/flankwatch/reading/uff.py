"""Universal files, dataset 58, read with pyuff."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from .extras import require
from .guess import Content

#: Function type of a time response.
TIME_RESPONSE = 1


def read(path: Path) -> Content:
    """Reads the time responses among the datasets 58."""
    pyuff = require("pyuff", "pyuff", "UFF58")
    file = pyuff.UFF(str(path))
    sets = [file.read_sets(number) for number, kind in enumerate(file.get_set_types()) if int(kind) == 58]
    content = Content()
    for number, dataset in enumerate(sets, 1):
        if dataset.get("func_type", TIME_RESPONSE) not in (0, TIME_RESPONSE) or np.iscomplexobj(
            dataset["data"]
        ):
            continue
        name = channel_name(dataset, number, content)
        content.arrays[name] = np.asarray(dataset["data"])
        if content.arrays[name].size != dataset["num_pts"]:
            raise ValueError(
                f"dataset {number} has {content.arrays[name].size} samples, expected {dataset['num_pts']}"
            )
        interval = dataset.get("abscissa_inc") or None
        axis = np.asarray(dataset.get("x", []))
        if not interval and axis.size > 1:
            interval = (axis[-1] - axis[0]) / (axis.size - 1)
        content.attributes[name] = {
            "dt": interval,
            "unit": dataset.get("ordinate_axis_units_lab", "").strip().replace("NONE", ""),
            "start_time": start_time(dataset),
        }
    return content


def channel_name(dataset: dict[str, Any], number: int, content: Content) -> str:
    """Returns the name of the response, else the first identification line, else the number."""
    candidates = [str(dataset.get(key, "")).strip() for key in ("rsp_ent_name", "id1")]
    name = next((text for text in candidates if text and text.upper() != "NONE"), str(number))
    return f"{name} {number}" if name in content.arrays else name


def start_time(dataset: dict[str, Any]) -> str | None:
    """Parses the time in the third identification line."""
    text = str(dataset.get("id3", "")).strip()
    for pattern in ("%d-%b-%y %H:%M:%S", "%d-%b-%Y %H:%M:%S", "%Y-%m-%dT%H:%M:%S"):
        try:
            return datetime.strptime(text, pattern).isoformat()
        except ValueError:
            continue
    return None
