"""Tags of a MATLAB file of version 5 to 7.2: SciPy's reader trusts the kinds that they name, and ends the process.

After a header of 128 bytes a file is a sequence of elements: kind and size as two 32-bit numbers, then the content,
filled up to a multiple of eight bytes. Of up to four bytes size and kind share the first number, and the content is the
second. An array is an element whose content is a sequence of elements again: first its flags, whose lowest byte is its
class, then its dimensions. Source: MathWorks, MAT-File Format.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

HEADER = 128
MATRIX, COMPRESSED = 14, 15
KINDS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, MATRIX, COMPRESSED, 16, 17, 18})
DEEPEST = 100
"""Arrays within arrays."""
FLAGS, SIZES = 6, (5, 6)
"""Kinds of the first two elements of an array; some programs write sizes without a sign."""
MOST_DIMENSIONS = 32
SPARSE, FUNCTION, OPAQUE = 5, 16, 17
"""Classes whose dimensions are not those of what the file holds; the last has none."""


def byte_order(header: bytes) -> str | None:
    """Order of the bytes as ``struct`` has it; ``None`` if the header is not that of version 5."""
    return {b"IM": "<", b"MI": ">"}.get(header[126:HEADER])


def check_tags(path: Path) -> None:
    """Check the tags of all elements; of files of version 4, which have none, nothing.

    Raises:
        ValueError: one is of no kind that there is, or reaches beyond what it is part of, or an array has more entries
            than bytes.
        zlib.error: a compressed element is damaged.
    """
    with path.open("rb") as file:
        order = byte_order(file.read(HEADER))
        if order is None:
            return
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            packed = file.read(size)
            whole = zlib.decompress(packed) if kind == COMPRESSED else tag + packed
            _check(memoryview(whole), order, 0)


def _check(content: memoryview, order: str, depth: int) -> None:
    """Check a sequence of elements."""
    if depth > DEEPEST:
        raise ValueError("arrays are nested too deeply")
    for kind, part in _elements(content, order):
        if kind not in KINDS or (kind == COMPRESSED and depth):
            raise ValueError(f"an element is of kind {kind}, which there is not")
        if kind == MATRIX:
            _check_dimensions(part, order)
            _check(part, order, depth + 1)


def _check_dimensions(array: memoryview, order: str) -> None:
    """Check that an array has dimensions, and no more entries than bytes: memory is taken before these are read."""
    parts = list(islice(_elements(array, order), 2))
    # MATLAB writes an empty cell with nothing in it
    if not len(array):
        return
    if len(parts) < 2 or parts[0][0] != FLAGS or len(parts[0][1]) != 8:
        raise ValueError("an array does not begin with its flags")
    (_, flags), (kind, sizes) = parts
    of_class = struct.unpack_from(f"{order}I", flags)[0] & 0xFF
    if of_class == OPAQUE:
        return
    count = len(sizes) // 4
    if kind not in SIZES or len(sizes) % 4 or not 2 <= count <= MOST_DIMENSIONS:
        raise ValueError(f"an array has {count} dimensions")
    numbers = struct.unpack(f"{order}{count}i", sizes)
    larger = of_class not in (SPARSE, FUNCTION) and math.prod(numbers) > len(array)
    if min(numbers) < 0 or larger:
        named = " x ".join(map(str, numbers))
        raise ValueError(f"an array of {named} in {len(array)} bytes")


def _elements(content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Kind and content of each element of a sequence."""
    place = 0
    while place + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, place)
        start = place + 8
        if kind >> 16:
            kind, size, start = kind & 0xFFFF, kind >> 16, place + 4
            if size > 4:
                raise ValueError(f"an element of {size} bytes where four have room")
        if start + size > len(content):
            raise ValueError("an element reaches beyond what it is part of")
        yield kind, content[start : start + size]
        place = start + size
        place += -place % 8
