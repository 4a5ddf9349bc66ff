"""Paths that lead to no regular file, documents that stand for more than they hold, names that lead out."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from gapscope.arm import input_file
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import check_file, file_beside, read_arrays
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.io.formats import array_files
from gapscope.arm.io.json_file import read_json
from gapscope.arm.io.log import open_log
from gapscope.arm.nominal import LARGEST, NominalArm
from gapscope.arm.robots import load_nominal_arm

ODD: dict[str, tuple[Callable[[Path], None], str]] = {
    "FIFO": (os.mkfifo, "is a FIFO, expected a file"),
    "device": (lambda path: path.symlink_to("/dev/zero"), "is a device, expected a"),
    "folder": (Path.mkdir, "is a folder, expected a file"),
    "loop": (lambda path: path.symlink_to(path), "no such file .*symbolic links"),
    "absent": (lambda path: None, "no such file"),
}


LOGS = ("log.csv", "log.db3", "log.h5", "log.mat")
READ: dict[str, Callable[..., object]] = {
    **{name: lambda path, _: open_log(path) for name in LOGS},
    "x.yaml": read_yaml,
    "x.json": read_json,
    "x.npz": read_arrays,
}


ASKED = [(x, name) for x in ODD for name in READ if x != "folder" or name not in LOGS]
"""A folder may be a log."""


@pytest.mark.parametrize(("odd", "name"), ASKED)
def test_what_is_no_file_is_refused(odd: str, name: str, tmp_path: Path) -> None:
    make, message = ODD[odd]
    make(tmp_path / name)
    with pytest.raises(InputError, match=message) as caught:
        READ[name](tmp_path / name, "mend it")
    assert caught.value.file == tmp_path / name


def test_a_bag_or_data_set_with_a_fifo_inside_does_not_hang(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "metadata.yaml")
    with pytest.raises(InputError, match=r"metadata.yaml: is a FIFO"):
        open_log(tmp_path)


@pytest.mark.parametrize("path", ["r" * 5000, "r" * 300 + ".csv", "a/" * 3000])
def test_a_name_too_long_for_a_file_system_is_that_of_no_file(path: str) -> None:
    with pytest.raises(InputError, match="no such file .*too long"):
        open_log(path)
    with pytest.raises(InputError, match="no such URDF file"):
        load_nominal_arm(path)


def test_large_files_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(InputError, match="has 0.1 GB, at most 0.05 GB are read"):
        read_json(path, "")
    check_file(path, "")


@pytest.mark.parametrize("name", ["../x", "/etc/hostname", "link", "", None, "a\0b", 3])
def test_a_result_names_files_of_its_folder_alone(name: object, tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "link").symlink_to(tmp_path / "x")
    with pytest.raises(InputError, match="field: (names|expected)"):
        file_beside(inside, name, inside / "document", "field")
    assert file_beside(inside, "a/b", inside / "d", "f") == inside / "a" / "b"


LETTERS = zip("abcdefghi", "bcdefghij", strict=True)
ALIASES = "".join(f"{b}: &{b} [{','.join([f'*{a}'] * 10)}]\n" for a, b in LETTERS)
REFUSED = [
    ("x.yaml", f"a: &a [1]\n{ALIASES}", "aliases stand for more than"),
    ("x.yaml", "&a [*a]", "stands for what it is part of"),
    ("x.yaml", "[" * 5000, "nested too deeply"),
    ("x.yaml", "x: 2020-99-99", "month must be"),
    ("x.yaml", "x: " + "9" * 5000, "is not valid YAML"),
    ("x.yaml", "x: " + "9" * 30, "beyond any that counts"),
    ("x.yaml", "!!python/object/apply:os.system [exit]", "could not determine a cons"),
    ("x.yaml", "!!map [1]", "expected a mapping"),
    ("x.json", "[" * 100_000, "nested too deeply"),
    ("x.json", "[1" + "0" * 400 + "]", "whole number of 401"),
]
"""Texts that stand for too much, or for what no number can be."""


@pytest.mark.parametrize(("name", "text", "message"), REFUSED)
def test_documents_that_stand_for_too_much(
    name: str, text: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        READ[name](tmp_path / name, "mend it")


def test_yaml_keeps_aliases_that_stand_for_little(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text("a: &a [1, 2]\nb: *a\nc: {<<: {d: 1e-3}}\n")
    assert read_yaml(path, "") == {"a": [1, 2], "b": [1, 2], "c": {"d": 1e-3}}


def test_npz_of_a_pickle_or_without_a_header_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "pickle.npz", t=np.array([{}], object))
    with pytest.raises(InputError, match="Object arrays cannot be loaded"):
        read_arrays(tmp_path / "pickle.npz", "")
    with zipfile.ZipFile(tmp_path / "odd.npz", "w") as archive:
        archive.writestr("t.npy", b"\x93NUMPY\x01\x00\xff\xff")
    with pytest.raises(InputError, match="cannot be read as NPZ"):
        read_arrays(tmp_path / "odd.npz", "")


def test_files_of_runs_are_refused_before_they_are_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    series = {"t": np.zeros(100_000)}
    np.savez_compressed(tmp_path / "a.npz", **series)
    pq.write_table(pa.table(series), tmp_path / "a.parquet")
    scipy.io.savemat(tmp_path / "a.mat", series, do_compression=True)
    assert (tmp_path / "a.parquet").stat().st_size < 5000
    open_log(tmp_path / "a.mat")
    for module in (input_file, array_files):
        monkeypatch.setattr(module, "LARGEST_UNPACKED", 500_000)
    for ending in ("npz", "parquet", "mat"):
        with pytest.raises(InputError, match=r"(GB|8e.05 bytes) unpacked"):
            open_log(tmp_path / f"a.{ending}")


def test_hdf5_arrays_that_lie_in_another_file_are_left_unread(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    secret = tmp_path / "secret.bin"
    secret.write_bytes(np.arange(8.0).tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = np.arange(8.0)
        place = [(str(secret), 0, 64)]
        file.create_dataset("q1", (8,), "f8", external=place)
    log = open_log(tmp_path / "a.h5")
    assert list(log.tables[0].columns) == ["t"]
    assert log.unread == ("q1 (8,)",)


BAD_ARMS = [
    ('<mass value="1"/>', '<mass value="1e30"/>', "a mass of 1e"),
    ('xyz="0 0 0.2"', 'xyz="0 0 1e9"', "a length of 1e"),
    ('ixx="0.1"', 'ixx="1e30"', "a moment of inertia of 1e"),
    ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "joint shoulder: its axis has no"),
    ('damping="0.5"', 'damping="soft"', "line 4, joint shoulder, <dynamics damping>: expected a number"),
    ('<origin xyz="0 0 0"', '<origin xyz="0 nan 0"', "joint shoulder, <origin xyz>: expected 3 numbers"),
]  # fmt: skip


@pytest.mark.parametrize(("before", "after", "message"), BAD_ARMS)
def test_numbers_beyond_any_arm_name_link_or_joint(
    before: str, after: str, message: str, urdf: Path
) -> None:
    text = urdf.read_text()
    assert before in text
    urdf.write_text(text.replace(before, after, 1))
    with pytest.raises(InputError, match=message) as caught:
        RigidBody(load_nominal_arm(urdf))
    assert caught.value.file == urdf


@pytest.mark.parametrize("name", ["armature", "coulomb", "viscous", "gravity"])
def test_so_do_those_of_a_data_sheet(name: str, arm: NominalArm) -> None:
    size = 3 if name == "gravity" else 2
    largest = max(bound for bound, _ in LARGEST.values())
    with pytest.raises(InputError, match=f"nominal.{name}: .* beyond any arm's"):
        NominalArm("two", arm.urdf, arm.joints, **{name: np.full(size, 2 * largest)})
