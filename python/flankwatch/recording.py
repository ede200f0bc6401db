"""A recording: channels with their samples, rates, units and times."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Iterator

import numpy as np
from numpy.typing import NDArray


class RecordingError(ValueError):
    """Raised when a file is damaged, is no recording, or contradicts an argument.

    Attributes:
        path: the file.
        detail: the reason, without the path.
        argument: the argument at fault, if there is one.
    """

    def __init__(self, path: str | Path, detail: str, argument: str | None = None) -> None:
        self.path = Path(path)
        self.detail = detail
        self.argument = argument
        super().__init__(f"{path}: {detail}")


def argument_error(path: str | Path, argument: str, value: object, expected: str) -> RecordingError:
    """Returns the error for an argument that does not fit the file."""
    return RecordingError(path, f"{argument} is {value}, expected {expected}", argument)


@dataclass
class Channel:
    """One measuring channel.

    Attributes:
        name: its name in the file.
        samples: shape ``(n,)``, in the file's data type.
        rate_hz: sampling rate in hertz; ``None`` if unknown.
        unit: unit of the samples; ``None`` if unknown.
        start_time: time of the first sample in UTC; ``None`` if unknown.
    """

    name: str
    samples: NDArray[Any]
    rate_hz: float | None = None
    unit: str | None = None
    start_time: np.datetime64 | None = None


@dataclass
class Recording:
    """The channels of a file in their order, accessible by number or by name."""

    path: Path
    format: str
    channels: list[Channel] = field(default_factory=list)

    def __getitem__(self, key: int | str) -> Channel:
        if isinstance(key, int):
            return self.channels[key]
        for channel in self.channels:
            if channel.name == key:
                return channel
        raise KeyError(f"no channel {key!r} in {self.path}, expected one of {', '.join(self.names)}")

    def __iter__(self) -> Iterator[Channel]:
        return iter(self.channels)

    def __len__(self) -> int:
        return len(self.channels)

    @property
    def names(self) -> list[str]:
        """Names of the channels."""
        return [channel.name for channel in self.channels]
