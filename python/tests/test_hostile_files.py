"""Damaged and malicious files are read, or refused with the package's own error, in bounded memory."""

from __future__ import annotations

import io
import os
import struct
import tracemalloc
import zipfile
from pathlib import Path

import flankwatch
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import scipy.io

from conftest import real_data
from recordings import ALL_WRITERS, signals

#: Greatest memory that reading a file of a few kilobytes may take.
MAX_BYTES = 1 << 27


def outcome(path: Path) -> str:
    """Reads the file. Any other exception than the package's own fails the test."""
    try:
        recording = flankwatch.read(path)
    except flankwatch.RecordingError as error:
        assert str(path) in str(error) and error.detail
        return "refused"
    assert all(channel.samples.ndim == 1 for channel in recording)
    return "read"


@pytest.fixture
def written(tmp_path, request):
    """A valid file and its bytes."""
    path = tmp_path / "recording"
    ALL_WRITERS[request.param](path, signals(8), 8)
    return path, path.read_bytes()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("written", ALL_WRITERS, indirect=True)
def test_flipped_bits(written):
    path, whole = written
    outcomes = set()
    for seed in range(2):
        rng = np.random.default_rng(seed)
        # Headers and the ends of files, where tables of contents are, decide about lengths.
        ends = [rng.integers(0, 8 * 512, 100), 8 * len(whole) - 1 - rng.integers(0, 8 * 512, 30)]
        for bit in np.concatenate([*ends, rng.integers(0, 8 * len(whole), 70)]) % (8 * len(whole)):
            damaged = bytearray(whole)
            damaged[bit // 8] ^= 1 << (bit % 8)
            path.write_bytes(damaged)
            outcomes.add(outcome(path))
    assert outcomes == {"read", "refused"}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("written", ALL_WRITERS, indirect=True)
def test_truncated_files(written):
    path, whole = written
    found = [channel.samples.size for channel in flankwatch.read(path)]
    outcomes = []
    for count in sorted({*range(0, 200), *np.linspace(0, len(whole) - 1, 200).astype(int)}):
        path.write_bytes(whole[:count])
        outcomes.append(outcome(path))
        if outcomes[-1] == "read":
            cut = flankwatch.read(path)
            assert max(channel.samples.size for channel in cut) <= max(found)
    assert outcomes.count("refused") > 100


def refused_in_bounded_memory(path: Path) -> str:
    tracemalloc.start()
    try:
        with pytest.raises(flankwatch.RecordingError) as refused:
            flankwatch.read(path)
        assert tracemalloc.get_traced_memory()[1] < MAX_BYTES
    finally:
        tracemalloc.stop()
    return refused.value.detail


def npy_header(shape: tuple[int, ...]) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue() + bytes(800)


def absurd_npy(path: Path) -> None:
    path.write_bytes(npy_header((10**13,)))


def absurd_npz(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("x.npy", npy_header((10**6, 10**6)))


def absurd_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape=(10**9, 100), dtype="f8", chunks=(1000, 100), compression="gzip")


def absurd_mat73(path: Path) -> None:
    ALL_WRITERS["mat73"](path, signals(0), 0)
    with h5py.File(path, "r+") as file:
        file.create_dataset("x", shape=(1, 10**11), dtype="f8", chunks=(1, 1000))


def absurd_mat(path: Path) -> None:
    scipy.io.savemat(path, {"x": np.arange(77.0), "fs": 100.0}, do_compression=False)
    content = path.read_bytes()
    assert content.count(struct.pack("<ii", 1, 77)) == 1
    path.write_bytes(content.replace(struct.pack("<ii", 1, 77), struct.pack("<ii", 2**30, 2**10)))


def absurd_tdms(path: Path) -> None:
    ALL_WRITERS["tdms"](path, signals(0), 0)
    content = path.read_bytes()
    count = struct.pack("<IQ", 1, signals(0)["a1"].size)
    assert content.count(count) > 0
    path.write_bytes(content.replace(count, struct.pack("<IQ", 1, 2**40)))


def absurd_uff(path: Path) -> None:
    ALL_WRITERS["uff"](path, signals(1), 1)
    content = path.read_bytes()
    count = f"{signals(1)['a1'].size:10d}".encode()
    assert content.count(count) > 0
    path.write_bytes(content.replace(count, b"%10d" % 9_999_999_999))


def absurd_parquet(path: Path) -> None:
    column = pa.array(np.zeros(20_000_000, dtype=np.int8))
    pyarrow.parquet.write_table(pa.table({"x": column}), path, compression="zstd")


def absurd_flac(path: Path) -> None:
    ALL_WRITERS["flac"](path, signals(0), 0)
    content = bytearray(path.read_bytes())
    # The lowest 36 bits of bytes 21 to 25 are the number of samples.
    content[21] |= 0x0F
    content[22:26] = b"\xff\xff\xff\xff"
    path.write_bytes(content)


def absurd_wav(path: Path) -> None:
    ALL_WRITERS["wav"](path, signals(0), 0)
    content = path.read_bytes()
    at = content.index(b"data") + 4
    path.write_bytes(content[:at] + struct.pack("<I", 0xFFFFFF00) + content[at + 4 :])


def absurd_csv(path: Path) -> None:
    path.write_bytes(b"a;b\n1;2\n" + b"1" * (2 << 20))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ALL_WRITERS)
def test_absurd_lengths(tmp_path, name):
    path = tmp_path / "recording"
    globals()[f"absurd_{name}"](path)
    assert path.stat().st_size < 3 << 20
    detail = refused_in_bounded_memory(path)
    if name in ("npy", "npz", "hdf5", "mat73", "parquet", "flac"):
        assert "bytes of samples, expected at most 100 times" in detail


def test_a_heap_without_an_end_is_refused(tmp_path):
    """The HDF5 library reads such a heap forever."""
    path = tmp_path / "recording.h5"
    ALL_WRITERS["hdf5"](path, signals(0), 0)
    content = path.read_bytes()
    heap = content.index(b"GCOL")
    # The length of the second text skips the rest.
    second = heap + 16 + 24
    path.write_bytes(content[: second + 8] + struct.pack("<Q", 257) + content[second + 16 :])
    with pytest.raises(
        flankwatch.RecordingError, match=f"heap at byte {heap} has an object without a length"
    ):
        flankwatch.read(path)


def test_the_cause_is_kept(tmp_path):
    path = tmp_path / "recording.npy"
    path.write_bytes(b"\x93NUMPY\x01\x00\xff\xff")
    with pytest.raises(flankwatch.RecordingError) as refused:
        flankwatch.read(path)
    assert isinstance(refused.value.__cause__, ValueError)
    assert str(refused.value).startswith(f"{path}: damaged or incomplete .npy file: ")


@pytest.mark.filterwarnings("ignore")
def test_wav_files_that_break_readers():
    files = [path for path in (real_data() / "wav-edge").rglob("*") if path.is_file()]
    outcomes = [outcome(path) for path in files if os.path.getsize(path)]
    assert len(files) > 40 and {"read", "refused"} == set(outcomes)
