"""An effect added in one file: it is predicted, simulated, drawn at random, and found by a diagnosis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import example_effect
import numpy as np
import pytest
import synthetic
from example_effect import CUBIC_FRICTION

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.diagnose import diagnose
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE, explained, register, remove
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.severity import draw
from gapscope.envs.simulated_arm import SimulatedArm

COEFFICIENT = 2.0
"""Of the effect in the recordings, on joint 2 [N m s^3/rad^3]."""


@pytest.fixture(autouse=True)
def entered() -> Iterator[None]:
    """The catalogue with the example, and afterwards without it."""
    register(CUBIC_FRICTION)
    yield
    remove(CUBIC_FRICTION.name)


def applied(coefficient: float = COEFFICIENT) -> AppliedEffect:
    return AppliedEffect("cubic_friction", (2,), {"coefficient": np.array(coefficient)})


def test_the_example_is_one_short_file() -> None:
    assert len(Path(example_effect.__file__).read_text().splitlines()) < 60


def test_a_name_is_entered_once() -> None:
    with pytest.raises(InputError, match="'cubic_friction'"):
        register(replace(CUBIC_FRICTION, equation="another"))
    assert CATALOGUE["cubic_friction"] is CUBIC_FRICTION
    assert explained()[-1] is CUBIC_FRICTION


def test_the_prediction_has_it() -> None:
    """b3 v^3 on its joint alone: 2 * 0.5^3 = 0.25 N m."""
    still = np.zeros((2, 3))
    motion = Motion(
        np.array([0.0, 0.1]), still, np.tile([0.3, 0.5, 0.0], (2, 1)), still
    )
    body = RigidBody(synthetic.arm())
    plain, changed = (
        CorrectedArm(synthetic.arm(), effects).predict(body, motion)
        for effects in ((), (applied(),))
    )
    np.testing.assert_allclose(changed - plain, [[0.0, 0.25, 0.0]] * 2, atol=1e-12)


def test_the_simulator_has_it() -> None:
    """Within one step it takes dt (M + I)^-1 b3 v^3 of the velocity."""
    q, dq, dt = np.array([0.1, -0.4, 0.5]), np.array([0.2, 1.5, 0.3]), 1e-3
    after = []
    for effects in ((), (applied(),)):
        with SimulatedArm(synthetic.arm(), effects, dt, engine="mujoco") as simulated:
            simulated.reset(q, dq)
            simulated.step(np.zeros(3))
            after.append(simulated.dq)
    inertia = RigidBody(synthetic.arm()).mass_matrix(q) + np.diag(synthetic.ARMATURE)
    expected = dt * np.linalg.solve(inertia, [0.0, COEFFICIENT * 1.5**3, 0.0])
    np.testing.assert_allclose(after[0] - after[1], expected, rtol=0.02)


def test_it_is_drawn_at_random() -> None:
    scale = ArmScale.of(synthetic.arm())
    drawn = draw("cubic_friction", np.random.default_rng(0), scale, joints=(1, 3))
    assert drawn.joints == (1, 3) and (drawn.parameters["coefficient"] > 0).all()


def test_a_diagnosis_finds_it() -> None:
    plain = synthetic.case(duration=6.0)
    recordings = []
    for k, (recording, frequency) in enumerate(
        zip(plain.recordings, (0.1, 0.2, 0.3), strict=True)
    ):
        motion = synthetic.motion(k, frequency, 6.0)
        velocity = motion.velocity(recording.t + synthetic.SKEW)[:, 1]
        tau = recording.tau.copy()
        tau[:, 1] += COEFFICIENT * velocity**3
        recordings.append(replace(recording, tau=tau))
    document = diagnose(replace(plain, recordings=tuple(recordings))).document
    assert document["verdict"] == "effects_found"
    (found,) = document["effects"]
    assert (found["effect"], found["joints"]) == ("cubic_friction", [2])
    (value,), (std,) = (found["parameters"]["coefficient"][x] for x in ("value", "std"))
    assert abs(value - COEFFICIENT) < max(3 * std, 0.1)
