"""HDF5 and MATLAB files of other programs: h5py's and SciPy's writers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from gapscope.arm.errors import InputError
from gapscope.arm.io.import_section import parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import open_log
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

h5py = pytest.importorskip("h5py")

T = np.arange(100) / 100
Q = np.column_stack([np.sin(3 * T), np.cos(4 * T)])
SECTION = {"time": "robot/t", "q": "robot/q{j}", "tau": {"column": "robot/tau{j}"}}


@pytest.fixture
def read(arm: NominalArm) -> Callable[..., Recording]:
    """A recording by an import section."""

    def of(path: Path, **section: Any) -> Recording:
        return load_recording(path, arm, parse_import(section, 2, Path("case.yaml")))

    return of


@pytest.mark.parametrize("transposed", [False, True])
def test_hdf5_with_rows_along_either_axis(
    transposed: bool, read: Callable[..., Recording], tmp_path: Path
) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["robot/t"] = T
        file["robot/q"] = Q.T if transposed else Q
        file["robot/tau"] = -Q.T if transposed else -Q
        file["camera"] = np.zeros((3, 4, 5))
        file["name"] = "arm"
        file["loop"] = h5py.SoftLink("/robot")
        file["elsewhere"] = h5py.ExternalLink("other.h5", "/q")
    recording = read(path, **SECTION)
    np.testing.assert_array_equal(recording.q, Q)
    np.testing.assert_array_equal(recording.tau, -Q)
    assert set(open_log(path).unread) == {"camera (3, 4, 5)", "name ()"}


def test_hdf5_with_two_rates(tmp_path: Path) -> None:
    """And a size that is declared beyond memory."""
    path = tmp_path / "log.hdf5"
    with h5py.File(path, "w") as file:
        file["fast/t"], file["fast/q"] = T, Q
        file["slow/t"], file["slow/q"] = T[::2], Q[::2].T
        file.create_dataset("huge", shape=(10**12,), chunks=(10**6,), dtype="f8")
    log = open_log(path)
    assert log.names == ["100 rows", "50 rows"]
    assert list(log.tables[1].columns) == ["slow/q1", "slow/q2", "slow/t"]
    assert log.unread == ("huge (1000000000000,)",)


def test_hdf5_whose_torque_has_another_rate_and_no_time_says_so(
    arm: NominalArm, tmp_path: Path
) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["t"], file["q"], file["tau"] = T, Q, Q[::2]
    told = "tau of 50 rows left out: it has 50 rows, the positions have 100"
    with pytest.raises(InputError, match=told):
        load_recording(path, arm, complete=True)
    assert any(told in note for note in load_recording(path, arm).notes)


def test_matlab_structures(read: Callable[..., Recording], tmp_path: Path) -> None:
    log = {"t": T[:, None], "joints": {"q": Q.T}, "rate": 100.0, "label": "arm"}
    scipy.io.savemat(tmp_path / "log.mat", {"log": log})
    recording = read(tmp_path / "log.mat", time="log.t", q="log.joints.q{j}")
    np.testing.assert_array_equal(recording.q, Q)


def test_matlab_7_3_is_hdf5(read: Callable[..., Recording], tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        # MATLAB stores columns first: rows of (N, n) along the second axis
        file["log/t"], file["log/q"] = T[None, :], Q.T
        file["#refs#/a"] = T
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116))
    recording = read(path, time="log.t", q="log.q{j}")
    np.testing.assert_array_equal(recording.q, Q)
    assert open_log(path).format == "MATLAB 7.3"


CONTENTS = (b"", b"t,q1,q2\n0,1,2\n", bytes(range(256)) * 40, b"\x89HDF\r\n\x1a\n")


@pytest.mark.parametrize("ending", ["h5", "mat", "npz", "parquet", "mcap", "db3"])
def test_files_that_are_not_what_their_ending_says(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"log.{ending}"
    for content in CONTENTS:
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"log.{ending}"):
            open_log(path)


def test_text_tables_with_a_marked_header(arm: NominalArm, tmp_path: Path) -> None:
    for ending in ("txt", "dat", "asc"):
        path = tmp_path / f"log.{ending}"
        np.savetxt(path, np.column_stack([T, Q]), header="t q1 q2")
        np.testing.assert_allclose(load_recording(path, arm).q, Q)
