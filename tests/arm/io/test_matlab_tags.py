"""Tags of MATLAB files: what SciPy writes is accepted, and what would end its reader is refused."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy.sparse import eye_array

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.array_files import check_tags, read_mat

CONTENT = {
    "t": np.arange(5.0),
    "log": {"q": np.eye(3), "name": "arm", "more": {"empty": np.zeros((0, 2))}},
    "cells": np.array([1.0, "two", np.eye(2)], dtype=object),
    "sparse": eye_array(4, format="csc"),
    "waves": np.array([1 + 2j, 3.0]),
    "counts": np.arange(3, dtype=np.uint8),
    "yes": np.array([True, False]),
}


@pytest.mark.parametrize("packed", [False, True])
def test_what_scipy_writes_is_accepted(packed: bool, tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, CONTENT, do_compression=packed, long_field_names=True)
    check_tags(path)
    assert read_mat(path).tables


@pytest.mark.parametrize(
    ("place", "change", "message"),
    [
        (0xB0, b"\x09\x80", "kind 32777"),
        (0xB4, b"\xff\xff", "beyond what it is part of"),
        (0x98, b"\x05\x00\x08\x00", "four have room"),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_other_tags_are_refused(
    place: int, change: bytes, message: str, packed: bool, tmp_path: Path
) -> None:
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"t": np.arange(60.0)}, do_compression=False)
    content = bytearray(path.read_bytes())
    content[place : place + len(change)] = change
    if packed:
        whole = zlib.compress(bytes(content[128:]))
        tag = np.array([15, len(whole)], dtype="<u4").tobytes()
        content = content[:128] + tag + whole
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_mat(path)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ([5, 8, 1, 2**30], "an array of 1 x 1073741824 in"),
        ([5, 8, -1, 3], "an array of -1 x 3 in"),
        ([5, 0, 5, 0], "an array has 0 dimensions"),
    ],
)
def test_a_cell_whose_dimensions_are_none_is_refused(
    changed: list[int], message: str, tmp_path: Path
) -> None:
    """They are 1 x 3, of kind 5 and size 8; SciPy takes memory by them, and without any ends the process."""
    path = tmp_path / "log.mat"
    cells = np.array([1.0, 2.0, 3.0], dtype=object)
    scipy.io.savemat(path, {"cells": cells}, do_compression=False)
    content = path.read_bytes()
    dimensions = np.array([5, 8, 1, 3], dtype="<i4").tobytes()
    assert dimensions in content
    other = np.array(changed, dtype="<i4").tobytes()
    path.write_bytes(content.replace(dimensions, other, 1))
    with pytest.raises(InputError, match=message):
        read_mat(path)


def test_an_array_that_lacks_the_parts_it_announces_is_refused(tmp_path: Path) -> None:
    """Flagged as complex without an imaginary part: SciPy takes the next array for it, and ends the process."""
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"t": np.arange(3.0), "q": np.eye(3)}, do_compression=False)
    flags, flagged = (np.array([6, 8, x], dtype="<u4").tobytes() for x in (6, 0x806))
    content = path.read_bytes()
    assert content.count(flags) == 2
    path.write_bytes(content.replace(flags, flagged, 1))
    with pytest.raises(InputError, match="other parts than its class"):
        read_mat(path)
