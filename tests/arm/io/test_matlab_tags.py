"""MATLAB files: what SciPy writes is read, and what would end its reader is an error."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy.sparse import eye_array

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.array_files import read_mat

CONTENT = {
    "t": np.arange(5.0),
    "log": {"q": np.eye(3), "name": "arm", "more": {"empty": np.zeros((0, 2))}},
    "cells": np.array([1.0, "two", np.eye(2)], dtype=object),
    "sparse": eye_array(4, format="csc"),
    "waves": np.array([1 + 2j, 3.0]),
    "counts": np.arange(3, dtype=np.uint8),
    "yes": np.array([True, False]),
}
THREE = np.array([5, 8, 1, 3], dtype="<i4").tobytes()
"""Dimensions of a cell of 1 x 3: kind 5 and size 8 before them; SciPy takes memory by them."""
REAL, COMPLEX = (np.array([6, 8, x], dtype="<u4").tobytes() for x in (6, 0x806))
"""Flags of an array of numbers; of a complex one SciPy takes the next array for its imaginary part."""
SPOILT = {
    "another kind": (0xB0, b"\x09\x80"),
    "beyond the file": (0xB4, b"\xff\xff"),
    "too large for a small element": (0x98, b"\x05\x00\x08\x00"),
    "many cells": (THREE, np.array([5, 8, 1, 2**30], dtype="<i4").tobytes()),
    "negative cells": (THREE, np.array([5, 8, -1, 3], dtype="<i4").tobytes()),
    "no dimensions": (THREE, np.array([5, 0, 5, 0], dtype="<i4").tobytes()),
    "no imaginary part": (REAL, COMPLEX),
}


@pytest.mark.parametrize("packed", [False, True])
def test_what_scipy_writes_is_read(packed: bool, tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, CONTENT, do_compression=packed, long_field_names=True)
    (rows, *_) = read_mat(path).tables
    assert {"t", "log.q1"} <= {n for x in read_mat(path).tables for n in x.columns}
    assert len(rows) == 5


@pytest.mark.parametrize("spoilt", SPOILT)
@pytest.mark.parametrize("packed", [False, True])
def test_a_damaged_file_is_an_error_and_the_next_one_is_read(
    spoilt: str, packed: bool, tmp_path: Path
) -> None:
    path, sound = tmp_path / "log.mat", tmp_path / "sound.mat"
    cells = np.array([1.0, 2.0, 3.0], dtype=object)
    content = {"t": np.arange(60.0), "cells": cells}
    scipy.io.savemat(path, content, do_compression=False)
    sound.write_bytes(path.read_bytes())
    place, change = SPOILT[spoilt]
    raw = path.read_bytes()
    if isinstance(place, int):
        raw = raw[:place] + change + raw[place + len(change) :]
    else:
        assert place in raw
        raw = raw.replace(place, change, 1)
    if packed:
        whole = zlib.compress(raw[128:])
        raw = raw[:128] + np.array([15, len(whole)], dtype="<u4").tobytes() + whole
    path.write_bytes(raw)
    with pytest.raises(InputError, match="log.mat: cannot be read as a MATLAB file"):
        read_mat(path)
    assert len(read_mat(sound).tables[0]) == 60
