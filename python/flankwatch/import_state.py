"""The state file of an import: the files that the service has acknowledged."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

#: Name of the state file in the imported folder.
FILE_NAME = ".flankwatch-import.jsonl"


@dataclass
class Sent:
    """A file that was sent: its size, modification time, and the end of its samples in ns since 1970."""

    bytes: int
    modified_ns: int
    end_ns: int | None


class ImportState:
    """Files that were sent to one asset with the same options, one JSON line each.

    A line is written and synchronised after the answer to the upload, so a line that an interruption cuts
    off only means that its file is sent again. The service recognises it by its ``Idempotency-Key``.
    """

    def __init__(self, path: Path, destination: Sequence[object]) -> None:
        self.path = path
        self._destination = hashlib.sha256(repr(list(destination)).encode()).hexdigest()[:16]
        self._sent: dict[str, Sent] = {}
        self._file = path.open("a+b")
        self._file.seek(0)
        content = self._file.read()
        for line in content.splitlines():
            self._add(line)
        if content and not content.endswith(b"\n"):
            self._file.write(b"\n")

    def __enter__(self) -> ImportState:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _add(self, line: bytes) -> None:
        try:
            entry = json.loads(line)
            if entry["destination"] == self._destination:
                self._sent[entry["file"]] = Sent(entry["bytes"], entry["modified_ns"], entry["end_ns"])
        except (ValueError, KeyError, TypeError):
            return

    def sent(self, name: str, found: os.stat_result) -> Sent | None:
        """Returns the entry of a file that was sent and has not changed since."""
        entry = self._sent.get(name)
        if entry is not None and (entry.bytes, entry.modified_ns) == (found.st_size, found.st_mtime_ns):
            return entry
        return None

    def add(self, name: str, found: os.stat_result, end_ns: int | None) -> None:
        """Records that the service has acknowledged a file."""
        entry = {
            "destination": self._destination,
            "file": name,
            "bytes": found.st_size,
            "modified_ns": found.st_mtime_ns,
            "end_ns": end_ns,
        }
        self._file.write(json.dumps(entry).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())
