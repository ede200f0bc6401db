"""Check of the elements of a MATLAB file of version 5, because SciPy crashes on some damaged ones."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

from .limits import ALWAYS_ALLOWED, MAX_RATIO

#: Bytes per value of each data type of numbers and text.
VALUE_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
MATRIX, COMPRESSED = 14, 15

CELL, STRUCT, OBJECT, TEXT, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
NUMBERS = range(6, 16)

COMPLEX = 0x0800

#: Levels of structs and cells within each other.
MAX_DEPTH = 32


class Element(NamedTuple):
    """Type, begin and end of an element's data, and the begin of the next element."""

    kind: int
    begin: int
    end: int
    next: int


def check(path: Path) -> None:
    """Raises ``ValueError`` if an element's type or length contradicts the rest of the file."""
    data = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError(f"the mark of its byte order is {data[126:128]!r}, expected b'IM' or b'MI'")
    if data[125 if order == "<" else 124] != 1:
        raise ValueError(f"its version is {data[124:126]!r}, expected 1")
    limit = max(ALWAYS_ALLOWED, MAX_RATIO * len(data))
    at = 128
    while at < len(data):
        element = element_at(data, at, len(data), order)
        if element.kind == COMPRESSED:
            decompress = zlib.decompressobj()
            inner = decompress.decompress(data[element.begin : element.end], limit)
            if not decompress.eof:
                raise ValueError("a compressed variable is incomplete, or too long")
            check_matrix(inner, element_at(inner, 0, len(inner), order), order, 0)
            at = element.end
        else:
            check_matrix(data, element, order, 0)
            at = element.next


def element_at(data: bytes, at: int, end: int, order: str) -> Element:
    """Reads the tag of an element that must end before ``end``."""
    if at + 8 > end:
        raise ValueError(
            f"an element begins at byte {at}, {end - at} bytes before the end, expected at least 8"
        )
    kind, count = struct.unpack_from(f"{order}II", data, at)
    begin, following = at + 8, at + 8 + (count + 7) // 8 * 8
    if kind >> 16:
        kind, count = kind & 0xFFFF, kind >> 16
        begin, following = at + 4, at + 8
        if count > 4:
            raise ValueError(f"the element at byte {at} has {count} bytes, expected at most 4")
    if begin + count > end:
        raise ValueError(f"the element at byte {at} has {count} bytes, expected at most {end - begin}")
    if kind not in VALUE_BYTES and kind not in (MATRIX, COMPRESSED):
        raise ValueError(f"the element at byte {at} has the type {kind}, expected a type of version 5")
    return Element(kind, begin, begin + count, min(following, end))


def check_matrix(data: bytes, matrix: Element, order: str, depth: int) -> None:
    """Checks an array with all its parts."""
    if matrix.kind != MATRIX:
        raise ValueError(
            f"the element before byte {matrix.begin} has the type {matrix.kind}, expected an array"
        )
    if depth > MAX_DEPTH:
        raise ValueError(f"structs are nested deeper than {MAX_DEPTH} levels")
    if matrix.begin == matrix.end:
        return
    at = matrix.begin

    def part(*kinds: int) -> Element:
        nonlocal at
        element = element_at(data, at, matrix.end, order)
        if element.kind not in kinds:
            raise ValueError(f"the part at byte {at} has the type {element.kind}, expected one of {kinds}")
        at = element.next
        return element

    def values(count: int, *kinds: int) -> None:
        element = part(*kinds)
        expected = count * VALUE_BYTES[element.kind]
        if element.end - element.begin != expected:
            raise ValueError(
                f"an array has {element.end - element.begin} bytes before byte {element.end}, "
                f"expected {expected}"
            )

    flags_at = part(6)
    if flags_at.end - flags_at.begin != 8:
        raise ValueError(f"the flags at byte {flags_at.begin} are invalid, expected 8 bytes")
    (flags,) = struct.unpack_from(f"{order}I", data, flags_at.begin)
    kind, parts = flags & 0xFF, 2 if flags & COMPLEX else 1
    if kind == OPAQUE:
        for _ in range(3):
            part(1)
        check_matrix(data, part(MATRIX), order, depth + 1)
        return
    shape_at = part(5, 6)
    shape = struct.unpack_from(f"{order}{(shape_at.end - shape_at.begin) // 4}i", data, shape_at.begin)
    if not 2 <= len(shape) <= 32 or min(shape) < 0:
        raise ValueError(f"an array has the shape {shape}, expected 2 to 32 lengths of at least 0")
    count = math.prod(shape)
    part(1, 2, 16)
    numbers = tuple(kind for kind in VALUE_BYTES if kind < 16)
    if kind in NUMBERS:
        for _ in range(parts):
            values(count, *numbers)
    elif kind == TEXT:
        text = element_at(data, at, matrix.end, order)
        if text.kind == 4 and text.begin != text.end:
            values(count, 4)
        else:
            part(1, 2, 4, 16, 17, 18)
    elif kind == SPARSE:
        part(5)
        part(5)
        for _ in range(parts):
            part(*numbers)
    elif kind in (STRUCT, OBJECT):
        if kind == OBJECT:
            part(1)
        length_at, names = part(5), part(1)
        (length,) = struct.unpack_from(f"{order}i", data, length_at.begin)
        if length < 1 or length_at.end - length_at.begin != 4 or (names.end - names.begin) % length:
            raise ValueError(
                f"the names of a struct have {names.end - names.begin} bytes in parts of {length}"
            )
        for _ in range(count * ((names.end - names.begin) // length)):
            check_matrix(data, part(MATRIX), order, depth + 1)
    elif kind in (CELL, FUNCTION):
        for _ in range(count if kind == CELL else 1):
            check_matrix(data, part(MATRIX), order, depth + 1)
    else:
        raise ValueError(f"an array has the class {kind}, expected 1 to 17")
