"""Detection of a file's format from its first bytes."""

from __future__ import annotations

from pathlib import Path

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
    (b"RF64", "audio"),
]

NOT_READ_HERE = [
    (b"\x89MCAP0\r\n", "an MCAP recording: `flankwatch analyze` and Client.upload_file read it"),
    (b"\x1f\x8b", "compressed with gzip: decompress it first"),
]


def detect(path: Path) -> str:
    """Returns the name of a file's format."""
    with path.open("rb") as file:
        beginning = file.read(512)
    for magic, name in MAGIC:
        if beginning.startswith(magic):
            return name
    for magic, reason in NOT_READ_HERE:
        if beginning.startswith(magic):
            raise ValueError(f"{path}: {reason}")
    # A block of a universal file begins with a line that holds −1 in columns 5 and 6.
    if any(line.rstrip() == b"    -1" for line in beginning.splitlines()[:2]):
        return "uff"
    if path.suffix.lower() == ".mat":
        return "mat"
    if not beginning:
        raise ValueError(f"{path}: the file is empty")
    expected = "MATLAB, TDMS, UFF58, HDF5, Parquet, NumPy, FLAC or WAV"
    if all(byte >= 32 or byte in b"\t\r\n" for byte in beginning):
        raise ValueError(
            f"{path}: the file is text, expected {expected}; Client.upload_file sends files that end in .csv"
        )
    raise ValueError(f"{path}: the file begins with {beginning[:8].hex(' ')}, expected {expected}")
