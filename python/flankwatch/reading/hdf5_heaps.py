"""Check of the heaps for text in an HDF5 file, because the HDF5 library reads some damaged ones forever."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

#: Signature and version of a global heap collection, with reserved bytes.
SIGNATURE = b"GCOL\x01\x00\x00\x00"

#: Bytes before the first object of a collection, and before the data of an object.
HEADER_BYTES = 16


def check(path: Path) -> None:
    """Raises ``ValueError`` if an object of a heap has no length, so that no other can follow it."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(SIGNATURE)
        while at >= 0:
            (length,) = struct.unpack("<Q", data[at + 8 : at + 16].ljust(8, b"\0"))
            check_objects(data, at, min(at + length, len(data)))
            at = data.find(SIGNATURE, at + 1)


def check_objects(data: mmap.mmap, collection: int, end: int) -> None:
    """Checks the objects of one collection."""
    at = collection + HEADER_BYTES
    while at + HEADER_BYTES <= end:
        index, length = struct.unpack("<H6xQ", data[at : at + HEADER_BYTES])
        if index == 0 and length == 0:
            raise ValueError(f"the heap at byte {collection} has an object without a length at byte {at}")
        # The free space, number 0, includes its header. Data end at a multiple of 8 bytes.
        at += length if index == 0 else HEADER_BYTES + (length + 7) // 8 * 8
