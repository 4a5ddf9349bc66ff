"""Files of arrays: NPZ, HDF5, MATLAB with its tags."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import LARGEST_IN_MEMORY, LARGEST_UNPACKED, check_file
from gapscope.arm.io.table import Log, LogTable, Table

# Tags of a MATLAB file of version 5 to 7.2: SciPy's reader trusts the kinds that they name, and ends the process.
#
# After a header of 128 bytes a file is a sequence of elements: kind and size as two 32-bit numbers, then the content,
# filled up to a multiple of eight bytes. Of up to four bytes size and kind share the first number, and the content is
# the second. An array is an element whose content is a sequence of elements again: first its flags, whose lowest byte
# is its class, then its dimensions. Source: MathWorks, MAT-File Format.


HEADER = 128
MATRIX, COMPRESSED = 14, 15
KINDS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, MATRIX, COMPRESSED, 16, 17, 18})
DEEPEST = 100
"""Arrays within arrays."""
FLAGS, SIZES = 6, (5, 6)
"""Kinds of the first two elements of an array; some programs write sizes without a sign."""
MAX_DIMENSIONS = 32
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
    if len(sizes) % 4 or not 2 <= count <= MAX_DIMENSIONS:
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


# Logs of HDF5 and MATLAB files: arrays under names, as columns.


LARGEST = 100_000_000
"""Numbers in an array from which it is left unread [1]: 800 MB."""

_MATLAB_HDF5 = b"MATLAB 7.3"
_PIECE = 1_000_000


def read_hdf5(path: Path) -> Log:
    """Arrays of an HDF5 file by their path in it, ``robot/q``; (N, n) and (n, N) become ``robot/q1..``.

    Raises:
        InputError: h5py is not installed, or the file is damaged or has no arrays.
    """
    arrays, unread = _hdf5_arrays(path, "/")
    return log_of_arrays(path, "HDF5", arrays, unread)


def read_mat(path: Path) -> Log:
    """Arrays of a MATLAB file by their name, those in structures as ``log.q``.

    Up to version 7.2 by SciPy, 7.3 as the HDF5 file that it is.

    Raises:
        InputError: the file is damaged or has no arrays, or is of version 7.3 and h5py is not installed.
    """
    with path.open("rb") as file:
        start = file.read(len(_MATLAB_HDF5))
    if start == _MATLAB_HDF5:
        arrays, unread = _hdf5_arrays(path, ".")
        return log_of_arrays(path, "MATLAB 7.3", arrays, unread)
    return log_of_arrays(path, "MATLAB", _matlab_arrays(path), [])


def _hdf5_arrays(path: Path, separator: str) -> tuple[dict[str, np.ndarray], list[str]]:
    """Numeric arrays of one or two axes by name, and what else there is."""
    try:
        import h5py
    except ImportError:
        raise InputError(
            "needs h5py to be read", "pip install 'gapscope[hdf5]'", file=path
        ) from None
    arrays: dict[str, np.ndarray] = {}
    unread: list[str] = []

    def collect(name: str, item: Any) -> None:
        # what MATLAB 7.3 keeps to itself
        if not isinstance(item, h5py.Dataset) or not isinstance(name, str):
            return
        if name.startswith("#"):
            return
        label = name.replace("/", separator)
        # what lies in another file is not part of this one
        elsewhere = item.external or item.is_virtual
        numeric = item.ndim in (1, 2) and item.dtype.kind in "fiub"
        if numeric and item.size <= LARGEST and not elsewhere:
            arrays[label] = item[()]
        else:
            unread.append(f"{label} {item.shape}")

    try:
        with h5py.File(path, "r") as content:
            content.visititems(collect)
    # a name in no encoding that is known is a TypeError
    except (
        OSError,
        RuntimeError,
        ValueError,
        TypeError,
        KeyError,
        MemoryError,
    ) as error:
        raise InputError(
            f"cannot be read as HDF5 ({error})", "is the file complete?", file=path
        ) from None
    return arrays, unread


def _matlab_arrays(path: Path) -> dict[str, np.ndarray]:
    """Numeric arrays of a MATLAB file up to version 7.2 by name."""
    import scipy.io

    check_file(path, "is the file complete?", LARGEST_IN_MEMORY)
    try:
        _check_unpacked(path)
        check_tags(path)
        content = scipy.io.loadmat(path, simplify_cells=True)
    except InputError:
        raise
    # the reader stumbles over damaged files in as many ways as it has lines
    except Exception as error:
        raise InputError(
            f"cannot be read as a MATLAB file ({error})",
            "is the file complete? save it again, with -v7",
            file=path,
        ) from None
    arrays: dict[str, np.ndarray] = {}
    _collect(content, "", arrays)
    return arrays


def _check_unpacked(path: Path) -> None:
    """Check that the compressed variables of a file are not beyond ``LARGEST_UNPACKED``.

    After a header of 128 bytes each variable has two numbers, its kind and size [bytes].

    Raises:
        InputError: they are.
        zlib.error, struct.error: the file is damaged.
    """
    unpacked = 0
    with path.open("rb") as file:
        order = byte_order(file.read(HEADER)) or "<"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            left = size
            if kind != COMPRESSED:
                file.seek(size, 1)
                continue
            stream = zlib.decompressobj()
            while left > 0 and (packed := file.read(min(left, _PIECE))):
                left -= len(packed)
                while packed and unpacked <= LARGEST_UNPACKED:
                    unpacked += len(stream.decompress(packed, _PIECE))
                    packed = stream.unconsumed_tail
            if unpacked > LARGEST_UNPACKED:
                raise InputError(
                    f"holds more than {LARGEST_UNPACKED / 1e9:g} GB unpacked",
                    "cut the motion to be examined out of it",
                    file=path,
                )


def _collect(content: Any, name: str, arrays: dict[str, np.ndarray]) -> None:
    """Adds the arrays of nested structures by their names; those of a list are counted from 1."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            if not str(key).startswith("__"):
                _collect(value, f"{name}.{key}" if name else str(key), arrays)
    elif isinstance(content, list):
        for number, value in enumerate(content, start=1):
            _collect(value, f"{name}.{number}", arrays)
    elif isinstance(content, np.ndarray) and content.dtype.kind in "fiub":
        arrays[name] = content


