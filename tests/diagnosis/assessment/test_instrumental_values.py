"""Commands as instruments: loud encoders pull what least squares makes of the motion, not what the commands say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from synthetic import Truth

from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.diagnosis.diagnose import diagnose, examine
from gapscope.diagnosis.document.diagnosis_json import validate

ROTOR = Truth(armature=(0.0, 0.0, 0.5))
CONTROLLER = PD(
    rate=500.0, kp=np.full(3, 100.0), kd=np.full(3, 10.0), feedforward="nominal"
)


def case(noise: float, truth: Truth = ROTOR) -> Case:
    """A case whose encoders have white noise [rad], and whose references are what the arm did."""
    sound, rng = synthetic.case(truth, seed=11), np.random.default_rng(2)
    loud = tuple(
        replace(r, q=r.q + noise * rng.standard_normal(r.q.shape), q_ref=r.q)
        for r in sound.recordings
    )
    return replace(sound, recordings=loud, controller=CONTROLLER)


def rotor(of: Case) -> tuple[float, float, float]:
    """Inertia found on joint 3 [kg m^2], its standard deviation, and the value by the commands."""
    document = diagnose(of).document
    validate(document)
    # encoders that loud leave most of the gap: the rotor is possible, not named
    found = (*document["effects"], *document["possible"])
    entry = next(e for e in found if e["effect"] == "armature")
    inertia = entry["parameters"]["inertia"]
    place = entry["joints"].index(3)
    return tuple(inertia[name][place] for name in ("value", "std", "by_commands"))  # type: ignore[return-value]


def test_good_encoders_need_none() -> None:
    value, _, by_commands = rotor(case(0.0))
    assert value == pytest.approx(0.5, rel=0.03) and by_commands == pytest.approx(
        value, rel=0.02
    )


def test_parameters_that_are_left_out_have_no_value_by_the_commands() -> None:
    document = diagnose(case(0.0, Truth(scale=(0.0, 0.2, 0.0)))).document
    (entry,) = document["effects"]
    assert entry["effect"] == "torque_scale" and set(entry["parameters"]) == {"scale"}
    assert entry["parameters"]["scale"]["by_commands"] == pytest.approx([0.2], rel=0.1)


@pytest.mark.nightly
def test_loud_encoders_pull_the_value_and_not_that_by_commands() -> None:
    value, _, by_commands = rotor(case(1e-2))
    assert abs(by_commands - 0.5) < 0.5 * abs(value - 0.5)
    assert by_commands == pytest.approx(0.5, rel=0.1)


def test_it_takes_a_known_controller_and_every_reference() -> None:
    known = case(0.0)
    first, *others = known.recordings
    less = replace(known, recordings=(replace(first, q_ref=None), *others))
    for of in (replace(known, controller=None), less):
        found = examine(of)
        assert "armature" in found.findings and not found.by_commands
