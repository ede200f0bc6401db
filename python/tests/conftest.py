"""Fixtures: the program, a running service, and signals."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import flankwatch
import numpy as np
import pytest

NAMES = itertools.count()
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def program() -> Path:
    """Path of the program: FLANKWATCH_PROGRAM, else the debug build."""
    path = Path(os.environ.get("FLANKWATCH_PROGRAM", ROOT / "target/debug/flankwatch"))
    assert path.is_file(), f"no program at {path}: cargo build, or set FLANKWATCH_PROGRAM"
    return path


@contextmanager
def serve(program: Path, folder: Path) -> Iterator[str]:
    """Runs a service on a data folder. Returns its address."""
    command = [str(program), "serve", "--listen", "127.0.0.1:0", "--data-dir", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            line = process.stdout.readline()
            match = re.search(r"http://\S+", line)
            assert match, f"the service printed {line!r}"
            yield match[0]
        finally:
            process.terminate()
            process.wait(20)


@pytest.fixture(scope="session")
def service(program: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """The address of a service and its data folder."""
    folder = tmp_path_factory.mktemp("data")
    with serve(program, folder) as url:
        yield url, folder


def data_folder() -> Path:
    """The folder of real recordings: FLANKWATCH_DATA, else the one beside the checkout."""
    return Path(os.environ.get("FLANKWATCH_DATA") or ROOT / "../shared/data").resolve()


def real_data() -> Path:
    """The folder of real recordings. Skips the test without it."""
    if not data_folder().is_dir():
        pytest.skip(f"no real recordings in {data_folder()}; FLANKWATCH_DATA names their folder")
    return data_folder()


@pytest.fixture
def client(service: tuple[str, Path]) -> Iterator[flankwatch.Client]:
    with flankwatch.Client(service[0]) as client:
        yield client


@pytest.fixture
def asset(client: flankwatch.Client) -> str:
    """A separate asset for each test."""
    name = f"rig-{next(NAMES)}"
    client.create_asset(
        {"id": name, "gear": {"teeth": [24, 36], "shaft_speed_hz": 24.5}, "sensor": {"unit": "m/s2"}}
    )
    return name


def gear_signal(
    seed: int = 0, count: int = 40_000, rate_hz: float = 20_000.0, speed_hz: float = 25.0
) -> np.ndarray:
    """A mesh of 24 teeth, modulated once a turn, in noise."""
    turn = 2 * np.pi * speed_hz * np.arange(count) / rate_hz
    noise = np.random.default_rng(seed).normal(size=count)
    return (1 + 0.1 * np.cos(turn)) * np.sin(24 * turn) + 0.3 * np.sin(48 * turn + 1) + 0.05 * noise
