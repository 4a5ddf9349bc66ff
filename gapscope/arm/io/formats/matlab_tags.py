"""Tags of a MATLAB file of version 5 to 7.2: SciPy's reader trusts the kinds that they name, and ends the process.

After a header of 128 bytes a file is a sequence of elements: kind and size as two 32-bit numbers, then the content,
filled up to a multiple of eight bytes. Of up to four bytes size and kind share the first number, and the content is the
second. An array is an element whose content is a sequence of elements again. Source: MathWorks, MAT-File Format.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

HEADER = 128
MATRIX, COMPRESSED = 14, 15
KINDS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, MATRIX, COMPRESSED, 16, 17, 18})
DEEPEST = 100
"""Arrays within arrays."""


def byte_order(header: bytes) -> str | None:
    """Order of the bytes as ``struct`` has it; ``None`` if the header is not that of version 5."""
    return {b"IM": "<", b"MI": ">"}.get(header[126:HEADER])


def check_tags(path: Path) -> None:
    """Check the tags of all elements; of files of version 4, which have none, nothing.

    Raises:
        ValueError: one is of no kind that there is, or reaches beyond what it is part of.
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
            _check(part, order, depth + 1)


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
