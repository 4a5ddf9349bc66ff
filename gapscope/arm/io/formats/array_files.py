"""Logs of HDF5 and MATLAB files: arrays under names, as columns."""

from __future__ import annotations

import atexit
import json
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any

import numpy as np
from scipy.constants import giga

from gapscope.arm.errors import InputError, extra
from gapscope.arm.input_file import (
    LARGEST_IN_MEMORY,
    LARGEST_UNPACKED,
    check_file,
    complete_file,
)
from gapscope.arm.io.table import Log, Table, numbered

LARGEST = LARGEST_UNPACKED // np.dtype(float).itemsize
"""Numbers in an array from which it is left unread [1]."""
OF_PYTHON = 2 * giga
"""Memory that a process takes with SciPy and nothing read [bytes]."""

_MATLAB_HDF5 = b"MATLAB 7.3"
_ONE_AT_A_TIME = Lock()


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
    # the start of the file tells the version, its ending does not
    if start == _MATLAB_HDF5:
        arrays, unread = _hdf5_arrays(path, ".")
        return log_of_arrays(path, "MATLAB 7.3", arrays, unread)
    return log_of_arrays(path, "MATLAB", _matlab_arrays(path), [])


def _hdf5_arrays(path: Path, separator: str) -> tuple[dict[str, np.ndarray], list[str]]:
    """Numeric arrays of one or two axes by name, and what else there is."""
    with extra("hdf5", "the file", path):
        import h5py
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

    with complete_file(path, "HDF5"), h5py.File(path, "r") as content:
        content.visititems(collect)
    return arrays, unread


@cache
def _unpacker() -> subprocess.Popen[str]:
    """The process that reads MATLAB files, one after the other."""
    script, largest = Path(__file__).with_name("unpack_mat.py"), LARGEST_UNPACKED
    # one process for all files: each would import SciPy anew
    process = subprocess.Popen(
        [sys.executable, str(script), str(largest + OF_PYTHON)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    atexit.register(process.communicate)
    return process


def _matlab_arrays(path: Path) -> dict[str, np.ndarray]:
    """Numeric arrays of a MATLAB file up to version 7.2 by name, read in a process that a damaged file may end."""
    check_file(path, "is the file complete?", LARGEST_IN_MEMORY)
    # one file at a time goes through the process
    with _ONE_AT_A_TIME, TemporaryDirectory(prefix="gapscope-") as folder:
        out, process = Path(folder) / "arrays.npz", _unpacker()
        assert process.stdin is not None and process.stdout is not None
        request = json.dumps([str(path), str(out), LARGEST_UNPACKED])
        print(request, file=process.stdin, flush=True)
        line = process.stdout.readline()
        # it broke down on this file: the next one gets another process
        if not line:
            _unpacker.cache_clear()
        answer = json.loads(line or '"its reader broke down"')
        if isinstance(answer, list):
            with np.load(out) as content:
                return dict(zip(answer, content.values(), strict=True))
    raise InputError(
        f"cannot be read as a MATLAB file ({answer})",
        "is the file complete? save it again, with -v7",
        file=path,
    )


def log_of_arrays(
    path: Path, kind: str, arrays: Mapping[str, np.ndarray], unread: list[str]
) -> Log:
    """A log from arrays: a table for each number of rows N.

    N is the number of samples of the arrays of one axis; one of two axes has its rows along the axis of such a
    length, else along the longer one.

    Raises:
        InputError: no array has rows.
    """
    # as MATLAB writes vectors, with an axis of length one
    squeezed = {name: np.squeeze(array) for name, array in arrays.items()}
    lengths = {len(a) for a in squeezed.values() if a.ndim == 1 and len(a) > 1}
    by_rows: dict[int, dict[str, np.ndarray]] = {}
    left_out = list(unread)
    for name, array in squeezed.items():
        if array.ndim not in (1, 2) or not array.size:
            left_out.append(f"{name} {array.shape}")
            continue
        if array.ndim == 2:
            rows, width = array.shape
            # one axis has the length of a known series, and the other has not
            told = (rows in lengths) != (width in lengths)
            if not (rows in lengths if told else rows >= width):
                array = array.T
        # by their length: arrays of another belong to another clock
        by_rows.setdefault(len(array), {})[name] = array
    if not by_rows:
        raise InputError(
            f"has no arrays of samples; it has {', '.join(left_out) or 'nothing'}",
            "store time and channels as arrays (N,) or (N, n)",
            file=path,
        )
    tables = []
    for count in sorted(by_rows, reverse=True):
        # named by its rows if the file has several tables
        name = f"{count} rows" if len(by_rows) > 1 else ""
        columns = numbered(by_rows[count])
        tables.append(Table(path, columns, range(1, count + 1), name=name, kind=kind))
    return Log(path, kind, tuple(tables), unread=tuple(left_out))
