"""Motors that turn several joints: declared in the data sheet, read from a transmission, refused if they cannot be."""

import numpy as np
import pytest

from gapscope.arm.case import load_case
from gapscope.arm.coupling import coupling_entries
from gapscope.arm.errors import InputError
from gapscope.arm.io.write_case import write_case
from gapscope.arm.robots import load_nominal_arm

WRIST = {"motor": 7, "joint": 6, "ratio": -0.5}


def test_a_declared_coupling_turns_the_motor_with_both_joints() -> None:
    arm = load_nominal_arm("kuka_iiwa", sheet={"coupling": [WRIST]})
    assert arm.coupling is not None
    np.testing.assert_array_equal(arm.coupling[6], [0, 0, 0, 0, 0, -0.5, 1])
    assert arm.coupled_motors == (7,)
    assert arm.turned_by(7) == (6, 7) and arm.turned_by(6) == (6,)
    assert coupling_entries(arm.coupling) == [WRIST]


def test_one_turn_by_default_and_none_without_a_declaration() -> None:
    arm = load_nominal_arm("kuka_iiwa", sheet={"coupling": [{"motor": 2, "joint": 1}]})
    assert arm.coupling is not None and arm.coupling[1, 0] == 1.0
    assert load_nominal_arm("kuka_iiwa").coupled_motors == ()


@pytest.mark.parametrize(
    "entry",
    [
        {"motor": 8, "joint": 6},
        {"motor": 6, "joint": 6},
        {"motor": 6},
        {"motor": 6, "joint": 5, "ratio": 0},
        {"motor": 6, "joint": 5, "ratio": "one"},
        {"motor": 6, "joint": 5, "gear": 32},
        "6 with 5",
    ],
)
def test_what_cannot_be_names_its_entry(entry: object) -> None:
    with pytest.raises(InputError, match=r"sheet\.coupling\[1\]"):
        load_nominal_arm("kuka_iiwa", sheet={"coupling": [entry]})


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
