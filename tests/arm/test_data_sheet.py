"""The data sheet: what a user says about the joints, refused with its entry where it cannot be."""

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm

PLAIN = [0.1] * 7


def test_a_sheet_of_lists_and_arrays() -> None:
    sheet = {
        "armature": PLAIN,
        "viscous": np.zeros(7),
        "encoder": "joint",
        "encoder_step": 1e-4,
    }
    arm = load_nominal_arm(
        "kuka_iiwa", sheet={**sheet, "torque_limit": [np.inf] + [40.0] * 6}
    )
    np.testing.assert_array_equal(arm.armature, PLAIN)
    assert arm.encoder == "joint" and arm.encoder_step == 1e-4
    assert arm.torque_limit is not None and not arm.viscous.any()
    bare = load_nominal_arm("kuka_iiwa", sheet={"coulomb": None, "encoder_step": 0.0})
    assert not bare.coulomb.any() and not bare.encoder_step


BAD = [
    ({"coulomb": [0.1] * 6}, "sheet.coulomb: expected 7 numbers, one per joint, got 6"),
    ({"coulomb": [PLAIN]}, "sheet.coulomb: expected 7 numbers"),
    ({"coulomb": [np.inf] * 7}, "sheet.coulomb: inf N m at joint 1"),
    ({"armature": [-0.1] * 7}, "sheet.armature: -0.1 kg m"),
    ({"torque_limit": [0.0] * 7}, "sheet.torque_limit: 0 N m at joint 1"),
    ({"encoder_step": -1e-4}, "sheet.encoder_step: expected a number from zero on"),
    ({"encoder_step": "fine"}, "sheet.encoder_step"),
    ({"encoder": "link"}, "nominal.encoder: expected motor or joint"),
    ({"Viscous": PLAIN}, "did you mean 'viscous'"),
    (
        {"mass": PLAIN},
        "known are armature, coulomb, viscous, torque_limit, encoder, encoder_step",
    ),
    ([PLAIN], "sheet: expected entries by name"),
]


@pytest.mark.parametrize(("sheet", "message"), BAD, ids=lambda value: str(value)[:40])
def test_a_sheet_at_fault_is_refused_with_its_entry(
    sheet: object, message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_nominal_arm("kuka_iiwa", sheet=sheet)
    assert caught.value.file is None


def test_the_file_that_holds_the_sheet_is_named() -> None:
    with pytest.raises(
        InputError, match=r"case.yaml, field nominal.coulomb: expected 7 numbers"
    ):
        load_nominal_arm(
            "kuka_iiwa", sheet={"coulomb": [1.0]}, source=Path("case.yaml")
        )


@pytest.mark.parametrize(
    ("value", "message"),
    [(["x"], "not a number"), ([np.nan], "not a number"), ([1, 2], "got 2")],
)
def test_a_nominal_arm_of_what_is_not_a_number_is_refused(
    value: list, message: str
) -> None:
    with pytest.raises(InputError, match=f"nominal.viscous: .*{message}"):
        NominalArm("rod", Path("rod.urdf"), ("hinge",), viscous=value)
