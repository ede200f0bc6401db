"""Rows of the service as pandas or polars frames."""

from __future__ import annotations

import importlib
from typing import Any


def as_frame(answer: Any, frame: str | None) -> Any:
    """Returns the rows unchanged, or as a frame with the time in UTC in the column ``start_time``."""
    rows = answer["items"] if isinstance(answer, dict) else answer
    if frame is None:
        return rows
    if frame not in ("pandas", "polars"):
        raise ValueError(f'frame is {frame!r}, expected "pandas", "polars" or None')
    try:
        library: Any = importlib.import_module(frame)
    except ImportError as error:
        raise ImportError(
            f"frame={frame!r} needs {frame}, which is not installed: pip install 'flankwatch[frames]'"
        ) from error
    if frame == "polars":
        table = library.DataFrame(rows, infer_schema_length=None)
        if "start_time" in table.columns:
            table = table.with_columns(library.col("start_time").str.to_datetime(time_zone="UTC"))
        return table
    table = library.DataFrame(rows)
    if "start_time" in table.columns:
        table["start_time"] = library.to_datetime(table["start_time"], utc=True, format="ISO8601")
    return table
