"""A reference in a folder: what is written comes back, and what is not whole or not its own is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic

import gapscope
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose_change import (
    KeptReference,
    diagnose_change,
    identified_folder,
    read_reference,
    write_reference,
)
from gapscope.provenance import made_from


def recording(name: str, samples: int, payload: KnownLoad | None = None) -> Recording:
    """A recording of three joints with figures without a short decimal form."""
    rng = np.random.default_rng(samples)
    q, tau = rng.standard_normal((2, samples, 3))
    return Recording(name, np.arange(samples) / 3.0, q, tau, payload=payload)


def reference(**changes: Any) -> KeptReference:
    """A reference of the three-joint arm with made-up figures."""
    values: dict[str, Any] = {
        "name": "friday",
        "joints": synthetic.arm().joints,
        "coupled_motors": (),
        "gravity": synthetic.arm().gravity,
        "urdf": synthetic.URDF,
        "armature": np.array([0.1, 0.2, 1.0 / 3.0]),
        "coulomb": np.array([1.0, 2.0, 3.0]),
        "viscous": np.array([0.5, 0.0, 0.7]),
        "recordings": (
            recording("a.csv", 50),
            recording("b.csv", 40, KnownLoad(1.0 / 3.0, (0.0, 0.1, 0.2))),
        ),
        "faults": frozenset({("dropped_samples", ""), ("time_stamps", "rounded")}),
        "warnings": ("joint 2 hardly moves",),
        "made_from": {"case_sha256": "12", "program_sha256": "34"},
    }
    return KeptReference(**{**values, **changes})


def same(a: Any, b: Any) -> bool:
    """Whether two values are equal to the last bit."""
    if isinstance(a, tuple) and a and isinstance(a[0], Recording):
        channels = ("name", "t", "q", "tau", "payload")
        return all(
            np.array_equal(getattr(one, name), getattr(two, name))
            for one, two in zip(a, b, strict=True)
            for name in channels
        )
    return bool(np.array_equal(a, b))


def test_what_is_written_comes_back_to_the_last_bit(tmp_path):
    written = reference()
    path = write_reference(written, tmp_path / "identified")
    assert path == tmp_path / "identified" / "reference.json"
    found = read_reference(tmp_path / "identified")
    assert found.file == path
    for field in fields(KeptReference):
        if field.name != "file":
            a, b = getattr(written, field.name), getattr(found, field.name)
            assert same(a, b), field.name
    assert {file.name for file in path.parent.iterdir()} == {DOCUMENT, ARRAYS, ROBOT}


def gone(folder: Path, name: str) -> None:
    (folder / name).unlink()


def cut(folder: Path, name: str) -> None:
    (folder / name).write_bytes((folder / name).read_bytes()[:100])


def edited(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path, str], None]:
    """Changes a document."""

    def apply(folder: Path, name: str) -> None:
        content = json.loads((folder / name).read_text())
        change(content)
        (folder / name).write_text(json.dumps(content))

    return apply


DOCUMENT, ARRAYS, ROBOT = "reference.json", "reference.npz", "identified.urdf"


def edit(change: Callable[[dict[str, Any]], Any], says: str) -> tuple[Any, ...]:
    """A document that was changed, and what is said of it."""
    return DOCUMENT, edited(change), says


DAMAGED = [
    (DOCUMENT, gone, "reference.json: is missing.*end"),
    (DOCUMENT, cut, "is not valid JSON"),
    (ARRAYS, gone, "reference.npz: no such file"),
    (ARRAYS, cut, "reference.npz, field files.reference.npz"),
    (ROBOT, gone, "identified.urdf: no such file"),
    (ROBOT, cut, "field files.identified.urdf of reference.json: is not the"),
    edit(lambda c: c.update(schema=1), "field schema: is of schema 1"),
    edit(lambda c: c.pop("coulomb"), "'coulomb' is a required"),
    edit(lambda c: c["coulomb"].pop(), "field coulomb: has 2 numbers, the arm has 3 j"),
    edit(lambda c: c["recordings"][0].update(samples=49), r"npz, t1: .* shape \(49,\)"),
    edit(
        lambda c: c["recordings"][1]["payload"].update(mass=-1.0),
        "field recordings.1.payload.mass: -1.0",
    ),
    edit(lambda c: c["faults"].append("late"), "faults.2: 'late'"),
]


@pytest.mark.parametrize(("name", "damage", "says"), DAMAGED)
def test_what_is_not_whole_is_refused_with_file_field_and_remedy(
    name, damage, says, tmp_path
):
    write_reference(reference(), tmp_path)
    damage(tmp_path, name)
    folder = identified_folder(tmp_path)
    assert folder == tmp_path
    with pytest.raises(InputError, match=says) as error:
        read_reference(folder)
    assert error.value.file.parent == tmp_path
    assert error.value.remedy


def test_a_case_is_told_from_an_identified_reference(tmp_path):
    write_reference(reference(), tmp_path / "out" / "identified")
    assert identified_folder(tmp_path / "out") == tmp_path / "out" / "identified"
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "case.yaml").touch()
    assert identified_folder(tmp_path / "case") is None
    assert identified_folder(tmp_path / "case" / "case.yaml") is None
    assert identified_folder(tmp_path / "nowhere") is None


LONGER = synthetic.URDF.replace('xyz="0.45 0 0"', 'xyz="0.5 0 0"')


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"joints": ("joint_2", "joint_1", "joint_3")}, "another order"),
        ({"joints": ("a", "b", "c")}, "other names: a, b, c"),
        ({"joints": ("a", "b")}, "has 2 joints"),
        ({"gravity": np.array([0.0, 0.0, 9.81])}, "has gravity"),
        ({"urdf": LONGER}, "other places"),
    ],
)
def test_another_robot_or_mounting_is_refused(changes, says, tmp_path):
    other = reference(**changes, file=tmp_path / "reference.json")
    with pytest.raises(InputError, match=f"--against {tmp_path}.*{says}") as error:
        diagnose_change(synthetic.case(seed=4), other, tmp_path)
    assert error.value.remedy


def test_the_case_that_it_was_identified_on_is_refused(tmp_path):
    case = synthetic.case(seed=4)
    own = replace(reference(), made_from=made_from(case))
    write_reference(own, tmp_path)
    with pytest.raises(InputError, match="is the case itself"):
        gapscope.diagnose(case, against=tmp_path)
