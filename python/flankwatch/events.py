"""Server-sent events of the service."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Iterator


@dataclass
class Event:
    """One event of the service: its kind, its identifier for resuming the stream, and its content."""

    kind: str
    id: str
    data: Any


def parse_events(lines: Iterator[str]) -> Iterator[Event]:
    """Parses the events in the lines of a stream."""
    kind, number = "message", ""
    data: list[str] = []
    for line in lines:
        if not line:
            if data:
                text = "\n".join(data)
                try:
                    content = json.loads(text)
                except ValueError:
                    content = text
                yield Event(kind=kind, id=number, data=content)
            kind, data = "message", []
            continue
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            kind = value
        elif name == "id":
            number = value
        elif name == "data":
            data.append(value)