def log_of_arrays(
    path: Path, kind: str, arrays: Mapping[str, np.ndarray], unread: list[str]
) -> Log:
    """A log from arrays: a table for each number of rows N.

    N is the number of samples of the arrays of one axis; one of two axes has its rows along the axis of such a
    length, else along the longer one.

    Raises:
        InputError: no array has rows.
    """
    squeezed = {name: np.squeeze(array) for name, array in arrays.items()}
    lengths = {len(a) for a in squeezed.values() if a.ndim == 1 and len(a) > 1}
    by_rows: dict[int, dict[str, np.ndarray]] = {}
    left_out = list(unread)
    for name, array in squeezed.items():
        if array.ndim not in (1, 2) or not array.size:
            left_out.append(f"{name} {array.shape}")
            continue
        array = _rows_first(array, lengths)
        by_rows.setdefault(len(array), {})[name] = array
    if not by_rows:
        raise InputError(
            f"has no arrays of samples; it has {', '.join(left_out) or 'nothing'}",
            "store time and channels as arrays (N,) or (N, n)",
            file=path,
        )
    tables = [_table(path, kind, group, by_rows) for group in by_rows.values()]
    tables.sort(key=lambda table: -len(table.table))
    return Log(path, kind, tuple(tables), unread=tuple(left_out))


def _rows_first(array: np.ndarray, lengths: set[int]) -> np.ndarray:
    """An array of one or two axes, with the samples along the first."""
    if array.ndim == 1:
        return array
    rows, columns = array.shape
    if (rows in lengths) != (columns in lengths):
        return array if rows in lengths else array.T
    return array if rows >= columns else array.T


def _table(
    path: Path, kind: str, arrays: Mapping[str, np.ndarray], every: Mapping[int, Any]
) -> LogTable:
    """Arrays with the same number of rows; named by its rows if the file has several tables."""
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.ndim == 1:
            columns[name] = array
            continue
        for j, column in enumerate(array.T, start=1):
            columns[f"{name}{j}"] = column
    count = len(next(iter(columns.values())))
    name = f"{count} rows" if len(every) > 1 else ""
    return LogTable(name, kind, Table(path, columns, range(1, count + 1)))
