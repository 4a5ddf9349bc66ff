"""Logs of HDF5 and MATLAB files: arrays under names, as columns."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import LARGEST_IN_MEMORY, LARGEST_UNPACKED, check_file
from gapscope.arm.io.formats.matlab_tags import (
    COMPRESSED,
    HEADER,
    byte_order,
    check_tags,
)
from gapscope.arm.io.log_table import Log, LogTable
from gapscope.arm.io.table import Table

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
