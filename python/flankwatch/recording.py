"""A recording: channels with their samples, rates, units and times."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Iterator

import numpy as np
from numpy.typing import NDArray


@dataclass
class Channel:
    """One measuring channel.

    Attributes:
        name: its name in the file.
        samples: shape ``(n,)``, in the type that the file has.
        rate_hz: sampling rate in hertz; ``None`` where nobody says.
        unit: unit of the samples; ``None`` where nobody says.
        start_time: time of the first sample in UTC; ``None`` where nobody says.
    """

    name: str
    samples: NDArray[Any]
    rate_hz: float | None = None
    unit: str | None = None
    start_time: np.datetime64 | None = None


@dataclass
class Recording:
    """What a file holds: its channels in their order, by number or by name."""

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
        """The channels' names."""
        return [channel.name for channel in self.channels]
