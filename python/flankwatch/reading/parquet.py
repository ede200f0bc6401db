"""Parquet, read with pyarrow."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .extras import require
from .guess import Content
from .limits import check_declared


def read(path: Path) -> Content:
    """Reads all columns of numbers and times, with the metadata of fields and file."""
    pa = require("pyarrow", "pyarrow", "Parquet")
    parquet = require("pyarrow.parquet", "pyarrow", "Parquet")
    metadata = parquet.read_metadata(path)
    check_declared(path, metadata.num_rows * metadata.num_columns)
    table = parquet.read_table(path)
    content = Content()
    content.common.update(texts(table.schema.metadata))
    for field, column in zip(table.schema, table.columns):
        if column.null_count and (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
            raise ValueError(f"column {field.name!r} has {column.null_count} missing values, expected none")
        if (
            pa.types.is_floating(field.type)
            or pa.types.is_integer(field.type)
            or pa.types.is_timestamp(field.type)
        ):
            content.arrays[field.name] = np.asarray(column.to_numpy())
            content.attributes[field.name] = dict(texts(field.metadata))
    return content


def texts(metadata: dict[bytes, bytes] | None) -> dict[str, str]:
    """Returns metadata as text."""
    return {
        key.decode("utf-8", "replace"): value.decode("utf-8", "replace")
        for key, value in (metadata or {}).items()
    }
