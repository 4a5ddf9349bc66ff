"""The data sheet: what a user says about the joints, refused with its entry where it cannot be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.case import load_case
from gapscope.arm.errors import InputError
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_case, write_columns
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm, coupling_entries
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


NO_COUPLINGS = (
    {"motor": 8, "joint": 6},
    {"motor": 6, "joint": 6},
    {"motor": 6},
    {"motor": 6, "joint": 5, "ratio": 0},
    {"motor": 6, "joint": 5, "gear": 32},
    "6 with 5",
)
BAD = [
    ({"coulomb": [0.1] * 6}, "sheet.coulomb: expected 7 numbers, one per joint, got 6"),
    ({"coulomb": [PLAIN]}, r"sheet.coulomb\[1\]: expected a number"),
    ({"coulomb": [np.inf] * 7}, r"sheet.coulomb.*: expected a number, got inf"),
    ({"armature": [-0.1] * 7}, r"sheet.armature.*: expected a number of at least 0, got -0.1"),
    ({"torque_limit": [0.0] * 7}, r"sheet.torque_limit.*: expected a number above 0, got 0"),
    ({"encoder_step": -1e-4}, "sheet.encoder_step: expected a number above 0, got -0.0001"),
    ({"encoder_step": "fine"}, "sheet.encoder_step"),
    ({"encoder": "link"}, "sheet.encoder: expected one of motor, joint; got .link"),
    ({"Viscous": PLAIN}, "did you mean 'viscous'"),
    ({"mass": PLAIN}, "known keys: armature, coulomb, viscous, torque_limit, encoder, encoder_step"),
    ([PLAIN], "sheet: expected a mapping"),
    *(({"coupling": [entry]}, r"sheet\.coupling\[1\]") for entry in NO_COUPLINGS),
]  # fmt: skip


@pytest.mark.parametrize(("sheet", "message"), BAD, ids=lambda value: str(value)[:40])
def test_a_sheet_at_fault_names_its_entry(sheet: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_nominal_arm("kuka_iiwa", sheet=sheet)
    assert caught.value.file is None


@pytest.mark.parametrize(
    ("value", "message"),
    [(["x"], "not a number"), ([np.nan], "not a number"), ([1, 2], "got 2")],
)
def test_a_nominal_arm_of_no_numbers_is_refused(value: list, message: str) -> None:
    with pytest.raises(InputError, match=f"nominal.viscous: .*{message}"):
        NominalArm("rod", Path("rod.urdf"), ("hinge",), viscous=value)


# Motors that turn several joints: declared in the data sheet, read from a transmission, refused if they cannot be.


WRIST = {"motor": 7, "joint": 6, "ratio": -0.5}


def test_a_declared_coupling_turns_the_motor_with_both_joints() -> None:
    arm = load_nominal_arm("kuka_iiwa", sheet={"coupling": [WRIST]})
    np.testing.assert_array_equal(arm.coupling[6], [0, 0, 0, 0, 0, -0.5, 1])
    assert arm.coupled_motors == (7,)
    assert coupling_entries(arm.coupling) == [WRIST]


def test_a_case_keeps_the_coupling_of_its_logs_transmission(tmp_path) -> None:
    """Read from motor angles, written on the joints' side: the declaration moves to the data sheet."""
    t = np.arange(150) / 100
    q = 0.1 * np.sin(t)[:, None] * np.ones(7)
    write_columns(numbered({"t": t, "q": q, "tau": q}), tmp_path / "log.csv")
    (tmp_path / "case.yaml").write_text(
        "name: wrist\nrobot: kuka_iiwa\nrecordings: [log.csv]\nimport: {transmission: "
        "{ratios: [10, 10, 10, 10, 10, 10, 20], coupling: [{motor: 7, joint: 6, ratio: 10}]}}\n"
    )
    case = load_case(tmp_path)
    assert case.arm.coupled_motors == (7,)
    written = load_case(write_case(case, tmp_path / "copy"))
    np.testing.assert_array_equal(written.arm.coupling, case.arm.coupling)
    assert written.arm.coupling[6, 5] == 0.5


def test_parameters_of_a_point_mass() -> None:
    found = KnownLoad(2.0, (1.0, 2.0, 3.0)).parameters
    np.testing.assert_allclose(found, [2, 2, 4, 6, 26, -4, 20, -6, -12, 10])
