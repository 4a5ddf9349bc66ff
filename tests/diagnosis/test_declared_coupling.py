"""Friction of a motor that turns two joints: named if the case declares it, asked for if not, and else never."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from sweeps import nightly
from synthetic import Truth

from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.wording import unexplained_sentence

COUPLING = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 1.0]])


def motor_friction(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """Motor 3 turns with dq3 - dq2; friction of 4 N m and 2 N m s/rad."""
    w = dq[:, 2] - dq[:, 1]
    f = 4.0 * np.tanh(w / 0.01) + 2.0 * w
    return np.column_stack([0.0 * f, -f, f])


TRUTH = Truth(extra=motor_friction)


def test_declared_it_is_named_on_the_motor_and_predicted() -> None:
    case = synthetic.case(TRUTH, seed=3, duration=6.0)
    found = diagnose(replace(case, arm=replace(case.arm, coupling=COUPLING)))
    validate(found.document)
    effects = {e["effect"]: e for e in found.document["effects"]}
    assert set(effects) == {"coupled_coulomb_friction", "coupled_viscous_friction"}
    assert all(e["joints"] == [3] for e in effects.values())
    dry = effects["coupled_coulomb_friction"]["parameters"]["torque"]
    slope = effects["coupled_viscous_friction"]["parameters"]["coefficient"]
    assert dry["value"] == pytest.approx([4.0], abs=0.4)
    assert slope["value"] == pytest.approx([2.0], abs=0.4)
    assert found.document["closed"] > 0.95
    assert found.document["unexplained"]["coupling"] is None
    after = found.document["gap"]["after"]["torque_nrmse"]
    assert max(after) < 0.1


def test_undeclared_it_is_asked_for() -> None:
    document = synthetic.diagnosed(TRUTH, seed=3, duration=6.0).document
    coupling = document["unexplained"]["coupling"]
    assert coupling["joints"] == [2, 3]
    assert coupling["declare"] == {"motor": 3, "joint": 2, "ratio": -1.0}
    assert "joints 2 and 3" in unexplained_sentence(document)
    assert "motor: 3, joint: 2, ratio: -1" in document["next_recording"]


@pytest.mark.parametrize(
    "truth",
    [
        nightly(Truth(coulomb=(0.0, 3.0, 2.0), viscous=(0.0, 2.0, 2.0))),
        # one joint's torque leaks into the next, which no motor does
        Truth(
            extra=lambda t, q, dq: np.outer(np.sin(9 * q[:, 1] * dq[:, 0]), [0, 3, 2])
        ),
    ],
    ids=["friction of both joints", "no friction"],
)
def test_others_are_not_asked_for_a_coupling(truth: Truth) -> None:
    document = synthetic.diagnosed(truth, seed=5, duration=5.0).document
    assert document["unexplained"]["coupling"] is None
