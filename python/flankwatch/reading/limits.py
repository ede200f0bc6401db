"""The limit for samples that a file declares, checked before memory is allocated."""

from __future__ import annotations

from pathlib import Path

#: Maximum ratio of the samples' bytes to the file's bytes: vibrations compress far less.
MAX_RATIO = 100

#: Bytes of samples that any file may declare.
ALWAYS_ALLOWED = 1 << 26


def check_declared(path: Path, samples: int, sample_bytes: int = 8) -> None:
    """Raises ``ValueError`` if a file declares more samples than it can plausibly contain."""
    declared, found = samples * sample_bytes, path.stat().st_size
    if declared > max(ALWAYS_ALLOWED, MAX_RATIO * found):
        raise ValueError(
            f"it declares {declared} bytes of samples, expected at most {MAX_RATIO} times its {found} bytes"
        )
