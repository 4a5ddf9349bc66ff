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
from collections.abc import Iterator, Sequence
from pathlib import Path

HEADER = 128
MATRIX, COMPRESSED = 14, 15
KINDS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, MATRIX, COMPRESSED, 16, 17, 18})
DEEPEST = 100
"""Arrays within arrays."""
FLAGS, SIZES = 6, (5, 6)
"""Kinds of the first two elements of an array; some programs write sizes without a sign."""
MOST_DIMENSIONS = 32
CELL, STRUCTURE, OBJECT, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 5, 16, 17
"""Classes of arrays that are no plain numbers or characters; the last has no dimensions."""
COMPLEX = 0x800
"""Flag of numbers that have an imaginary part."""


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
            _check_array(part, order)
            _check(part, order, depth + 1)


def _check_array(array: memoryview, order: str) -> None:
    """Check that an array has its dimensions and the parts that these and its class announce.

    Memory is taken by the dimensions before the parts are read, and a part is taken for what should be there.
    """
    # MATLAB writes an empty cell with nothing in it
    if not len(array):
        return
    kinds, parts = zip(*_elements(array, order), strict=True)
    if kinds[0] != FLAGS or len(parts[0]) != 8:
        raise ValueError("an array does not begin with its flags")
    flags = struct.unpack_from(f"{order}I", parts[0])[0]
    of_class = flags & 0xFF
    if of_class == OPAQUE:
        return
    sizes = parts[1] if len(parts) > 1 and kinds[1] in SIZES else memoryview(b"")
    count = len(sizes) // 4
    if len(sizes) % 4 or not 2 <= count <= MOST_DIMENSIONS:
        raise ValueError(f"an array has {count} dimensions")
    numbers = struct.unpack(f"{order}{count}i", sizes)
    entries = 1 if of_class in (SPARSE, FUNCTION) else math.prod(numbers)
    if min(numbers) < 0 or entries > len(array):
        named = " x ".join(map(str, numbers))
        raise ValueError(f"an array of {named} in {len(array)} bytes")

    head, within = 3, 0
    if of_class in (STRUCTURE, OBJECT):
        head += 2 + (of_class == OBJECT)
        within = entries * _field_count(parts[head - 2 : head], order)
    elif of_class in (CELL, FUNCTION):
        within = entries
    else:
        head += (3 if of_class == SPARSE else 1) + bool(flags & COMPLEX)
    arrays = [kind == MATRIX for kind in kinds]
    if len(kinds) != head + within or any(arrays[:head]) or not all(arrays[head:]):
        raise ValueError("an array has other parts than its class and size announce")


def _field_count(parts: Sequence[memoryview], order: str) -> int:
    """Number of fields of a structure, from the length of a name and all names one after the other."""
    if len(parts) < 2 or len(parts[0]) != 4:
        raise ValueError("a structure has no names")
    (length,) = struct.unpack(f"{order}i", parts[0])
    if length < 1:
        raise ValueError(f"a structure has names of {length} bytes")
    return len(parts[1]) // length


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
