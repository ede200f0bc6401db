"""TDMS, read with npTDMS."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .extras import require
from .guess import Content
from .limits import check_declared


def read(path: Path) -> Content:
    """Reads all channels with their scaling and properties."""
    nptdms = require("nptdms", "npTDMS", "TDMS")
    content = Content()
    with nptdms.TdmsFile.open(path) as file:
        groups = file.groups()
        channels = [channel for group in groups for channel in group.channels()]
        check_declared(path, sum(len(channel) for channel in channels))
        content.common.update(file.properties)
        for group in groups:
            content.common.update(group.properties)
            for channel in group.channels():
                name = channel.name if len(groups) == 1 else f"{group.name}/{channel.name}"
                content.arrays[name] = np.asarray(channel[:])
                content.attributes[name] = dict(channel.properties)
    return content
