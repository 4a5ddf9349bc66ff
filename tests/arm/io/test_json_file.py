"""JSON files: converted to plain data, finite, written whole, readable by their owner alone on request."""

from __future__ import annotations

import json
import stat
import sys
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import plain, read_json, to_json, write_json


def test_plain_data_and_numbers_that_are_not_finite(tmp_path: Path) -> None:
    pair = (np.float64(0.5), "é")
    value = MappingProxyType({"a": np.arange(2), "b": pair, "c": np.bool_(True)})
    made = plain(value)
    assert made == {"a": [0, 1], "b": [0.5, "é"], "c": True}
    assert type(made["a"][0]) is int and type(made["c"]) is bool
    values = {"a": [np.nan, 1.0], "b": float("inf")}
    assert plain(values, null_if_not_finite=True) == {"a": [None, 1.0], "b": None}
    assert json.loads(to_json(values, allow_nan=True))["b"] == float("inf")
    # what cannot be written leaves the file before
    path = tmp_path / "deep" / "a.json"
    write_json(made, path)
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(values, path)
    assert read_json(path, "") == made
    assert [file.name for file in path.parent.iterdir()] == ["a.json"]


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX permissions")
def test_private_files_are_readable_by_their_owner_alone(tmp_path: Path) -> None:
    write_json([], tmp_path / "a.json", private=True)
    assert stat.S_IMODE((tmp_path / "a.json").stat().st_mode) == 0o600


def test_a_seed_of_64_bits_is_read_again_and_what_no_computer_counts_with_is_not(
    tmp_path: Path,
) -> None:
    path = tmp_path / "labels.json"
    write_json({"seed": 2**64 - 1}, path)
    assert read_json(path, "") == {"seed": 2**64 - 1}
    write_json({"seed": 2**64}, path)
    with pytest.raises(InputError, match="whole number of 20 digits"):
        read_json(path, "")
