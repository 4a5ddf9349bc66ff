"""The data sheet: what a user says about the joints, refused with its entry where it cannot be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gapscope.arm.case import case_files, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.io.write_case import write_case, write_recording
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm, coupling_entries
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm

PLAIN = [0.1] * 7


def test_a_sheet_of_lists_and_arrays() -> None:
    sheet = {"armature": PLAIN, "viscous": np.zeros(7), "encoder": "joint"}
    sheet |= {"encoder_step": 1e-4, "torque_limit": [np.inf] + [40.0] * 6}
    arm = load_nominal_arm("kuka_iiwa", sheet=sheet)
    np.testing.assert_array_equal(arm.armature, PLAIN)
    assert arm.encoder == "joint" and arm.encoder_step == 1e-4
    assert arm.torque_limit is not None and not arm.viscous.any()
    bare = load_nominal_arm("kuka_iiwa", sheet={"coulomb": None, "encoder_step": 0.0})
    assert not bare.coulomb.any() and not bare.encoder_step


BAD = [
    ({"coulomb": [0.1] * 6}, "sheet.coulomb: expected 7 numbers, one per joint, got 6"),
    ({"coulomb": [PLAIN]}, r"sheet.coulomb\[1\]: expected a number"),
    ({"coulomb": [np.inf] * 7}, "sheet.coulomb: a friction of inf N m is beyond any"),
    ({"armature": [-0.1] * 7}, r"sheet.armature.*: expected a number of at least 0, got -0.1"),
    ({"torque_limit": [0.0] * 7}, r"sheet.torque_limit.*: expected a number above 0, got 0"),
    ({"encoder_step": -1e-4}, "sheet.encoder_step: expected a number above 0, got -0.0001"),
    ({"encoder_step": "fine"}, "sheet.encoder_step"),
    ({"encoder": "link"}, "sheet.encoder: expected one of motor, joint; got .link"),
    ({"Viscous": PLAIN}, "did you mean viscous"),
    ({"mass": PLAIN}, "known keys: armature, coulomb, viscous, torque_limit, encoder, encoder_step"),
    ([PLAIN], "sheet: expected a mapping"),
    *(
        ({"coupling": [entry]}, r"sheet\.coupling\[1\]")
        for entry in (
            {"motor": 8, "joint": 6},
            {"motor": 6, "joint": 6},
            {"motor": 6},
            {"motor": 6, "joint": 5, "ratio": 0},
            {"motor": 6, "joint": 5, "ratio": "one"},
            {"motor": 6, "joint": 5, "gear": 32},
            "6 with 5",
        )
    ),
]  # fmt: skip


@pytest.mark.parametrize(("sheet", "message"), BAD, ids=lambda value: str(value)[:40])
def test_a_sheet_at_fault_is_refused_with_its_entry(
    sheet: object, message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_nominal_arm("kuka_iiwa", sheet=sheet)
    assert caught.value.file is None


@pytest.mark.parametrize(
    ("value", "message"),
    [(["x"], "not a number"), ([np.nan], "not a number"), ([1, 2], "got 2")],
)
def test_a_nominal_arm_of_what_is_not_a_number_is_refused(
    value: list, message: str
) -> None:
    with pytest.raises(InputError, match=f"nominal.viscous: .*{message}"):
        NominalArm("rod", Path("rod.urdf"), ("hinge",), viscous=value)


# Motors that turn several joints: declared in the data sheet, read from a transmission, refused if they cannot be.


WRIST = {"motor": 7, "joint": 6, "ratio": -0.5}


def test_a_declared_coupling_turns_the_motor_with_both_joints() -> None:
    arm = load_nominal_arm("kuka_iiwa", sheet={"coupling": [WRIST]})
    assert arm.coupling is not None
    np.testing.assert_array_equal(arm.coupling[6], [0, 0, 0, 0, 0, -0.5, 1])
    assert arm.coupled_motors == (7,)
    assert coupling_entries(arm.coupling) == [WRIST]


def test_a_case_keeps_the_coupling_of_its_logs_transmission(tmp_path) -> None:
    """Read from motor angles, written on the joints' side: the declaration moves to the data sheet."""
    t = np.arange(150) / 100
    q = 0.1 * np.sin(t)[:, None] * np.ones(7)
    columns = np.hstack([t[:, None], q, q])
    names = ["t", *(f"q{j}" for j in range(1, 8)), *(f"tau{j}" for j in range(1, 8))]
    text = [",".join(names), *(",".join(map(repr, row)) for row in columns.tolist())]
    (tmp_path / "log.csv").write_text("\n".join(text))
    (tmp_path / "case.yaml").write_text(
        "name: wrist\nrobot: kuka_iiwa\nrecordings: [log.csv]\nimport: {transmission: "
        "{ratios: [10, 10, 10, 10, 10, 10, 20], coupling: [{motor: 7, joint: 6, ratio: 10}]}}\n"
    )
    case = load_case(tmp_path)
    assert case.arm.coupled_motors == (7,)
    written = load_case(write_case(case, tmp_path / "copy"))
    np.testing.assert_array_equal(written.arm.coupling, case.arm.coupling)
    assert written.arm.coupling is not None and written.arm.coupling[6, 5] == 0.5


# Known payloads in a case: read, refused with the field at fault, written and read back.


