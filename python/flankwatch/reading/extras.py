"""The optional libraries that read other formats."""

from __future__ import annotations

import importlib
from typing import Any


def require(module: str, package: str, what: str) -> Any:
    """Imports a library. The error for a missing one says how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(
            f"reading {what} needs {package}, which is not installed: pip install 'flankwatch[readers]'"
        ) from error
