"""Detection of a file's format from its first bytes."""

from __future__ import annotations

from pathlib import Path

from ..recording import RecordingError

MAGIC = [
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"MATLAB 7.3 MAT-file", "mat73"),
    (b"MATLAB 5.0 MAT-file", "mat"),
    (b"TDSm", "tdms"),
    (b"PAR1", "parquet"),
    (b"\x93NUMPY", "npy"),
    (b"PK\x03\x04", "npz"),
    (b"fLaC", "audio"),
    (b"RIFF", "audio"),
    (b"RIFX", "audio"),
    (b"RF64", "audio"),
    (b"\x1f\x8b", "csv"),
]

MCAP = b"\x89MCAP0\r\n"


def detect(path: Path) -> str:
    """Returns the name of a file's format."""
    with path.open("rb") as file:
        beginning = file.read(512)
    for magic, name in MAGIC:
        if beginning.startswith(magic):
            return name
    if beginning.startswith(MCAP):
        raise RecordingError(path, "an MCAP recording: `flankwatch analyze` and Client.upload_file read it")
    # A block of a universal file begins with a line that holds −1 in columns 5 and 6.
    if any(line.rstrip() == b"    -1" for line in beginning.splitlines()[:2]):
        return "uff"
    if path.suffix.lower() == ".mat":
        return "mat"
    if not beginning:
        raise RecordingError(path, "the file is empty")
    # Text of any code page has no other control characters.
    if all(byte >= 32 or byte in b"\t\r\n" for byte in beginning):
        return "csv"
    expected = "MATLAB, TDMS, UFF58, HDF5, Parquet, NumPy, FLAC, WAV or CSV"
    raise RecordingError(path, f"the file begins with {beginning[:8].hex(' ')}, expected {expected}")