BODY = {"mass": 2.0, "com": [0.0, 0.0, 0.05]}
LOAD = KnownLoad(2.0, (0.0, 0.0, 0.05))


@pytest.fixture
def folder(tmp_path: Path, urdf: Path, recording: Recording) -> Path:
    """A folder with a URDF and three recordings, but no case file yet."""
    (tmp_path / "more").mkdir()
    for factor, name in enumerate(("a.csv", "b.csv", "more/c.npz"), start=1):
        other = replace(recording, q=factor * recording.q / 3)
        write_recording(other, tmp_path / name)
    return tmp_path


def write(folder: Path, payloads: Any, **content: Any) -> None:
    """The case file of a folder."""
    full = {"name": "two", "robot": "robot.urdf", "payloads": payloads}
    full |= {"recordings": ["a.csv", "b.csv"], "judge": ["more/c.npz"]}
    (folder / "case.yaml").write_text(yaml.safe_dump(full | content))


def test_recordings_carry_what_the_case_says(folder: Path) -> None:
    write(folder, {"b.csv": BODY, "more/c.npz": BODY | {"mass": 0}})
    case = load_case(folder)
    assert [r.payload for r in case.recordings] == [None, LOAD]
    assert case.judged[0].payload == KnownLoad(0.0, LOAD.com)
    assert case.payload_of(folder / "more" / ".." / "b.csv") == LOAD
    assert case.payload_of(folder / "a.csv") is None
    assert load_case(folder, read_recordings=False).payloads == case.payloads
    assert set(case_files(folder)) >= {folder / "b.csv"}
    # every part of a recording carries it
    rows = {"rows": {"fit": [[0, 120]], "judge": [60, 199]}}
    write(folder, {"b.csv": BODY}, **{"import": rows})
    case = load_case(folder)
    assert [r.payload for r in case.recordings] == [None, LOAD]
    assert [r.payload for r in case.judged] == [None, LOAD, None]


def test_files_side_by_side_may_be_named_by_any_of_them(folder: Path) -> None:
    entry = {"motion": "a.csv", "force": "b.csv"}
    columns = {"q": ("motion", "q{j}"), "tau": ("force", "tau{j}")}
    importing = {k: {"file": x, "column": y} for k, (x, y) in columns.items()}
    more = {"recordings": [entry], "judge": [], "import": {"join": "row", **importing}}
    for name in entry.values():
        write(folder, {name: BODY}, **more)
        assert load_case(folder).recordings[0].payload == LOAD


BAD_LOADS: list[tuple[Any, str]] = [
    ({"b.cvs": BODY}, "field payloads: no recording is called 'b.cvs'\n  remedy: did you mean b.csv?"),
    ({"xyz": BODY}, "no recording is called 'xyz'\n  remedy: name one of recordings: or judge:, a.csv, b.csv, more/c"),
    ({"b.csv": BODY | {"mass": -2}}, "field payloads.b.csv.mass: expected a number of at least 0, got -2"),
    ({"b.csv": BODY | {"mass": float("inf")}}, "field payloads.b.csv, mass: a payload of inf kg is none"),
    ({"b.csv": BODY | {"mass": float("nan")}}, "field payloads.b.csv, mass: a payload of nan kg is none"),
    ({"b.csv": BODY | {"mass": "2 kg"}}, "field payloads.b.csv.mass: expected a number, got '2 kg'"),
    ({"b.csv": BODY | {"com": [0.0, 0.0]}}, "field payloads.b.csv.com: expected at least 3 entries, got 2"),
    ({"b.csv": BODY | {"com": [0, 0, float("nan")]}}, "field payloads.b.csv, com: the centre of the payload needs"),
    ({"b.csv": {"mass": 2.0}}, "field payloads.b.csv: lacks the key 'com'"),
    ({"b.csv": BODY | {"inertia": 1}}, "field payloads.b.csv: unknown key 'inertia'"),
    ({"b.csv": 2.0}, "field payloads.b.csv: expected a mapping (key: value), got 2.0"),
    (["b.csv"], "field payloads: expected a mapping (key: value) or nothing, got ['b.csv']"),
]  # fmt: skip


@pytest.mark.parametrize(("payloads", "message"), BAD_LOADS, ids=str)
def test_refused(payloads: Any, message: str, folder: Path) -> None:
    write(folder, payloads)
    with pytest.raises(InputError) as caught:
        load_case(folder)
    assert message in str(caught.value)
    assert f"{folder / 'case.yaml'}, " in str(caught.value)


def test_written_and_read_back(folder: Path) -> None:
    write(folder, {"b.csv": BODY, "more/c.npz": BODY})
    again = load_case(write_case(load_case(folder), folder / "again"))
    assert [r.payload for r in again.recordings] == [None, LOAD]
    assert again.judged[0].payload == LOAD
    plain = write_case(load_case(folder / "again"), folder / "third", ending="npz")
    assert list(yaml.safe_load(plain.read_text())["payloads"]) == ["b.npz", "c.npz"]
    # a case without any is written without the section
    write(folder, None)
    bare = write_case(load_case(folder), folder / "bare")
    assert "payloads" not in yaml.safe_load(bare.read_text())


def test_parameters_of_a_point_mass() -> None:
    np.testing.assert_allclose(
        KnownLoad(2.0, (1.0, 2.0, 3.0)).parameters,
        [2, 2, 4, 6, 26, -4, 20, -6, -12, 10],
    )
